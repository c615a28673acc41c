"""Thin parts: lines, the axes they suggest, and what is wished of a joint beforehand."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.perception.hypotheses import Structure, axes
from s2r_host.perception.levers import (
    Column,
    _is_round,
    bisector_pivots,
    lever,
    lever_directions,
    line_pivots,
)
from s2r_host.perception.motion import JointMotion, line_distance, rotation
from s2r_host.perception.ranking import _along_lever, _askew, _distinct
from s2r_host.perception.wishes import Wishes

UP = np.array([0.0, 0.0, 1.0])
PIVOT = np.array([0.5, 0.1, 0.2])


def bar(angle, length=0.1, start=0.03, seed=0):
    """Points of a bar that sticks out from the pivot."""
    rng = np.random.default_rng(seed)
    out = np.array([np.cos(angle), np.sin(angle), 0.3])
    along = rng.uniform(start, length, 300)[:, None] * out / np.linalg.norm(out)
    return PIVOT + along + rng.normal(scale=0.002, size=(300, 3))


@pytest.fixture
def lines():
    return lever(bar(0.2)), lever(bar(0.8, seed=1))


def test_line_of_a_bar_is_found(lines):
    out = np.array([np.cos(0.2), np.sin(0.2), 0.3])
    assert abs(lines[0].direction @ out / np.linalg.norm(out)) > np.cos(np.radians(2))
    assert lines[0].length_m == pytest.approx(0.07, rel=0.15)


def test_plate_is_no_lever():
    rng = np.random.default_rng(0)
    assert (
        lever(np.column_stack([rng.uniform(0, 0.2, 500), rng.uniform(0, 0.15, 500), np.zeros(500)])) is None
    )


def test_stray_points_do_not_bend_the_line(lines):
    stray = np.array([[1.5, 1.5, 0.0]] * 20) + np.random.default_rng(2).normal(scale=0.01, size=(20, 3))
    found = lever(np.vstack([bar(0.2), stray]))
    assert np.linalg.norm(found.centre - lines[0].centre) < 0.002


def test_true_axis_is_among_the_pivots(lines):
    points = line_pivots(*lines, UP)
    assert min(line_distance(PIVOT, UP, np.array(points))) < 0.003
    middles = [PIVOT + 0.06 * np.array([np.cos(angle), np.sin(angle), 0.3]) for angle in (0.2, 0.8)]
    points = bisector_pivots(lines[0], *middles, UP)
    assert min(line_distance(PIVOT, UP, np.array(points))) < 0.006


def test_directions_hold_the_vertical_and_the_level_one_across_the_way(lines):
    found = lever_directions(None, None, np.zeros(3), np.array([0.05, 0.0, -0.03]), UP)
    assert np.allclose(found[0], UP)
    assert abs(found[1] @ [0, 1, 0]) == pytest.approx(1.0)
    assert lever_directions(*lines, np.zeros(3), np.ones(3), None)[0].shape == (3,)


def motion(tilt_deg, kind="revolute"):
    axis = rotation(np.array([1.0, 0, 0]), np.radians(tilt_deg)) @ UP
    return JointMotion(kind, PIVOT, axis, 0.5)


def test_upright_hinge_is_wished_upright_and_a_slanted_one_left_alone():
    wishes = Wishes(np.zeros((0, 3)), UP)
    near = motion(5)
    residual = np.array([wish(near) for wish in wishes.active(near)])
    assert np.linalg.norm(residual) == pytest.approx(5 / 2, rel=0.01)
    assert wishes.active(motion(40)) == []
    assert Wishes(np.zeros((0, 3)), None).active(near) == []


def test_level_hinge_is_wished_level_only(lines):
    wishes = Wishes(np.zeros((0, 3)), UP)
    level = motion(86)
    residual = [wish(level) for wish in wishes.active(level)]
    assert len(residual) == 1
    assert abs(residual[0]) == pytest.approx(4 / 2, rel=0.01)


def test_a_hinge_that_nearly_is_upright_or_level_is_tried_as_if_it_were():
    wishes = Wishes(np.zeros((0, 3)), UP)
    assert np.allclose(wishes.plumbed(motion(12)).direction, UP)
    assert np.allclose(wishes.plumbed(motion(168)).direction, -UP)
    level = wishes.plumbed(motion(80))
    assert level.direction @ UP == pytest.approx(0.0)
    assert np.degrees(np.arccos(level.direction @ motion(80).direction)) == pytest.approx(10)
    assert wishes.plumbed(motion(45)) is None
    assert wishes.plumbed(motion(5, "prismatic")) is None
    assert Wishes(np.zeros((0, 3)), None).plumbed(motion(5)) is None
    near = motion(1)
    pulled, hard = (sum(wish(near) ** 2 for wish in w.active(near)) for w in (wishes, wishes.plumb()))
    assert hard > 40 * pulled


def test_being_a_little_out_of_plumb_costs_a_lever_and_no_lid(lines):
    lever, lid = Wishes(np.zeros((0, 3)), UP, *lines), Wishes(np.zeros((0, 3)), UP)
    assert _askew(motion(0), lever) == 0.0
    assert _askew(motion(4), lever) - _askew(motion(4), lid) == pytest.approx(0.02, rel=0.01)
    assert _askew(motion(88), lever) > 0.015 > _askew(motion(88), lid)


def test_a_long_strip_is_no_lever(lines):
    assert Wishes(np.zeros((0, 3)), UP, *lines).thin
    front = [replace(line, length_m=0.3) for line in lines]
    assert not Wishes(np.zeros((0, 3)), UP, *front).thin


def test_axis_beside_the_lever_is_pulled_to_it(lines):
    wishes = Wishes(np.zeros((0, 3)), None, *lines)
    beside = JointMotion("revolute", PIVOT + np.array([-0.004, 0.006, 0.0]), UP, 0.6)
    assert any(abs(wish(beside)) > 0.8 for wish in wishes.active(beside))
    assert all(abs(wish(motion(0))) < 0.3 for wish in wishes.active(motion(0)))


def test_slide_is_wished_square_to_its_front():
    wishes = Wishes(np.array([[1.0, 0.0, 0.0]]), UP)
    slide = JointMotion("prismatic", PIVOT, np.array([np.cos(0.1), np.sin(0.1), 0.0]), 0.05)
    residual = np.array([wish(slide) for wish in wishes.active(slide)])
    assert np.linalg.norm(residual) == pytest.approx(np.degrees(np.sin(0.1)), rel=0.01)


def test_a_hinge_along_its_lever_is_not_believed_and_a_rising_lever_is_no_such_thing(lines):
    wishes = Wishes(np.zeros((0, 3)), UP, *lines)
    along, rising = (JointMotion("revolute", PIVOT, axis, 0.4) for axis in (lines[0].direction, UP))
    assert _along_lever(along, wishes) == pytest.approx(0.15)
    assert _along_lever(rising, wishes) == 0.0
    lid = Wishes(np.zeros((0, 3)), UP, replace(lines[0], length_m=0.3), None)
    assert _along_lever(along, lid) == 0.0  # lids hang along their longest edge


def test_a_lever_that_swings_about_a_level_hinge_leads_across_it(lines):
    wishes = Wishes(np.zeros((0, 3)), UP, lines[0])
    out = lines[0].direction * (1.0, 1.0, 0.0) / np.linalg.norm(lines[0].direction[:2])
    aside = np.cross(UP, out)

    def cost(degrees):
        """Of a level hinge at so much to the level way that the lever leads."""
        axis = np.cos(np.radians(degrees)) * out + np.sin(np.radians(degrees)) * aside
        return _along_lever(JointMotion("revolute", PIVOT, axis, 0.4), wishes)

    assert cost(90) == cost(70) == 0.0
    assert 0.0 < cost(60) < cost(50)
    assert cost(40) == pytest.approx(0.15)
    rising = JointMotion("revolute", PIVOT, 0.6 * UP + 0.8 * aside, 0.4)
    assert _along_lever(rising, wishes) == 0.0


def test_candidates_refined_to_one_motion_are_one():
    turn = JointMotion("revolute", PIVOT, UP, 0.4)
    again = replace(turn, origin=np.add(PIVOT, (0.0003, 0.0, 0.3)), delta=0.404)  # the same line
    slide = JointMotion("prismatic", PIVOT, UP, 0.05)
    others = [
        replace(turn, origin=np.add(PIVOT, (0.005, 0.0, 0.0))),
        replace(turn, direction=rotation(np.array([1.0, 0.0, 0.0]), 0.1) @ UP),
        replace(turn, direction=-UP),
        replace(turn, delta=0.45),
        slide,
        replace(slide, delta=0.052),
    ]
    motions = [again, turn, *others, replace(slide, origin=np.add(PIVOT, 0.1))]
    cost = np.array([0.2, 0.1, *np.linspace(0.3, 0.8, len(others)), 0.9])
    assert _distinct(motions, cost) == [1, *range(2, 2 + len(others))]


def walls(radius, arc, count=200):
    """Points of an upright wall about the origin, seen from above, and their normals."""
    angle = np.linspace(-0.5 * arc, 0.5 * arc, count)
    out = np.column_stack([np.cos(angle), np.sin(angle)])
    return radius * out, out


def test_a_column_is_round_a_corner_and_a_strip_are_not():
    assert _is_round(*walls(0.02, np.radians(100)))
    assert not _is_round(*walls(0.02, np.radians(30)))
    flat = np.column_stack([np.full(200, 0.02), np.linspace(-0.03, 0.03, 200)])
    assert not _is_round(flat, np.tile([1.0, 0.0], (200, 1)))


def test_a_round_body_among_many_other_walls_is_not_believed():
    q, m = walls(0.02, np.radians(100))
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 1500)
    other = rng.uniform(-0.03, 0.03, (1500, 2))
    assert not _is_round(
        np.vstack([q, other]), np.vstack([m, np.column_stack([np.cos(angle), np.sin(angle)])])
    )


def test_a_hinge_is_drawn_to_the_nearest_sure_column():
    columns = (Column(PIVOT, UP, sure=True), Column(np.add(PIVOT, (0.004, 0.0, 0.0)), UP, sure=False))
    wishes = Wishes(np.zeros((0, 3)), None, columns=columns)
    near = JointMotion("revolute", np.add(PIVOT, (0.009, 0.0, 0.5)), UP, 0.3)
    pulled = np.array([wish(near) for wish in wishes.active(near)])
    assert np.linalg.norm(pulled) == pytest.approx(3.0)
    assert wishes.active(replace(near, origin=np.add(PIVOT, (0.05, 0.0, 0.0)))) == []
    assert wishes.active(replace(near, direction=np.array([1.0, 0.0, 0.0]))) == []


def test_a_lever_at_the_side_of_a_body_has_its_axis_among_the_candidates():
    body = Column(np.array([0.6, 0.1, 0.2]), UP, sure=True)
    low, high = np.array([0.5, 0.12, 0.1]), np.array([0.7, 0.16, 0.22])
    shape = Structure([], [], [], low, high, (None, None), [], [body, replace(body, sure=False)], UP)
    across = [axis for axis in axes(shape) if axis.source == "across a round body"]
    true = np.array([np.sin(0.3), np.cos(0.3), 0.0])  # level, through the body 4 cm below its point
    off = [np.degrees(np.arccos(abs(axis.direction @ true))) for axis in across]
    beside = [
        1e3 * line_distance(axis.origin, axis.direction, np.array([[0.6, 0.1, 0.16]]))[0] for axis in across
    ]
    assert min(np.hypot(off, beside)) < 18.0
    assert all(abs(axis.direction @ UP) < 1e-9 for axis in across)
    assert not any(axis.source == "across a round body" for axis in axes(replace(shape, columns=[])))


def test_without_planes_slides_and_pivots_are_looked_for_along_the_up_that_is_given():
    up = np.array([0.0, 0.6, 0.8])
    shape = Structure([], [], [], PIVOT - 0.1, PIVOT + 0.1, (None, None), [], [], up)
    found = axes(shape)
    assert {axis.source for axis in found} == {"vertical", "pivot grid"}
    assert all(axis.direction == pytest.approx(up) for axis in found)
