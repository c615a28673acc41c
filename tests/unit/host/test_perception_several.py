"""Two parts that moved between the views, each with its own joint."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_host.perception import AbstainError, DepthFrame, estimate_joints
from s2r_host.perception import synthetic as scenes
from s2r_host.perception.estimate import prepare
from s2r_host.perception.evidence import probe
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.parallel import together
from s2r_host.perception.several import motions_of
from s2r_host.perception.synthetic import Box
from s2r_host.perception.wishes import Wishes

K, SHAPE = np.array([[460.0, 0, 320], [0, 460.0, 180], [0, 0, 1]]), (360, 640)
OUT = np.array([-1.0, 0.0, 0.0])
UP = np.array([0.0, 0.0, 1.0])


def at(x: float, y: float, z: float, size: tuple[float, float, float]) -> Box:
    X = np.eye(4)
    X[:3, 3] = x, y, z
    return Box(X, np.array(size))


def views(moving: list[tuple[Box, JointMotion]]) -> tuple[DepthFrame, DepthFrame]:
    """A cabinet with parts in front of it, before and after each part's own motion."""
    static = [at(0.7, 0.0, -0.015, (1.2, 1.6, 0.03)), at(0.82, 0.0, 0.15, (0.3, 0.5, 0.3))]
    target = np.array([0.68, 0.0, 0.14])
    X = scenes.look_at(target + np.array([-0.62, -0.2, 0.4]), target)
    rng = np.random.default_rng(5)
    moved = [Box(motion.transform() @ box.X_base_box, box.size) for box, motion in moving]
    frames = []
    for boxes in ([box for box, _ in moving], moved):
        depth, _ = scenes.render(static + boxes, K, SHAPE, X)
        frames.append(DepthFrame(scenes.stereo_like(depth, rng), K, X))
    return frames[0], frames[1]


def drawer(y: float, z: float, way_m: float) -> tuple[Box, JointMotion]:
    return at(0.63, y, z, (0.1, 0.22, 0.13)), JointMotion("prismatic", np.zeros(3), OUT, way_m)


@pytest.fixture(scope="module")
def drawer_and_door():
    hinge = np.array([0.66, 0.24, 0.0])
    door = at(0.65, 0.13, 0.15, (0.02, 0.22, 0.26))
    turn = JointMotion("revolute", hinge, -UP, np.radians(30))
    return estimate_joints(*views([drawer(-0.12, 0.15, 0.05), (door, turn)]))


def test_a_drawer_and_a_door_are_both_found(drawer_and_door):
    found = {one.joint_type: one for one in drawer_and_door}
    assert set(found) == {"prismatic", "revolute"}
    slide, turn = found["prismatic"], found["revolute"]
    assert slide.delta == pytest.approx(0.05, abs=0.002)
    assert slide.axis_direction @ OUT > np.cos(np.radians(3))
    assert np.degrees(turn.delta) == pytest.approx(30, abs=2)
    assert abs(turn.axis_direction @ UP) > np.cos(np.radians(4))
    assert np.linalg.norm(turn.axis_origin_m[:2] - (0.66, 0.24)) < 0.02


def test_their_parts_do_not_overlap(drawer_and_door):
    masks = [one.moved_mask_before for one in drawer_and_door]
    assert min(mask.sum() for mask in masks) > 1000
    assert (masks[0] & masks[1]).sum() < 0.02 * min(mask.sum() for mask in masks)


def motions(frames: tuple[DepthFrame, DepthFrame]) -> list[JointMotion]:
    rng = np.random.default_rng(0)
    scene, _ = prepare(*frames, None, None, None, rng)
    return motions_of(scene, rng, 4, {})


def test_one_part_is_not_taken_for_two():
    assert len(motions(views([drawer(-0.12, 0.15, 0.05)]))) == 1


def test_two_drawers_that_went_unlike_ways_are_told_apart():
    found = motions(views([drawer(-0.12, 0.15, 0.05), drawer(0.12, 0.15, -0.035)]))
    assert [one.joint_type for one in found] == ["prismatic", "prismatic"]
    ways = sorted(float(one.delta * (one.direction @ OUT)) for one in found)
    assert ways == pytest.approx([-0.035, 0.05], abs=0.003)


def stacked(lower_m: float, upper_m: float) -> list[tuple[Box, JointMotion]]:
    """Two like drawers, one above the other: the one that goes in stands out by as much as the other comes out."""
    return [
        (
            at(0.65 + (way < 0) * way, 0.0, z, (0.06, 0.3, 0.13)),
            JointMotion("prismatic", np.zeros(3), OUT, way),
        )
        for z, way in ((0.07, lower_m), (0.21, upper_m))
    ]


def test_fronts_that_changed_places_are_two_drawers_and_none_that_went_up():
    found = motions(views(stacked(0.06, -0.06)))
    assert [one.joint_type for one in found] == ["prismatic", "prismatic"]
    assert min(abs(one.direction @ OUT) for one in found) > np.cos(np.radians(2))
    assert sorted(float(one.delta * (one.direction @ OUT)) for one in found) == pytest.approx(
        [-0.06, 0.06], abs=0.003
    )


def test_slides_along_a_line_are_found_by_their_fronts_and_no_more_of_them_than_there_are():
    for moving, ways in ((stacked(0.06, -0.05), [-0.05, 0.06]), ([drawer(0.0, 0.15, 0.05)], [0.05])):
        rng = np.random.default_rng(0)
        scene, _ = prepare(*views(moving), None, None, None, rng)
        probes = (
            probe(scene.before, scene.moved_before(), 600, rng),
            probe(scene.after, scene.moved_after(), 600, rng),
        )
        found = together(OUT, scene, probes, 4)
        assert sorted(float(one.delta * (one.direction @ OUT)) for one in found) == pytest.approx(
            ways, abs=0.002
        )


def test_a_slide_is_wished_to_go_like_those_beside_it():
    off = np.radians(3.0)
    wishes = Wishes(np.empty((0, 3)), beside=(OUT,))
    askew = JointMotion("prismatic", np.zeros(3), np.array([-np.cos(off), np.sin(off), 0.0]), 0.05)
    away = JointMotion("prismatic", np.zeros(3), UP, 0.05)
    assert np.hypot(*[wish(askew) for wish in wishes.active(askew)]) == pytest.approx(6.0, rel=0.01)
    assert wishes.active(away) == []


def test_nothing_moved_is_refused():
    box = at(0.63, -0.12, 0.15, (0.1, 0.22, 0.13))
    with pytest.raises(AbstainError, match="no motion seen"):
        estimate_joints(*views([(box, JointMotion("prismatic", np.zeros(3), OUT, 0.0))]))
