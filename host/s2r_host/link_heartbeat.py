"""The sign of life of whoever holds the lease."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import zenoh

logger = logging.getLogger(__name__)

HEARTBEAT_PERIOD_S = 0.01


class Heart:
    """A thread that says "still here" every 10 ms until stopped; ``error`` is what ended it before that."""

    def __init__(self, session: zenoh.Session, key: str, beat: Callable[[int], bytes]) -> None:
        """Start beating.

        Args:
            session: Stays the caller's.
            key: Where to put.
            beat: The bytes of the n-th beat.
        """
        self._publisher = session.declare_publisher(key)
        self._beat = beat
        self._ended = threading.Event()
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="s2r-heartbeat", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread; returns once it has ended."""
        self._ended.set()
        self._thread.join()
        self._publisher.undeclare()

    def _run(self) -> None:
        count = 0
        try:
            while not self._ended.wait(HEARTBEAT_PERIOD_S):
                count += 1
                self._publisher.put(self._beat(count))
        except Exception as error:  # in this thread nobody would hear of it
            self.error = error
            logger.exception("the heartbeat ended after %d beats", count)
