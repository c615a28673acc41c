"""Outlines in colour beside depth edges, and which of them belong together."""

import cv2
import numpy as np
import pytest

from s2r_host.perception.edges import Edges
from s2r_host.perception.outline import outline

K = np.array([[600.0, 0.0, 160.0], [0.0, 600.0, 120.0], [0.0, 0.0, 1.0]])
NEAR, FAR = 0.7, 0.9
LEFT, RIGHT = 100, 180  # columns of a near plate's first and last pixel


@pytest.fixture
def plate():
    """A light plate before a dark wall; its depth reaches 4 px too far on the right and has a hole on the left."""
    depth = np.full((240, 320), FAR)
    depth[60:180, LEFT + 3 : RIGHT + 5] = NEAR
    depth[60:180, LEFT - 5 : LEFT + 3] = 0.0
    colour = np.full((240, 320, 3), 60, np.uint8)
    colour[60:180, LEFT : RIGHT + 1] = 180
    return depth, colour


def sides(found):
    """Columns of the outlines at the left and at the right, away from the corners."""
    u = K[0, 0] * found.p_C[:, 0] / found.p_C[:, 2] + K[0, 2]
    v = K[1, 1] * found.p_C[:, 1] / found.p_C[:, 2] + K[1, 2]
    middle = (v > 80) & (v < 160)
    return u[middle & (found.outward_C[:, 0] < -0.9)], u[middle & (found.outward_C[:, 0] > 0.9)]


def test_outline_is_where_the_colour_changes_not_where_the_depth_does(plate):
    left, right = sides(outline(*plate, K, np.ones((240, 320), bool)))
    assert min(len(left), len(right)) > 50
    assert np.abs(left - (LEFT - 0.5)).max() < 0.3
    assert np.abs(right - (RIGHT + 0.5)).max() < 0.3


def test_outline_has_the_depth_of_the_nearer_thing(plate):
    found = outline(*plate, K, np.ones((240, 320), bool))
    assert np.allclose(found.p_C[:, 2], NEAR)


def test_without_contrast_there_is_no_outline(plate):
    depth, colour = plate
    assert len(outline(depth, np.full_like(colour, 60), K, np.ones((240, 320), bool)).p_C) == 0


def test_the_border_of_the_image_is_no_outline(plate):
    depth, colour = plate
    cut = LEFT - 7
    holes = np.zeros(depth.shape, bool)  # beside the plate, here and there, up to the border of the image
    holes[60:180, cut:LEFT] = (np.arange(60, 180) // 8 % 2 == 0)[:, None]
    depth[60:180, cut:LEFT] = FAR
    depth[60:180, LEFT : LEFT + 3] = NEAR
    depth[holes] = 0.0
    grey = np.where(colour == 60, 100, colour).astype(np.uint8)
    shifted = K - np.array([[0.0, 0.0, cut], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    found = outline(depth[:, cut:].copy(), grey[:, cut:].copy(), shifted, np.ones((240, 320 - cut), bool))
    left, _ = sides(found)  # by the matrix of the whole image, in its columns
    assert len(left) > 50
    assert np.abs(left - (LEFT - 0.5)).max() < 0.5


def test_only_wanted_pixels_are_asked(plate):
    wanted = np.zeros((240, 320), bool)
    wanted[:, : (LEFT + RIGHT) // 2] = True
    left, right = sides(outline(*plate, K, wanted))
    assert len(left) > 50
    assert len(right) == 0


def test_noise_in_the_picture_moves_it_little(plate):
    depth, colour = plate
    noisy = cv2.add(colour, np.random.default_rng(0).integers(0, 4, colour.shape).astype(np.uint8))
    left, right = sides(outline(depth, noisy, K, np.ones((240, 320), bool)))
    assert np.median(np.abs(left - (LEFT - 0.5))) < 0.3
    assert np.median(np.abs(right - (RIGHT + 0.5))) < 0.3


def strip(x, outward, count=30):
    """Edge points along y at some x."""
    points = np.column_stack([np.full(count, x), np.linspace(0.0, 0.1, count), np.zeros(count)])
    return points, np.tile([outward, 0.0, 0.0], (count, 1))


def test_both_sides_of_a_thin_bar_are_kept_apart():
    (left, out_left), (right, out_right) = strip(0.0, -1.0), strip(0.008, 1.0)
    bar = Edges(np.vstack([left, right]), np.vstack([out_left, out_right]), sharp=True)
    tree = bar.tree()
    assert tree is not None
    moved = np.add(left, (0.006, 0.0, 0.0))  # now nearer to the other side
    index = bar.matched(tree, moved, out_left, 0.02)
    found = bar.points[index[index >= 0]]
    assert len(found)
    assert np.allclose(found[:, 0], 0.0)


def test_outlines_that_both_views_show_are_left_out():
    stayed, moved = strip(0.0, 1.0), strip(0.05, 1.0)
    before = Edges(np.vstack([stayed[0], moved[0]]), np.vstack([stayed[1], moved[1]]), sharp=True)
    after = Edges(*strip(0.001, 1.0), sharp=True)
    assert np.allclose(before.without(after).points[:, 0], 0.05)
    turned = Edges(*strip(0.001, -1.0), sharp=True)  # something else ends there, on the other side
    assert len(before.without(turned).points) == len(before.points)


def test_a_thing_without_a_jump_in_depth_has_no_outline(plate):
    _, colour = plate
    assert not len(outline(np.full((240, 320), FAR), colour, K, np.ones((240, 320), bool)).p_C)
