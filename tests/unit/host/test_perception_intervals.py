"""90 % intervals of a joint estimate: what widens them and what narrows them."""

import numpy as np
import pytest

from s2r_host.perception.intervals import intervals90
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.refine import Refined

UP = np.array([0.0, 0.0, 1.0])


def turned(angle_deg=40.0, residual_m=0.0005, tilt_deg=0.0, **more):
    axis = np.array([np.sin(np.radians(tilt_deg)), 0.0, np.cos(np.radians(tilt_deg))])
    motion = JointMotion("revolute", np.zeros(3), axis, np.radians(angle_deg))
    return Refined(motion, residual_m, 1e-8 * np.eye(5), 1000, **more)


def slid(residual_m):
    return Refined(JointMotion("prismatic", np.zeros(3), UP, 0.05), residual_m, 1e-9 * np.eye(3), 1000)


def widths(found, **how):
    iv = intervals90([(found, 1.0)], np.zeros(3), **how)
    return np.degrees(iv.axis_angle_rad), 1e3 * iv.axis_offset_m, np.degrees(iv.delta[1] - iv.delta[0])


def test_a_residual_and_a_short_turn_widen_a_hinge():
    usual, bad, short = widths(turned()), widths(turned(residual_m=0.002)), widths(turned(10.0))
    assert all(b > 1.3 * u for b, u in zip(bad, usual, strict=True))
    assert short[0] > 1.5 * usual[0]
    assert short[1] > 1.05 * usual[1]


def test_a_slide_is_known_to_parts_of_a_degree_and_of_a_millimetre():
    good, bad = (intervals90([(slid(residual), 1.0)], np.zeros(3)) for residual in (0.0003, 0.001))
    assert np.degrees(good.axis_angle_rad) < 0.5 < np.degrees(bad.axis_angle_rad)
    assert good.delta[1] - good.delta[0] < 0.0005 < bad.delta[1] - bad.delta[0]
    assert good.axis_offset_m == 0.0


def test_what_is_as_mounted_is_not_read_off_a_levers_rims():
    free, level, upright = (widths(turned(exact=exact), thin=True)[0] for exact in (0, 1, 2))
    assert free > 5.0
    assert level == pytest.approx(free / np.sqrt(2), rel=0.1)
    assert upright < 2.0


def test_an_edge_and_another_face_widen():
    usual = widths(turned())
    for other in (widths(turned(), edge_on=True), widths(turned(plate_m=0.01))):
        assert other[0] > 1.2 * usual[0]
        assert other[1] > 1.5 * usual[1]
    assert widths(turned(plate_m=0.001))[1] > 1.5 * widths(turned(plate_m=0.01))[1]


def test_a_rival_widens_by_its_share():
    best, rival = turned(), turned(tilt_deg=10.0)
    known = [
        np.degrees(intervals90([(best, 1.0), (rival, w)], np.zeros(3)).axis_angle_rad) for w in (0.05, 0.3)
    ]
    assert known[0] < 3.0
    assert known[1] > 10.0
