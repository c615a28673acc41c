"""What is executed stays near what was checked, the nearer the narrower it is there."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.cartesian import straight_line
from s2r_host.motion.escape import MARGINS_M
from s2r_host.motion.inverse import InverseKinematics
from s2r_host.run.travel import timed
from s2r_protocol.arms import load_arm

ARM = ArmModel(load_arm("xmate3pro"))
SESSION = SimpleNamespace(arm=ARM)
SPEED = 0.25


def tip(q):
    return np.array([ARM.tool_pose(row)[:3, 3] for row in q])


@pytest.fixture(scope="module")
def corners():
    """Joint paths a few millimetres back and a decimetre out in another direction, from random postures."""
    ik, rng, found = InverseKinematics(ARM), np.random.default_rng(0), []
    while len(found) < 10:
        q = ARM.arm.q_home + rng.uniform(-0.35, 0.35, 7)
        back_way, out_way = (d / np.linalg.norm(d) for d in rng.normal(size=(2, 3)))
        back = straight_line(
            ARM, ik, q, tip([q])[0] + rng.choice([0.005, 0.012, 0.018]) * back_way, spacing_m=0.002
        )
        out = None if back is None else straight_line(ARM, ik, back[-1], tip(back[-1:])[0] + 0.1 * out_way)
        if out is not None:
            found.append(np.concatenate([back, out[1:]]))
    return found


@pytest.mark.parametrize("margin_m", MARGINS_M)
def test_a_narrow_way_out_is_left_by_half_of_its_margin_at_most(corners, margin_m):
    off = []
    for q in corners:
        motion = timed(SESSION, q, "out of contact", SPEED, clearance_m=margin_m).trajectory
        checked = tip(np.concatenate([np.linspace(a, b, 20) for a, b in pairwise(q)]))
        played = tip(motion.sample(np.linspace(0.0, motion.duration_s, 300))[0])
        off.append(np.linalg.norm(played[:, None] - checked[None], axis=2).min(axis=1).max())
    assert max(off) < 0.5 * margin_m


def test_a_way_through_the_air_is_as_quick_as_ever(corners):
    durations = [
        timed(SESSION, corners[0], "", SPEED, clearance_m=clearance_m).trajectory.duration_s
        for clearance_m in (np.inf, 0.1)
    ]
    assert durations[0] == durations[1]
