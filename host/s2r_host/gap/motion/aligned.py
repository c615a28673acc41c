"""Late stamps set right before effort and motion are compared.

Where the declared control law tells how late a joint's position was stamped, the rest of the analysis need not carry
that lag along: as a shift of the effort it would stand beside friction that turned round elsewhere, and take damping
with it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from s2r_host.gap.motion.law import LawFinding
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session, make_session
from s2r_host.gap.recordings.recording import Recording

MOVED = ("q", "dq")  # channels of the sensor whose stamps are late


def lags_of(law: list[LawFinding]) -> dict[int, float]:
    """How late the control law says that positions are stamped [s], by joint."""
    return {f.joint: f.shape["lag"] for f in law if f.name == "clock_skew"}


def aligned(model: RigidModel, sessions: list[Session], lags: dict[int, float]) -> list[Session]:
    """The recordings with position and speed of some joints moved to where they belong, as sessions of their own.

    Args:
        model: The nominal model.
        sessions: Recordings as read.
        lags: Joint index -> how late its position and speed are stamped [s].
    """
    by_name = {model.joints[j]: lag for j, lag in lags.items()}
    return [make_session(model, _moved(s.rec, by_name), s.index) for s in sessions]


def _moved(rec: Recording, lags: dict[str, float]) -> Recording:
    """A recording whose motion is read ``lags`` later than stamped, as far as it was recorded."""
    first, last = rec.t[0] - min([0.0, *lags.values()]), rec.t[-1] - max([0.0, *lags.values()])
    kept = (rec.t >= first) & (rec.t <= last)
    channels = {kind: {name: x[kept] for name, x in table.items()} for kind, table in rec.channels.items()}
    for kind in MOVED:
        for joint, x in rec.channels.get(kind, {}).items():
            if joint in lags:
                channels[kind][joint] = np.asarray(CubicSpline(rec.t, x)(rec.t[kept] + lags[joint]))
    t = rec.t[kept]
    doubt = {name: x[kept] for name, x in rec.effort_doubt.items()}
    return replace(
        rec, t=t - t[0], channels=channels, start_s=rec.start_s + float(t[0] - rec.t[0]), effort_doubt=doubt
    )
