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
    raise UsageError(
        f"folder {path} holds no {' and no '.join(IN_A_FOLDER)}; name a recording, or the folder of a run or a plan"
    )
