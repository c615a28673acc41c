"""What tick the executor is at, seen from another clock: the host's estimate for orders that name a moment.

Every answer gives four stamps, two of them equal: sent and received on our clock, the executor's tick in between. An
answer with a short round trip bounds the offset to half of it (Cristian, "Probabilistic clock synchronization", 1989);
a straight line through the best answers of the last minutes also knows how fast the clocks drift apart.
"""

from __future__ import annotations

from collections import deque

import numpy as np

_LONG_ENOUGH_S = 3.0
"""Spread of the answers in time from which on their slope says more than that clocks run alike."""


class TickClock:
    """Maps our monotonic clock [s] to the executor's ticks."""

    def __init__(self, tick_s: float, remembered: int = 120) -> None:
        """Args:
        tick_s: Length of a tick [s].
        remembered: Answers to keep; the better half of them by round trip is used.
        """
        self._tick_s = tick_s
        self._answers: deque[tuple[float, float, float]] = deque(maxlen=remembered)
        self._line: tuple[float, float, float] | None = None

    def observe(self, sent_s: float, tick: int, received_s: float) -> None:
        """One answer: asked at ``sent_s``, answered with ``tick``, received at ``received_s`` (our clock)."""
        # A tick counter is read half a tick late on average.
        self._answers.append(((sent_s + received_s) / 2, tick + 0.5, received_s - sent_s))
        self._line = None

    def tick_at(self, time_s: float) -> float:
        """The executor's tick at ``time_s`` of our clock, with fractions.

        Raises:
            ValueError: Nothing has been observed yet.
        """
        if self._line is None:
            self._line = self._fit()
        middle_s, tick, rate = self._line
        return tick + rate * (time_s - middle_s)

    def _fit(self) -> tuple[float, float, float]:
        if not self._answers:
            raise ValueError("no answer of the executor has been observed yet")
        t, tick, trip = np.array(self._answers).T
        best = trip <= np.median(trip)
        t, tick, weight = t[best], tick[best], 1.0 / (trip[best] + self._tick_s / 4) ** 2
        middle = float(np.average(t, weights=weight))
        level = float(np.average(tick, weights=weight))
        spread = float(np.average((t - middle) ** 2, weights=weight))
        rate = 1.0 / self._tick_s
        if spread > _LONG_ENOUGH_S**2:
            rate = float(np.average((t - middle) * (tick - level), weights=weight)) / spread
        return middle, level, rate
