"""Which recording a path stands for: a file for itself, the folder of a run or of a plan for what it holds."""

from __future__ import annotations

from pathlib import Path

from s2r_protocol.exits import UsageError

IN_A_FOLDER = ("run.mcap", "plan.mcap")  # of `s2r run`; of `s2r plan`


def recording_file(path: Path) -> Path:
    """The recording at a path.

    Raises:
        UsageError: The folder holds none.
    """
    if not path.is_dir():
        return path
    for name in IN_A_FOLDER:
        if (path / name).is_file():
            return path / name
    raise UsageError(f"folder {path} holds no {' and no '.join(IN_A_FOLDER)}; {_what_to_name(path)}")


def _what_to_name(folder: Path) -> str:
    """What a folder holds instead: that of a demo its run, that of an executor recordings of other names."""
    run = folder / "run"
    if any((run / name).is_file() for name in IN_A_FOLDER):
        return f"its run is in {run}: name that"
    files = sorted(folder.glob("*.mcap"))
    if not files:
        return "name a recording, or the folder of a run or a plan"
    newest = max(files, key=lambda file: file.stat().st_mtime)
    return f"it holds {len(files)} recordings by other names, {newest.name} the newest: name one of them"
