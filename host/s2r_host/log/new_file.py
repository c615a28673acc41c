"""Can a result be written where it is wanted? Told before the seconds of work that it takes."""

from __future__ import annotations

from pathlib import Path

from s2r_protocol.exits import UsageError


def check_new_file(path: Path) -> None:
    """Refuse a place where no file can be.

    Raises:
        UsageError: ``path`` is a folder, or the folder it shall lie in does not exist.
    """
    if path.is_dir():
        raise UsageError(f"{path} is a folder; name a file")
    if not path.parent.is_dir():
        raise UsageError(f"there is no folder {path.parent} for {path.name}; make it or name another file")
