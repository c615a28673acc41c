"""A hinge stands on something."""

from itertools import pairwise

import numpy as np
import pytest

from s2r_host.perception import synthetic
from s2r_host.perception.change import compare
from s2r_host.perception.errors import AbstainError
from s2r_host.perception.evidence import Scene
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.segment import segment
from s2r_host.perception.standing import solid_m
from s2r_host.perception.synthetic import Box, beam, look_at
from s2r_host.perception.verdict import require_standing
from s2r_host.perception.view import DepthView

PIVOT, UP = np.array([0.6, 0.0, 0.18]), np.array([0.0, 0.0, 1.0])
K, SHAPE = np.array([[460.0, 0, 320], [0, 460.0, 180], [0, 0, 1]]), (360, 640)
TURN = JointMotion("revolute", PIVOT, UP, np.radians(25.0))
IN_AIR = JointMotion("revolute", PIVOT + np.array([-0.07, -0.03, 0.0]), UP, np.radians(25.0))


@pytest.fixture(scope="module")
def scene(lever_on_column):
    """A lever of 11 cm on a column, turned by 25° about it."""
    lever = beam(PIVOT, PIVOT + np.array([-0.05, -0.1, 0.01]), 0.02, 0.014)
    return lever_on_column(lever, TURN)


def test_more_of_the_axis_is_solid_the_nearer_it_is_to_the_column(scene):
    part = scene.before.points[segment(scene, TURN).before]
    shifts = [np.array([-0.07, -0.03, 0.0]) * share for share in (0.0, 0.5, 1.0)]
    solid = [
        solid_m(JointMotion("revolute", PIVOT + shift, UP, TURN.delta), part, scene, UP) for shift in shifts
    ]
    assert solid[0] > 0.028
    assert all(one >= two for one, two in pairwise(solid))
    assert solid[2] == 0.0


def test_the_sense_of_the_axis_does_not_matter(scene):
    part = scene.before.points[segment(scene, TURN).before]
    down = JointMotion("revolute", PIVOT, -UP, -TURN.delta)
    assert solid_m(down, part, scene, UP) == pytest.approx(solid_m(TURN, part, scene, UP))


@pytest.mark.parametrize("up", [UP, None])
def test_a_level_axis_has_no_sense_to_matter(scene, up):
    part = scene.before.points[segment(scene, TURN).before]
    level = np.array([0.3, -1.0, 0.0]) / np.hypot(0.3, 1.0)
    for away_m in (0.0, 0.02, 0.04):
        there = JointMotion("revolute", PIVOT + np.array([away_m, 0.0, 0.0]), level, 0.4)
        back = JointMotion("revolute", there.origin, -level, -0.4)
        assert solid_m(back, part, scene, up) == pytest.approx(solid_m(there, part, scene, up), abs=0.0041)


def test_a_hinge_in_the_air_is_refused_and_one_on_the_column_is_not(scene):
    parts = segment(scene, TURN)
    require_standing(TURN, parts, scene, UP)
    with pytest.raises(AbstainError, match="hang in the air"):
        require_standing(IN_AIR, parts, scene, UP)


def test_a_lid_does_not_hang_in_the_air_either():
    """A hinge 10 cm above the base, beside the lid, as a lid carried the wrong way needs one."""
    table, base = np.eye(4), np.eye(4)
    table[:3, 3], base[:3, 3] = (0.7, 0.0, -0.01), (0.7, 0.0, 0.01)
    hinge = np.array([0.8, 0.0, 0.02])
    static = [Box(table, np.array([1.2, 1.2, 0.02])), Box(base, np.array([0.2, 0.3, 0.02]))]
    open_lid = np.eye(4)
    open_lid[:3, :3] = [[0.5, 0.0, 0.866], [0.0, 1.0, 0.0], [-0.866, 0.0, 0.5]]  # leaning back
    open_lid[:3, 3] = hinge + open_lid[:3, :3] @ np.array([0.0, 0.0, 0.1])
    shut = JointMotion("revolute", hinge, np.array([0.0, -1.0, 0.0]), np.radians(40))
    camera = look_at(np.array([0.1, -0.2, 0.6]), np.array([0.7, 0.0, 0.1]))
    made = synthetic.pair(
        static,
        [Box(open_lid, np.array([0.006, 0.3, 0.2]))],
        shut,
        K,
        SHAPE,
        camera,
        np.random.default_rng(3),
    )
    before, after = DepthView(made.before), DepthView(made.after)
    everywhere = np.ones(len(before.points), bool), np.ones(len(after.points), bool)
    lid = Scene(before, after, compare(before, after), *everywhere)
    assert not lid.small()
    parts = segment(lid, shut)
    require_standing(shut, parts, lid, UP)
    wrong = JointMotion("revolute", hinge + np.array([-0.2, 0.0, 0.1]), -shut.direction, 0.3)
    with pytest.raises(AbstainError, match="hang in the air"):
        require_standing(wrong, parts, lid, UP)
