"""Where a command may write: what lies there already and is not its own stays as it is (docs/conventions.md).

Told before the seconds of work that a result takes.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable
from pathlib import Path

from s2r_protocol.exits import UsageError


def check_unused(folder: Path) -> None:
    """Refuse a folder that holds something.

    Raises:
        UsageError: The folder exists and holds something, or is a file.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"--out {folder} exists and is not empty; name a new folder")


def check_own_results(
    folder: Path, answer: str, keys: Collection[str], files: Iterable[str], begun: str | None = None
) -> None:
    """Refuse a folder where a result would replace files that are not those of an earlier one.

    Args:
        folder: Where the result goes; other files may lie there.
        answer: The JSON file that tells an earlier result of the same command.
        keys: It has one of them.
        files: What the result may write, ``answer`` aside.
        begun: The file that tells of one which was broken off, where the command leaves one.

    Raises:
        UsageError: A file of that name is somebody else's.
    """
    if has_key(folder / answer, keys) or (begun is not None and (folder / begun).exists()):
        return
    taken = [name for name in (answer, *files) if (folder / name).exists()]
    if taken:
        raise UsageError(
            f"--out {folder} holds {', '.join(taken)}, not written by this command, which would be replaced; name "
            "another folder"
        )


def check_inputs_stay(folder: Path, files: Iterable[str], inputs: Iterable[Path]) -> None:
    """Refuse a folder where a result would replace what it is made from, an earlier one's files among that.

    Args:
        folder: Where the result goes.
        files: What it may write there.
        inputs: What it is made from.

    Raises:
        UsageError: One of the inputs is one of the files.
    """
    written = {(folder / name).resolve() for name in files}
    for path in inputs:
        if path.resolve() in written:
            raise UsageError(
                f"--out {folder}: the result would replace {path}, which it is made from; name another folder"
            )


def check_place(path: Path) -> None:
    """Refuse a place where no file can be.

    Raises:
        UsageError: ``path`` is a folder, or the folder it shall lie in does not exist or takes no file of this user.
    """
    if path.is_dir():
        raise UsageError(f"{path} is a folder; name a file")
    if not path.parent.is_dir():
        raise UsageError(f"there is no folder {path.parent} for {path.name}; make it or name another file")
    if not path.exists() and not os.access(path.parent, os.W_OK | os.X_OK):
        raise UsageError(
            f"{path.parent} takes no file of this user, {path.name} neither; name a place of your own"
        )


def check_new_file(path: Path) -> None:
    """Refuse a place where no file can be, or where one is.

    Raises:
        UsageError: As :func:`check_place`, or ``path`` exists.
    """
    check_place(path)
    if path.exists():
        raise UsageError(f"{path} exists and would be replaced; name another file, or remove it")


def has_key(file: Path, keys: Collection[str]) -> bool:
    """Whether a file is a JSON object with one of these keys."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(content, dict) and not content.keys().isdisjoint(keys)
