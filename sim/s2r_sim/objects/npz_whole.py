"""Whether an ``.npz`` that was written is still there, byte for byte as its own checksums have it."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any


def is_whole(path: Path) -> bool:
    """Whether an ``.npz`` can be read to its end; about 0.1 s for 20 MB of arrays."""
    try:
        with zipfile.ZipFile(path) as file:
            return bool(file.namelist()) and file.testzip() is None
    except (OSError, zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError):
        return False  # damaged headers pass for other compressions (NotImplementedError) or passwords (RuntimeError)


def file_of_result_is_whole(result: dict[str, Any], folder: Path) -> bool:
    """Whether the ``.npz`` that a result of a job names is whole in a folder."""
    return is_whole(folder / str(result["file"]))
