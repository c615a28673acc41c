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
    """Smoothed rows every 5 ms, whatever the cycle of the bus; None without torques or with too little motion."""
    moving = np.flatnonzero(np.abs(joints.dq).max(axis=1) > MOVING_RAD_S)
    if joints.tau is None or len(moving) < 2:
        return None
    rows = slice(moving[0], moving[-1] + 1)
    t = joints.t[rows]
    dt = float(np.median(np.diff(t)))
    window = 2 * max(2, round(WINDOW_S / dt / 2)) + 1
    if len(t) < 4 * window:
        return None
    dq, ddq, tau = (
        np.asarray(savgol_filter(values[rows], window, 2, deriv=order, delta=dt, axis=0))
        for values, order in ((joints.dq, 0), (joints.dq, 1), (joints.tau, 0))
    )
    found = Samples(t, joints.q[rows], dq, ddq, tau)
    step = round(EVERY_S / dt)
    whole = step >= 1 and abs(step * dt - EVERY_S) < WHOLE_SHARE * EVERY_S
    return found.part(slice(None, None, step)) if whole else _between(found)


def _between(rows: Samples) -> Samples:
    """Rows every 5 ms between others: speeds and times are counted in such rows."""
    t = np.arange(rows.t[0], rows.t[-1], EVERY_S)
    columns = (
        np.column_stack([np.interp(t, rows.t, column) for column in values.T])
        for values in (rows.q, rows.dq, rows.ddq, rows.tau)
    )
    return Samples(t, *columns)
