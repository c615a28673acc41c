"""What is shown instead of the live arm: an opened recording, scrubbed by the operator."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from s2r_host.log.tables import Joints


@dataclass(frozen=True, eq=False)
class Opened:
    """A recording on show: its name and measured and commanded joints on one time base ``t`` [s]."""

    name: str
    t: np.ndarray
    q: np.ndarray
    q_ref: np.ndarray | None


class Playback:
    """Thread-safe holder of the opened recording and the time shown."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._opened: Opened | None = None
        self._t = 0.0

    @property
    def opened(self) -> Opened | None:
        """The recording on show; None while the live arm is."""
        return self._opened

    @property
    def t(self) -> float:
        """The time shown [s]."""
        return self._t

    def open(self, opened: Opened | None, t: float = 0.0) -> None:
        """Show a recording at a time [s], or the live arm again."""
        with self._lock:
            self._opened, self._t = opened, t

    def seek(self, t: float) -> None:
        """Show another time [s]."""
        with self._lock:
            self._t = t

    def pose(self) -> tuple[np.ndarray, np.ndarray | None] | None:
        """Measured and commanded joints at the time shown [rad]."""
        with self._lock:
            opened, t = self._opened, self._t
        if opened is None:
            return None
        i = int(np.clip(np.searchsorted(opened.t, t), 0, len(opened.t) - 1))
        return opened.q[i], None if opened.q_ref is None else opened.q_ref[i]


def packed(joints: Joints, reference: Joints | None, name: str, pause_s: float = 0.3) -> Opened:
    """A recording on a time base without the pauses between its motions."""
    steps = np.diff(joints.t, prepend=0.0)
    usual = float(np.median(steps[1:])) if len(steps) > 1 else 0.0
    t = np.cumsum(np.where(steps > pause_s, max(usual, pause_s), steps))
    q_ref = None
    if reference is not None:
        seconds = (reference.stamp_ns - joints.stamp_ns[0]) * 1e-9
        q_ref = np.column_stack([np.interp(joints.t, seconds, column) for column in reference.q.T])
    keep = np.unique(np.searchsorted(t, np.arange(0.0, t[-1] + 0.02, 0.02)).clip(0, len(t) - 1))
    return Opened(name, t[keep], joints.q[keep], None if q_ref is None else q_ref[keep])
