"""Handles with equal spokes: which way they went is open, and the estimator says so."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_host.perception import AbstainError, estimate_joint, synthetic
from s2r_host.perception.change import compare
from s2r_host.perception.evidence import Scene, probe
from s2r_host.perception.motion import JointMotion, Push, rotation
from s2r_host.perception.symmetry import other_turn, refuse_two_turns, spokes
from s2r_host.perception.synthetic import Box, look_at
from s2r_host.perception.view import DepthView

PIVOT = np.array([0.6, 0.0, 0.16])
UP = np.array([0.0, 0.0, 1.0])
K, SHAPE = np.array([[460.0, 0, 320], [0, 460.0, 180], [0, 0, 1]]), (360, 640)


def turned_handle(count: int, turn_deg: float) -> synthetic.Pair:
    """A handle of equal spokes 9 cm long, flat side up, on a column; turned about the column."""
    column = np.eye(4)
    column[:3, 3] = (0.6, 0.0, 0.07)
    table = np.eye(4)
    table[:3, 3] = (0.7, 0.0, -0.01)
    static = [Box(table, np.array([1.2, 1.2, 0.02])), Box(column, np.array([0.03, 0.03, 0.14]))]
    part = []
    for k in range(count):
        X = np.eye(4)
        X[:3, :3] = rotation(UP, 0.4 + 2 * np.pi * k / count)
        X[:3, 3] = PIVOT + X[:3, :3] @ np.array([0.045, 0.0, 0.0])
        part.append(Box(X, np.array([0.09, 0.022, 0.014])))
    motion = JointMotion("revolute", PIVOT, UP, np.radians(turn_deg))
    camera = look_at(np.array([0.05, 0.15, 0.6]), PIVOT)
    return synthetic.pair(static, part, motion, K, SHAPE, camera, np.random.default_rng(count))


def spokes_found(pair: synthetic.Pair) -> int:
    before, after = DepthView(pair.before), DepthView(pair.after)
    everywhere = np.ones(len(before.points), bool), np.ones(len(after.points), bool)
    scene = Scene(before, after, compare(before, after), *everywhere)
    rng = np.random.default_rng(0)
    probes = probe(before, scene.moved_before(), 1000, rng), probe(after, scene.moved_after(), 1000, rng)
    return spokes(pair.motion, scene, probes)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_spokes_are_counted(count):
    assert spokes_found(turned_handle(count, 40)) == count


def test_a_slide_has_no_spokes():
    pair = synthetic.drawer_pair(np.random.default_rng(0))
    assert spokes_found(pair) == 1


def test_a_cross_turned_past_half_its_spacing_is_not_answered():
    with pytest.raises(AbstainError, match="looks alike after every 120 degrees"):
        estimate_joint(*both(turned_handle(3, 68)))


@pytest.mark.parametrize(("turn_deg", "other_deg"), [(50, 40), (100, 80), (150, 30)])
def test_a_cross_may_have_turned_the_other_way_however_far_it_seems_to_have_gone(turn_deg, other_deg):
    seen = JointMotion("revolute", PIVOT, UP, np.radians(turn_deg))
    other = other_turn(seen, 4)
    assert other is not None
    assert np.degrees(other.delta) == pytest.approx(other_deg)
    assert other.direction == pytest.approx(-UP)
    quarters = 4 * (seen.delta + other.delta) / (2 * np.pi)  # either way every spoke lies where one was
    assert quarters == pytest.approx(round(quarters))
    with pytest.raises(AbstainError, match="looks alike after every 90 degrees"):
        refuse_two_turns(seen, other, 4)


def test_a_cross_turned_a_little_is_answered():
    found = estimate_joint(*both(turned_handle(3, 22)))
    assert found.joint_type == "revolute"
    assert np.degrees(found.delta) == pytest.approx(22, abs=3)
    assert found.axis_direction[2] > 0.99


def both(pair: synthetic.Pair) -> tuple[synthetic.DepthFrame, synthetic.DepthFrame]:
    return pair.before, pair.after


@pytest.mark.parametrize("turn_deg", [26, -26, 50, -50])
def test_a_push_between_the_views_tells_which_way_equal_spokes_went(turn_deg):
    pair = turned_handle(4, turn_deg)
    hinge = pair.motion
    p = hinge.origin + np.array([0.06, 0.0, 0.0])
    way = np.sign(hinge.delta) * np.cross(hinge.direction, p - hinge.origin)
    found = estimate_joint(pair.before, pair.after, pushed=[Push(p, way / np.linalg.norm(way))])
    signed = found.delta * np.sign(found.axis_direction @ hinge.direction)
    assert np.degrees(abs(signed - hinge.delta)) < 1.0


def test_a_motion_against_the_push_is_not_believed():
    pair = synthetic.laptop_pair(np.random.default_rng(3))
    p = pair.motion.origin + np.array([0.0, 0.0, 0.1])
    way = -np.sign(pair.motion.delta) * np.cross(pair.motion.direction, p - pair.motion.origin)
    with pytest.raises(AbstainError):
        estimate_joint(pair.before, pair.after, pushed=[Push(p, way / np.linalg.norm(way))])
