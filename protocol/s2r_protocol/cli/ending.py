"""What asks a command to end: Ctrl-C, SIGTERM, and a terminal or an ssh connection that goes away."""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping
from types import FrameType
from typing import Any

Handler = Callable[[int, FrameType | None], object]


def hear(handler: Handler) -> Mapping[int, Any]:
    """Have ``handler`` called by SIGINT, SIGTERM and SIGHUP; a SIGHUP that ``nohup`` ignores stays ignored.

    Returns:
        What was there before, by signal, for :func:`restore`.
    """
    handlers: dict[int, Handler] = {signal.SIGINT: handler, signal.SIGTERM: handler}
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        handlers[signal.SIGHUP] = handler
    return {number: signal.signal(number, one) for number, one in handlers.items()}


def restore(before: Mapping[int, Any]) -> None:
    """Put back what :func:`hear` replaced."""
    for number, handler in before.items():
        signal.signal(number, handler)
