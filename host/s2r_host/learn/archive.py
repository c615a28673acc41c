"""One file of training data, read whole and checked before anything is made of it."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.errors import InputError

# What a file that is cut off, or overwritten in places, makes of numpy's reader.
DAMAGE = (ValueError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error)


def read_archive(file: Path, needed: Sequence[str], command: str) -> dict[str, NDArray[np.generic]]:
    """All arrays of an ``.npz`` by name.

    Args:
        file: The archive.
        needed: Names it must have.
        command: That makes such files, and makes a damaged one anew.

    Raises:
        InputError: The file is damaged, or lacks something, as files of older versions do.
    """
    try:
        with np.load(file) as archive:
            content = {name: archive[name] for name in archive.files}
    except DAMAGE as error:
        raise InputError(
            f"{file} is damaged ({error}); '{command}' with the same options draws it again"
        ) from error
    missing = [name for name in needed if name not in content]
    if missing:
        raise InputError(f"{file} has no {', '.join(missing)}; make it anew with '{command}'")
    return content
