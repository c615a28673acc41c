"""Effort and motion of the link alone, where the position is read behind a compliant gear.

Where position and speed of a joint tell a spring or play between them (``kinematics.py``), the speed is the motor's and
the position the link's. A rigid model that takes both for one motion would look for what it leaves over among delays,
friction and tilts. So the motor's own share beyond the rigid motion is taken off the effort, and the link's speed is
read from its position (two masses: Spong, Journal of Dynamic Systems, Measurement, and Control 109, 1987).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from s2r_host.gap.motion.lost_rows import bridged
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session, lowpass, make_session
from s2r_host.gap.recordings.recording import Recording


def links_alone(model: RigidModel, sessions: list[Session], joints: list[int]) -> list[Session]:
    """The recordings as the links of some joints would have made them on a rigid gear, as sessions of their own."""
    made = []
    for s in sessions:
        rec = s.rec
        for j in joints:
            rec = _link_alone(model, rec, s, j)
        made.append(make_session(model, rec, s.index))
    return made


def _link_alone(model: RigidModel, rec: Recording, s: Session, joint: int) -> Recording:
    name, m = model.joints[joint], model.model
    tau = rec.get("tau", name)
    if tau is None or rec.get("q", name) is None or rec.get("dq", name) is None:
        return rec
    full, _ = bridged(model, rec)
    even = np.arange(0.0, rec.t[-1] + 1e-9, rec.dt)

    def smooth(kind: str) -> CubicSpline:
        x = np.interp(even, full.t, full.channels[kind][name])
        return CubicSpline(even, lowpass(x, float(s.motion_cut[joint]), rec.dt))

    link, motor = smooth("q"), smooth("dq")
    v, w = link(rec.t, 1), motor(rec.t)
    v_eps = float(s.v_eps[joint])
    more = (
        float(m.dof_armature[joint]) * (motor(rec.t, 1) - link(rec.t, 2))
        + float(m.dof_damping[joint]) * (w - v)
        + float(m.dof_frictionloss[joint]) * (np.tanh(w / v_eps) - np.tanh(v / v_eps))
    )
    channels = {kind: dict(table) for kind, table in rec.channels.items()}
    channels["tau"][name], channels["dq"][name] = tau - more, v
    return replace(rec, channels=channels)
