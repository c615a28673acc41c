"""Printing to a terminal that goes away: an ssh connection that is cut must not end a command in the middle."""

from __future__ import annotations

import errno
import io
import os
import stat
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

STREAMS = {"stdout": 1, "stderr": 2}


class _Terminal(io.FileIO):
    """A terminal's file descriptor whose writes go to nowhere once the terminal is gone."""

    def write(self, data: ReadableBuffer, /) -> int | None:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())
            os.close(nowhere)
            return super().write(data)


def outlive_the_terminal() -> None:
    """Let ``sys.stdout`` and ``sys.stderr`` outlive their terminal: a line that fails must not keep an arm from coming
    to rest.

    Whoever started the command is told by SIGHUP that the terminal is gone, a background job of a shell that has
    forgotten it (``disown``) is not, and the signal may come a moment after the first line that fails.
    """
    for name, descriptor in STREAMS.items():
        stream = getattr(sys, name)
        if not isinstance(stream, io.TextIOWrapper) or not _is_device(descriptor):
            continue
        stream.flush()
        raw = io.BufferedWriter(_Terminal(descriptor, "w", closefd=False))
        lasting = io.TextIOWrapper(raw, stream.encoding, stream.errors, line_buffering=True)
        setattr(sys, name, lasting)


def _is_device(descriptor: int) -> bool:
    # No ``isatty``: it says no of a terminal that is gone already.
    try:
        return stat.S_ISCHR(os.fstat(descriptor).st_mode)
    except OSError:
        return False
