"""A lever's turn by its edges in colour, where its depth is smeared as a stereo matcher smears it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from s2r_host.perception.colour_turn import Turn, combined, turn_by_colour
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.synthetic import look_at
from s2r_host.perception.view import DepthView

K = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
SHAPE = (480, 640)
X_BASE_CAMERA = look_at(np.array([0.0, -0.5, 0.6]), np.array([0.6, 0.0, 0.1]))
HINGE = np.array([0.6, 0.0, 0.1])
HALF = np.array([0.04, 0.007, 0.007])  # of the lever, which begins at the hinge
FACES = np.array([[90, 90, 90], [150, 150, 140], [200, 190, 180], [60, 70, 90]], np.uint8)  # x, y, z, table


def look(turn_rad: float, *, smeared: bool = True, coloured: bool = True) -> tuple[DepthFrame, np.ndarray]:
    """A lever on a table, and its pixels (h, w), by rays against a box and a plane."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(SHAPE)], axis=-1)
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    middle = HINGE + R @ [HALF[0], 0.0, 0.0]
    way = rays @ X_BASE_CAMERA[:3, :3].T
    near, far = ((side * HALF - (X_BASE_CAMERA[:3, 3] - middle) @ R) / (way @ R) for side in (-1.0, 1.0))
    near, far = np.minimum(near, far), np.maximum(near, far)
    face, enters = near.argmax(axis=-1), near.max(axis=-1)
    hit = enters < far.min(axis=-1)
    table = (0.06 - X_BASE_CAMERA[2, 3]) / way[..., 2]
    depth = np.where(hit, enters, table).astype(np.float32)
    colour = FACES[np.where(hit, face, 3)]
    if smeared:
        depth = cv2.blur(depth, (9, 5))
    return DepthFrame(depth, K, X_BASE_CAMERA, colour if coloured else None), hit


def told(before: float, after: float, believed: float, **options: bool) -> Turn | None:
    (first, mask), (second, _) = look(before, **options), look(after, **options)
    view = DepthView(first)
    motion = JointMotion(
        "revolute", HINGE + np.array([0.001, -0.001, 0.0]), np.array([0.0, 0.0, 1.0]), believed
    )
    return turn_by_colour(view, mask.ravel()[view.flat], DepthView(second), motion)


@pytest.mark.parametrize(("before", "after"), [(2.2, 1.6), (0.6, 1.1), (1.4, 1.6), (2.6, 2.9)])
@pytest.mark.parametrize("off", [-0.05, 0.05])
def test_the_turn_is_found_where_depth_was_three_degrees_off(before, after, off):
    turn = told(before, after, after - before + off)
    assert turn is not None
    assert turn.delta == pytest.approx(after - before, abs=0.02)
    assert turn.sigma < 0.018


def test_without_colour_there_is_no_answer():
    assert told(2.2, 1.6, -0.6, coloured=False) is None


def test_a_lever_that_is_not_seen_again_gives_no_answer():
    (first, mask), (second, _) = look(2.2), look(2.2)
    empty = replace(second, colour=np.full_like(second.colour, FACES[3]))
    view = DepthView(first)
    motion = JointMotion("revolute", HINGE, np.array([0.0, 0.0, 1.0]), -0.6)
    assert turn_by_colour(view, mask.ravel()[view.flat], DepthView(empty), motion) is None


def test_of_two_answers_the_surer_one_counts_for_more():
    both = combined(Turn(0.30, 0.02), Turn(0.36, 0.01))
    assert both.delta == pytest.approx(0.348)
    assert both.sigma == pytest.approx(0.02 / np.sqrt(5.0))
