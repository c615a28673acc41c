"""A lever told by the outline of a solid: its turn, hinge and size from two looks, its turn in a third."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from s2r_host.model.bar import bar_pieces
from s2r_host.model.points import ObservedObject
from s2r_host.perception.lever_outline import LeverOutline, lever_outline, turns_since
from s2r_host.perception.lever_shape import LEAST_HALF_M, ROOT_M, LeverShape
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.synthetic import LEVER_HINGE, LeverLook, lever_look
from s2r_host.perception.view import DepthView

UP = np.array([0.0, 0.0, 1.0])
HALF_M = np.array([0.06, 0.010, 0.005])
OFF_M = np.array([0.004, -0.003, 0.0])


def seen(look: LeverLook) -> tuple[DepthView, np.ndarray]:
    view = DepthView(look.frame)
    return view, look.part.ravel()[view.flat]


@cache
def usual() -> tuple[LeverLook, LeverLook, LeverOutline]:
    """Two looks, and the lever as they tell it."""
    first, second = lever_look(2.4, HALF_M), lever_look(1.9, HALF_M)
    lever = told(first, second, -0.48)
    assert lever is not None
    return first, second, lever


def told(first: LeverLook, second: LeverLook, believed: float) -> LeverOutline | None:
    motion = JointMotion("revolute", LEVER_HINGE + OFF_M, UP, believed)
    return lever_outline(*seen(first), *seen(second), motion)


@pytest.mark.parametrize(("before", "after", "off"), [(2.2, 1.7, 0.04), (1.9, 2.4, -0.04), (3.6, 3.2, 0.04)])
def test_turn_hinge_and_size_are_told_where_depth_was_two_degrees_and_five_millimetres_off(
    before, after, off
):
    lever = told(lever_look(before, HALF_M), lever_look(after, HALF_M), after - before + off)
    assert lever is not None
    assert lever.hinge.delta == pytest.approx(after - before, abs=0.018)
    assert abs(lever.hinge.delta - (after - before)) < 3.0 * lever.turn_sigma
    assert np.linalg.norm((lever.hinge.origin - LEVER_HINGE)[:2]) < 0.003
    assert 2.0 * lever.shape.half_m == pytest.approx(2.0 * HALF_M[1:], abs=0.0015)
    tip = lever.shape.p_middle + lever.shape.end_m * lever.shape.along
    true = LEVER_HINGE + 2.0 * HALF_M[0] * np.array([np.cos(before), np.sin(before), 0.0])
    assert np.linalg.norm(tip - true) < 0.004
    assert not lever.shape.rod


@pytest.mark.parametrize("off", [-0.04, 0.04])
def test_the_turn_of_a_lever_that_points_away_from_the_camera_is_told(off):
    lever = told(lever_look(0.7, HALF_M), lever_look(1.1, HALF_M), 0.4 + off)
    assert lever is not None
    assert lever.hinge.delta == pytest.approx(0.4, abs=0.018)


@pytest.mark.parametrize("later", [0.8, 1.3, 2.0])
def test_a_third_look_is_measured_since_both(later):
    (first, second, lever), third = usual(), lever_look(later, HALF_M)
    turns = turns_since(lever, (seen(first), seen(second)), DepthView(third.frame), later - 2.4 + 0.03)
    assert turns is not None
    assert turns.since_first.delta == pytest.approx(later - 2.4, abs=0.022)
    assert turns.since_second.delta == pytest.approx(later - 1.9, abs=0.022)
    assert turns.since_second.sigma < 0.02


def test_a_box_that_was_told_as_a_rod_is_measured_as_what_it_is():
    """Where a side was as grey as what is behind it, two looks show a bar with two edges; a third shows three."""
    first, second, lever = usual()
    rod = replace(lever, shape=replace(lever.shape, rod=True, half_m=np.full(2, 0.007)))
    third = lever_look(1.3, HALF_M)
    turns = turns_since(rod, (seen(first), seen(second)), DepthView(third.frame), 1.3 - 2.4 + 0.03)
    assert turns is not None
    assert turns.explained
    assert turns.since_second.delta == pytest.approx(1.3 - 1.9, abs=0.022)


def test_what_a_solid_explains_badly_it_tells_vaguely():
    first, second, lever = usual()
    looks = seen(first), seen(second)
    well, badly = (
        turns_since(lever, looks, DepthView(lever_look(1.3, HALF_M * (1.0, wider, wider)).frame), 1.3 - 2.4)
        for wider in (1.0, 1.8)
    )
    assert well is not None
    assert badly is not None
    assert well.explained
    assert badly.since_second.sigma > 1.5 * well.since_second.sigma


def test_a_lever_that_is_gone_is_not_measured():
    first, second, lever = usual()
    away = lever_look(0.2, np.array([0.03, 0.004, 0.004]))
    assert turns_since(lever, (seen(first), seen(second)), DepthView(away.frame), -1.0) is None


def test_without_colour_or_from_two_places_there_is_no_outline():
    first, second, _ = usual()
    assert told(first, replace(second, frame=replace(second.frame, colour=None)), -0.5) is None
    elsewhere = lever_look(1.9, HALF_M, np.array([0.02, -0.5, 0.6]))
    assert told(first, elsewhere, -0.5) is None


def test_what_is_no_bar_has_no_outline():
    plate = np.array([0.06, 0.05, 0.005])
    assert told(lever_look(2.2, plate), lever_look(1.7, plate), -0.5) is None


def shape(*, rod: bool) -> LeverShape:
    frame = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    half = np.array([0.008, 0.008]) if rod else np.array([0.01, 0.005])
    return LeverShape(np.array([0.6, 0.0, 0.1]), frame, 0.02, 0.09, half, rod)


def test_a_box_s_outline_is_that_of_its_picture():
    """All corners of what a camera sees of it are on the outline's hull, and no outline point is outside of them."""
    look, box = lever_look(0.0), shape(rod=False)
    view = DepthView(look.frame)
    assert view.p_camera is not None
    corners = np.array([[x, y, z] for x in (0.02, 0.09) for y in (-0.01, 0.01) for z in (-0.005, 0.005)])
    drawn = box.outline(view.p_camera)[0].on(box)

    def pixels(p: np.ndarray) -> np.ndarray:
        p_C = (p @ view.X_camera_base[:3, :3].T + view.X_camera_base[:3, 3]) @ view.K.T
        return p_C[:, :2] / p_C[:, 2:]

    hull = cv2.convexHull(pixels(corners @ box.frame.T + box.p_middle).astype(np.float32))
    inside = [cv2.pointPolygonTest(hull, (float(u), float(v)), True) for u, v in pixels(drawn)]
    assert min(inside) > -0.05
    assert len(cv2.convexHull(pixels(drawn).astype(np.float32))) >= 4


