"""Lock-step: while the stand-in computes, or its machine stalls, simulated time stands still; nobody is late then."""

from __future__ import annotations

import logging

from s2r_executor.core import CoreSnapshot

logger = logging.getLogger(__name__)

SAY_AFTER_S = 5.0
_GIVE_UP_S = 60.0
_LOOK_S = 0.05  # looks come every few milliseconds


class Patience:
    """How long somebody has waited for the core.

    With the real clock that is wall time. In lock-step only stretches in which the core ticked count: it takes orders
    at its ticks, and while it waits for the stand-in it has none. A long stretch between two looks says that who looks
    was stalled himself, perhaps together with the core: only a little of it counts.
    """

    def __init__(self, limit_s: float, stepped: bool, tick: int, now_s: float) -> None:
        """Start to wait.

        Args:
            limit_s: Wall time to grant.
            stepped: The core's clock is lock-step.
            tick: Of the core, now.
            now_s: Any monotonic clock [s].
        """
        self._limit_s = limit_s
        self._stepped = stepped
        self._tick = tick
        self._began_s = self._seen_s = now_s
        self._counted_s = 0.0

    def ended(self, core: CoreSnapshot, now_s: float) -> bool:
        """Whether the limit is used up; after a minute of standing still it is as well."""
        stands_still = self._stepped and core.alive and core.tick == self._tick
        if not stands_still:
            passed_s = now_s - self._seen_s
            self._counted_s += min(passed_s, _LOOK_S) if self._stepped and core.alive else passed_s
        self._tick, self._seen_s = core.tick, now_s
        return self._counted_s > self._limit_s or now_s - self._began_s > self._limit_s + _GIVE_UP_S


class StallWatch:
    """Says once per stall that simulated time stands still, and when it goes on."""

    def __init__(self) -> None:
        """Nothing has been seen yet."""
        self._tick: int | None = None
        self._since_s = 0.0
        self._said = False

    def look(self, core: CoreSnapshot, now_s: float) -> None:
        """Call every few milliseconds of a lock-step executor."""
        if core.tick == self._tick and core.alive:
            if not self._said and now_s - self._since_s > SAY_AFTER_S:
                self._said = True
                logger.warning(
                    "tick %d waits for the stand-in since %.0f s: simulated time stands still; "
                    "its log says whether this machine or its disk is too busy",
                    core.tick,
                    now_s - self._since_s,
                )
            return
        if self._said:
            logger.warning(
                "the stand-in answered after %.1f s: simulated time goes on", now_s - self._since_s
            )
        self._tick, self._since_s, self._said = core.tick, now_s, False
