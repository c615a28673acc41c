"""Who may move the arm: one holder at a time, alive as long as its heartbeat is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LeaseDecision:
    """Answer to a request; ``reason`` is one sentence when refused."""

    granted: bool
    holder: str
    reason: str = ""


class Lease:
    """One holder or none. Pure bookkeeping: the caller passes the time and acts on the answers."""

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._holder = ""
        self._last_beat_s = 0.0
        self.late_beats = 0

    @property
    def holder(self) -> str:
        """Name of the holder; empty if there is none."""
        return self._holder

    def request(self, sender: str, now_s: float) -> LeaseDecision:
        """Grant to the first who asks; asking again renews."""
        if not sender:
            return LeaseDecision(False, self._holder, "a lease needs the name of its holder")
        if self._holder not in ("", sender):
            return LeaseDecision(
                False,
                self._holder,
                f"'{self._holder}' holds the lease; it ends {self._timeout_s:g} s after its last heartbeat",
            )
        self._holder = sender
        self._last_beat_s = now_s
        return LeaseDecision(True, sender)

    def release(self, sender: str) -> LeaseDecision:
        """Give back; only the holder can."""
        if sender != self._holder:
            return LeaseDecision(False, self._holder, f"'{sender}' does not hold the lease")
        self._holder = ""
        return LeaseDecision(True, "")

    def beat(self, sender: str, now_s: float) -> bool:
        """Count a heartbeat; False if it is not the holder's."""
        if not sender or sender != self._holder:
            return False
        if now_s - self._last_beat_s > self._timeout_s / 2:
            self.late_beats += 1
        self._last_beat_s = now_s
        return True

    def silence_s(self, now_s: float) -> float:
        """Time since the holder's last sign of life; 0 without a holder."""
        return now_s - self._last_beat_s if self._holder else 0.0

    def expire(self, now_s: float) -> str:
        """Take the lease from a silent holder; returns its name, or "" if nothing happened."""
        if not self.silence_s(now_s) > self._timeout_s:
            return ""
        lost, self._holder = self._holder, ""
        return lost
