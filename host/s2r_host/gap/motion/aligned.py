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

MOTION, EFFORT = ("q", "dq"), ("tau",)  # channels of the sensors whose stamps may be late

Lags = dict[tuple[str, int], float]  # channel and joint -> how late it is stamped [s]


def lags_of(law: list[LawFinding]) -> Lags:
    """How late the control law says that channels are stamped."""
    return {
        (kind, f.joint): -f.shape["lag"] if f.of_effort else f.shape["lag"]
        for f in law
        if f.name == "clock_skew"
        for kind in (EFFORT if f.of_effort else MOTION)
    }


def aligned(model: RigidModel, sessions: list[Session], lags: Lags) -> list[Session]:
    """The recordings with channels of some joints moved to where they belong, as sessions of their own.

    Args:
        model: The nominal model.
        sessions: Recordings as read.
        lags: Channels that are stamped late.
    """
    by_name = {(kind, model.joints[j]): lag for (kind, j), lag in lags.items()}
    return [make_session(model, _moved(s.rec, by_name), s.index) for s in sessions]


def _moved(rec: Recording, lags: dict[tuple[str, str], float]) -> Recording:
    """A recording of which some channels are read later than stamped, as far as they were recorded."""
    first, last = rec.t[0] - min([0.0, *lags.values()]), rec.t[-1] - max([0.0, *lags.values()])
    kept = (rec.t >= first) & (rec.t <= last)
    channels = {kind: {name: x[kept] for name, x in table.items()} for kind, table in rec.channels.items()}
    for (kind, joint), lag in lags.items():
        raw = rec.channels.get(kind, {}).get(joint)
        if raw is not None:
            channels[kind][joint] = np.asarray(CubicSpline(rec.t, raw)(rec.t[kept] + lag))
    t = rec.t[kept]
    doubt = {name: x[kept] for name, x in rec.effort_doubt.items()}
    return replace(
        rec, t=t - t[0], channels=channels, start_s=rec.start_s + float(t[0] - rec.t[0]), effort_doubt=doubt
    )
