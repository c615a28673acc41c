"""Printing to a terminal or pipe that goes away: a connection that is cut must not end a command in the middle."""

from __future__ import annotations

import errno
import io
import os
import stat
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

STREAMS = {"stdout": 1, "stderr": 2}
_GONE = {errno.EIO, errno.EPIPE}  # of a terminal, of the reader of a pipe


class _Terminal(io.FileIO):
    """A terminal's or pipe's file descriptor whose writes go to nowhere once the terminal or the reader is gone."""

    def write(self, data: ReadableBuffer, /) -> int | None:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in _GONE:
                raise
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())
            os.close(nowhere)
            return super().write(data)


def outlive_the_terminal() -> None:
    """Let ``sys.stdout`` and ``sys.stderr`` outlive their terminal or the reader of their pipe.

    A line that fails must not keep an arm from coming to rest, nor change the exit code. Whoever started the command is
    told by SIGHUP that the terminal is gone, a background job of a shell that has forgotten it (``disown``) is not, and
    the signal may come a moment after the first line that fails. Of a ``head`` that has ended nobody tells.
    """
    for name, descriptor in STREAMS.items():
        stream = getattr(sys, name)
        if not isinstance(stream, io.TextIOWrapper) or not _may_go_away(descriptor):
            continue
        stream.flush()
        raw = io.BufferedWriter(_Terminal(descriptor, "w", closefd=False))
        lines = stream.line_buffering or _is(stat.S_ISCHR, descriptor)
        setattr(sys, name, io.TextIOWrapper(raw, stream.encoding, stream.errors, line_buffering=lines))


def _may_go_away(descriptor: int) -> bool:
    # No ``isatty``: it says no of a terminal that is gone already.
    return any(_is(kind, descriptor) for kind in (stat.S_ISCHR, stat.S_ISFIFO, stat.S_ISSOCK))


def _is(kind: Callable[[int], bool], descriptor: int) -> bool:
    try:
        return kind(os.fstat(descriptor).st_mode)
    except OSError:
        return False
