"""A worker process of a batch: asked to end, or left by its first process, it ends the job it is at and begins none."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from types import FrameType
from typing import Any

from s2r_protocol.cli.first_process import after_first_process
from s2r_protocol.exits import ExitCode

_at_work = False
_ending = False


def listen() -> None:
    """Hear SIGINT and SIGTERM: a pool passes neither on, and its workers would finish what they began."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _end)
    after_first_process(lambda: os.kill(os.getpid(), signal.SIGTERM))


def call(work: Callable[..., dict[str, Any]], job: tuple[Any, ...]) -> dict[str, Any]:
    """``work(*job)``; interrupted, the job closes what it opened, and the process ends."""
    global _at_work  # one process, one job at a time
    _at_work = True
    try:
        return work(*job)
    except KeyboardInterrupt:
        os._exit(ExitCode.INTERRUPTED)  # back in the pool's loop it would take the next job
    finally:
        _at_work = False


def _end(number: int, frame: FrameType | None) -> None:
    global _ending
    if not _at_work:
        os._exit(ExitCode.INTERRUPTED)
    if not _ending:  # a second one must not cut the closing short
        _ending = True
        signal.default_int_handler(number, frame)
