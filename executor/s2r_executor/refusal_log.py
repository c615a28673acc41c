"""Refusals on the executor's terminal: who asked what, and how many more there were."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

logger = logging.getLogger(__name__)

_EVERY_S = 1.0


class RefusalLog:
    """At most one line a second, so that a client that insists drowns nothing; what is left out is counted.

    Thread-safe.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        """Nothing was refused yet; ``now_s`` is any monotonic clock [s]."""
        self._now_s = now_s
        self._lock = threading.Lock()
        self._said_s = -_EVERY_S
        self._left_out = 0

    def add(self, what: str, error: Exception) -> None:
        """A refusal of ``what``, e.g. "message 3 of 'host:1' on lab/arm/plan"."""
        with self._lock:
            if self._now_s() - self._said_s < _EVERY_S:
                self._left_out += 1
                return
        self.tell()
        with self._lock:
            self._said_s = self._now_s()
        logger.warning("refused: %s: %s", what, error)

    def tell(self) -> None:
        """Say how many were left out, once their second is over. Call now and then, and at the end."""
        with self._lock:
            left_out = self._left_out
            if not left_out or self._now_s() - self._said_s < _EVERY_S:
                return
            self._left_out = 0
        logger.warning("%d more refused since then", left_out)
