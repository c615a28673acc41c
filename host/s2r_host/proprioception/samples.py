"""A recorded motion of the arm, smoothed and thinned: what identification works on."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter

from s2r_host.log.tables import Joints, joints_of, read_recording

WINDOW_S = 0.03  # of the smoothing; servo ripple is faster, contact slower
EVERY_S = 0.005
WHOLE_SHARE = 0.002  # of that: a cycle that goes so exactly into it leaves rows as they are
MOVING_RAD_S = 0.003
LOST_SHARE = 1.5  # of the usual time between two rows: one between them is lost


@dataclass(frozen=True, eq=False)
class Samples:
    """Rows of one motion, from its first movement to its last.

    Attributes:
        t: Time since the recording began [s], (n,).
        q, dq, ddq: Joint positions, speeds, accelerations [rad, rad/s, rad/s²], (n, dof).
        tau: Joint torques [N·m], (n, dof).
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    tau: np.ndarray

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.t)

    def part(self, rows: slice | np.ndarray) -> Samples:
        """Some of the rows."""
        return Samples(self.t[rows], self.q[rows], self.dq[rows], self.ddq[rows], self.tau[rows])


def samples_in(recording: bytes) -> Samples | None:
    """Rows of an executor's recording (MCAP); None when it has no torques or too little motion."""
    with tempfile.TemporaryDirectory(prefix="s2r-") as folder:
        path = Path(folder) / "motion.mcap"
        path.write_bytes(recording)
        topics = read_recording(path).topics
    topic = next((t for name, t in topics.items() if name.endswith("/joint_states") and t.messages), None)
    joints = joints_of(topic, "executor") if topic is not None else None
    return samples_of(joints) if joints is not None else None


def samples_of(joints: Joints) -> Samples | None:
    """Smoothed rows every 5 ms, whatever the cycle of the bus; None without torques or with too little motion.

    Speeds and times are counted in rows, so rows that a recording lost are filled in; None where it lost so many in a
    row that what happened between them, a touch even, is not known.
    """
    moving = np.flatnonzero(np.abs(joints.dq).max(axis=1) > MOVING_RAD_S)
    if joints.tau is None or len(moving) < 2:
        return None
    rows = slice(moving[0], moving[-1] + 1)
    t, *columns = joints.t[rows], joints.q[rows], joints.dq[rows], joints.tau[rows]
    gaps = np.diff(t)
    dt = float(np.median(gaps))
    if gaps.max() > WINDOW_S + dt:
        return None
    if gaps.max() > LOST_SHARE * dt:
        even = t[0] + dt * np.arange(1 + round((t[-1] - t[0]) / dt))
        columns, t = [_at(even, t, values) for values in columns], even
    q, dq_told, tau_told = columns
    window = 2 * max(2, round(WINDOW_S / dt / 2)) + 1
    if len(t) < 4 * window:
        return None
    dq, ddq, tau = (
        np.asarray(savgol_filter(values, window, 2, deriv=order, delta=dt, axis=0))
        for values, order in ((dq_told, 0), (dq_told, 1), (tau_told, 0))
    )
    found = Samples(t, q, dq, ddq, tau)
    step = round(EVERY_S / dt)
    whole = step >= 1 and abs(step * dt - EVERY_S) < WHOLE_SHARE * EVERY_S
    return found.part(slice(None, None, step)) if whole else _between(found)


def _between(rows: Samples) -> Samples:
    """Rows every 5 ms between others: speeds and times are counted in such rows."""
    t = np.arange(rows.t[0], rows.t[-1], EVERY_S)
    return Samples(t, *(_at(t, rows.t, values) for values in (rows.q, rows.dq, rows.ddq, rows.tau)))


def _at(t: np.ndarray, t_have: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (n, dof) that are known at some times, at others: on a straight line between the two next to each."""
    return np.column_stack([np.interp(t, t_have, column) for column in values.T])
