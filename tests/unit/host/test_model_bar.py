"""Levers become a prism along their line; what is no lever does not."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.model.bar import bar_pieces
from s2r_host.model.points import Look, ObservedObject

AXIS = np.array([0.0, 0.0, 1.0])
P_AXIS = np.array([0.55, 0.05, 0.0])
CAMERA = np.array([0.0, -0.1, 0.6])
LOW, HIGH = np.array([0.0, -0.01, 0.15]), np.array([0.13, 0.01, 0.166])  # of the lever, from its axis


def seen(low, high, rng, count=6000):
    """Points on those faces of a box that the camera sees, with 1 mm of noise, in the frame of the views."""
    points = []
    for axis in range(3):
        for side in (low, high):
            p = rng.uniform(low, high, (count, 3))
            p[:, axis] = side[axis]
            normal = np.zeros(3)
            normal[axis] = 1.0 if side is high else -1.0
            facing = (CAMERA - P_AXIS - p) @ normal > 0.0
            points.append(p[facing][: int(count * np.prod(np.delete(high - low, axis)) / 0.003)])
    return np.concatenate(points) + P_AXIS + rng.normal(0.0, 0.001, (sum(map(len, points)), 3))


def observed(part) -> ObservedObject:
    """One view without colour: the sides that it hides are guessed."""
    empty = np.zeros((0, 3))
    looks = (Look(part, CAMERA, None),)
    return ObservedObject(part, np.zeros_like(part), empty, empty, AXIS, 0.0, CAMERA, looks=looks)


@pytest.mark.parametrize("turn_deg", [0, 35, 90, 150, 220, 300])
def test_the_sides_of_a_lever_are_where_they_are(turn_deg):
    rng = np.random.default_rng(turn_deg)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    local_camera = turn.T @ (CAMERA - P_AXIS)
    part = []
    for axis in range(3):
        for side in (LOW, HIGH):
            p = rng.uniform(LOW, HIGH, (3000, 3))
            p[:, axis] = side[axis]
            normal = np.eye(3)[axis] * (1.0 if side is HIGH else -1.0)
            part.append(p[(local_camera - p) @ normal > 0.0])
    p = np.concatenate(part) @ turn.T + P_AXIS
    pieces = bar_pieces(observed(p + rng.normal(0.0, 0.001, p.shape)), P_AXIS, AXIS)
    bar = pieces[0]
    corners = (bar.vertices @ bar.X_base_piece[:3, :3].T + bar.X_base_piece[:3, 3] - P_AXIS) @ turn
    assert corners[:, 0].max() == pytest.approx(HIGH[0], abs=0.004)
    # The camera sees one of the two sides that are pushed well, and the other one from its edge.
    sides = corners[:, 1].min() - LOW[1], corners[:, 1].max() - HIGH[1]
    assert min(np.abs(sides)) < 0.006
    assert max(np.abs(sides)) < 0.013
    assert bar.name == "bar"


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ((0.0, -0.15, 0.0), (0.005, 0.15, 0.2)),
        ((-0.06, -0.06, 0.1), (0.06, 0.06, 0.12)),
        ((0.0, 0.0, 0.1), (0.04, 0.02, 0.12)),
    ],
    ids=["lid", "knob", "stub"],
)
def test_what_is_no_lever_is_left_to_plates(low, high):
    part = seen(np.array(low), np.array(high), np.random.default_rng(0))
    assert bar_pieces(observed(part), P_AXIS, AXIS) is None


def test_without_a_camera_nothing_is_known_of_hidden_sides():
    part = observed(seen(LOW, HIGH, np.random.default_rng(0)))
    blind = ObservedObject(part.part, part.part_normals, part.rest, part.rest_normals, AXIS, 0.0, None)
    assert bar_pieces(blind, P_AXIS, AXIS) is None


def test_a_lever_along_its_axis_is_left_to_plates():
    part = seen(LOW, HIGH, np.random.default_rng(0))
    assert bar_pieces(observed(part), P_AXIS, np.array([1.0, 0.0, 0.0])) is None


def test_a_bar_reaches_its_hub_where_no_camera_saw_through():
    rng = np.random.default_rng(0)
    outer = seen(np.add(LOW, (0.065, 0.0, 0.0)), HIGH, rng)
    begins = [_begin(observed(outer), empty) for empty in (False, True)]
    assert begins[0] < 0.035
    assert begins[1] > 0.055


def _begin(part, empty):
    """Where the bar begins, from its axis [m], if a camera saw nothing, or through everything, near the hub."""
    part = replace(part, empty={"part": lambda p: np.full(len(p), empty), "base": part.empty["base"]})
    bar = bar_pieces(part, P_AXIS, AXIS)[0]
    corners = bar.vertices @ bar.X_base_piece[:3, :3].T + bar.X_base_piece[:3, 3] - P_AXIS
    return np.linalg.norm(corners[:, :2], axis=1).min()
