"""A file that is there whole or not at all: what a full disk cut off is not left for somebody to believe."""

from __future__ import annotations

import errno
import os
from pathlib import Path

NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""Errors of a disk, a quota or a shell's limit that takes no more of a file."""


def write_whole(path: Path, text: str) -> None:
    """Write a text file beside its place and move it there; an earlier one stays until then.

    Raises:
        OSError: It cannot be written, with the file's name, which a full disk does not tell; nothing is left behind.
    """
    place = path.resolve()  # a link stays one
    beside = place.with_name(f".{place.name}.{os.getpid()}")
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(place)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        if beside.exists():  # as it does not where the folder is none
            beside.unlink()