def test_a_camera_within_a_bar_sees_nothing_of_it():
    box = replace(shape(rod=False), root_m=0.2)
    one, other = box.outline(box.p_middle)
    assert len(one.on(box)) == len(other.on(box)) == 0


@pytest.mark.parametrize("rod", [False, True])
def test_readings_on_a_lever_s_face_are_not_behind_it(rod):
    lever, eye = shape(rod=rod), np.array([0.1, -0.4, 0.6])
    along = np.linspace(0.03, 0.08, 20)
    up = float(lever.half_m[1])
    top = np.column_stack([along, np.zeros(20), np.full(20, up)]) @ lever.frame.T + lever.p_middle
    if rod:  # what the camera sees of a rod is where it faces the camera, not its top
        towards = (eye - lever.p_middle) - ((eye - lever.p_middle) @ lever.along) * lever.along
        top = lever.p_middle + np.outer(along, lever.along) + up * towards / np.linalg.norm(towards)
    sight = (top - eye) / np.linalg.norm(top - eye, axis=1)[:, None]
    behind, at, hit = lever.behind_m(eye, top + 0.002 * sight)
    assert hit.all()
    assert behind == pytest.approx(0.002, abs=1e-4)
    assert at == pytest.approx(along, abs=1e-3)
    assert not lever.behind_m(eye, np.array([[0.6, 0.0, 0.5]]))[2].any()


def test_a_lever_begins_where_it_leaves_its_hub_and_is_never_thinner_than_levers_are():
    hinge = JointMotion("revolute", np.array([0.61, 0.01, 0.0]), UP, 0.0)
    lever = shape(rod=False).from_hinge(hinge)
    root = lever.p_middle + lever.root_m * lever.along
    assert np.linalg.norm((root - hinge.origin)[:2]) == pytest.approx(ROOT_M)
    thin = lever.changed(np.zeros(2), np.zeros(2), 0.0, np.array([0.0, -0.01]), 0.0)
    assert thin.half_m.tolist() == [0.01, LEAST_HALF_M]
    assert thin.thinnest
    assert not lever.thinnest


def test_the_model_has_the_bar_that_the_outline_told():
    lever = shape(rod=False)
    empty = np.zeros((0, 3))
    part = ObservedObject(empty, empty, empty, empty, UP, 0.0, np.zeros(3))
    pieces = bar_pieces(part, LEVER_HINGE, UP, lever)
    assert pieces is not None
    (bar,) = pieces
    assert bar.name == "bar"
    corners = bar.vertices @ bar.X_base_piece[:3, :3].T + bar.X_base_piece[:3, 3]
    local = (corners - lever.p_middle) @ lever.frame
    assert local.min(axis=0) == pytest.approx([0.02, -0.01, -0.005])
    assert local.max(axis=0) == pytest.approx([0.09, 0.01, 0.005])
