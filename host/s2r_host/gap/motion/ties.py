"""Joints that a model ties to others: the mimic joints of a URDF, a gripper's second finger, a parallelogram.

The drive of the leading joint moves them as well, and feels what they need. In MuJoCo they are equality constraints
between two joints; inverse dynamics without constraints knows nothing of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.ndimage import uniform_filter1d

from s2r_host.gap.motion.time_spans import time_spans
from s2r_host.gap.recordings.recording import Recording, resolution

JOINTS = int(mujoco.mjtEq.mjEQ_JOINT)
# What does not part yet: share of the follower's way, encoder steps, noises; and the time over which the mean is taken.
PARTED, STEPS, NOISES, SMOOTH_S = 0.01, 5.0, 3.0, 0.05


@dataclass(frozen=True)
class Tie:
    """One joint as a polynomial of another: q_follower - r_follower = Σ c_k (q_leader - r_leader)^k.

    Attributes:
        follower, leader: Degrees of freedom.
        polynomial: c_0 … c_4.
        at: References r of follower and leader [rad or m].
    """

    follower: int
    leader: int
    polynomial: np.polynomial.Polynomial
    at: tuple[float, float]

    def position(self, leader: np.ndarray) -> np.ndarray:
        """Where the follower is for positions of the leader, shape (time,)."""
        return self.at[0] + self.polynomial(leader - self.at[1])

    def slope(self, leader: np.ndarray) -> np.ndarray:
        """Speed of the follower over that of the leader, shape (time,)."""
        return self.polynomial.deriv()(leader - self.at[1])

    def moves(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, speed and acceleration of the follower for those of the leader, shape (time,) each."""
        slope, bend = self.slope(q), self.polynomial.deriv(2)(q - self.at[1])
        return self.position(q), slope * v, slope * a + bend * v**2


def ties_of(model: mujoco.MjModel) -> tuple[Tie, ...]:
    """Active ties between two joints, those first whose follower leads nobody that has not been before it."""
    found = []
    for e in range(model.neq):
        if int(model.eq_type[e]) != JOINTS or not model.eq_active0[e] or int(model.eq_obj2id[e]) < 0:
            continue
        follower, leader = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        at = float(model.qpos0[model.jnt_qposadr[follower]]), float(model.qpos0[model.jnt_qposadr[leader]])
        polynomial = np.polynomial.Polynomial(model.eq_data[e, :5])
        found.append(Tie(int(model.jnt_dofadr[follower]), int(model.jnt_dofadr[leader]), polynomial, at))
    leads = {t.follower: t.leader for t in found}

    def depth(joint: int, seen: int = 0) -> int:
        return seen if joint not in leads or seen > len(leads) else depth(leads[joint], seen + 1)

    return tuple(sorted(found, key=lambda t: -depth(t.follower)))


def led(ties: tuple[Tie, ...], q: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Efforts with those of followers added to their leaders, in place, shape (time, joint) as the positions ``q``."""
    for tie in ties:
        effort[:, tie.leader] += tie.slope(q[:, tie.leader]) * effort[:, tie.follower]
    return effort


@dataclass(frozen=True)
class Parting:
    """How far follower and leader part in a recording, in the follower's unit.

    Attributes:
        size: Of it (rms); ``noise`` is what encoders and a hundredth of the way explain.
        intervals: Where it is more than that [s].
    """

    size: float
    noise: float
    intervals: list[list[float]]


def parting(tie: Tie, rec: Recording, names: tuple[str, ...]) -> Parting | None:
    """None where one of the two was not recorded. A constant is the zero of an encoder."""
    follower, leader = (rec.get("q", names[j]) for j in (tie.follower, tie.leader))
    if follower is None or leader is None:
        return None
    off = follower - tie.position(leader)
    off = off - np.median(off)
    mean = uniform_filter1d(off, max(1, round(SMOOTH_S / rec.dt)), mode="nearest")
    step = max(resolution(x) for x in (follower, leader))
    noise = max(STEPS * step, NOISES * float(np.std(off - mean)), PARTED * float(np.ptp(follower)))
    apart = time_spans(rec.t[np.abs(mean) > noise] + rec.start_s)
    return Parting(float(np.sqrt(np.mean(mean**2))), noise, apart)
