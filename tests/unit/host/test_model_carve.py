"""Convex pieces keep out of space that a camera saw to be empty, and still cover what was seen."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from s2r_host.model.carve import INTRUDES_M3, MOST_PIECES, carved, corners, intrusion_m3

UP = np.array([0.0, 0.0, 1.0])


def bracket(rng):
    """Points of an upright L: a post of 20 cm and a foot of 16 cm, both 3 cm thick; its hollow side is +x, +z."""
    post = rng.uniform((0.0, 0.0, 0.0), (0.03, 0.03, 0.20), (4000, 3))
    foot = rng.uniform((0.0, 0.0, 0.0), (0.16, 0.03, 0.03), (4000, 3))
    return np.concatenate([post, foot])


def hollow(p):
    return (p[:, 0] > 0.033) & (p[:, 2] > 0.033)


def nothing(p):
    return np.zeros(len(p), bool)


def covered(points, hulls):
    inside = np.zeros(len(points), bool)
    for one in hulls:
        equations = ConvexHull(one).equations
        inside |= (points @ equations[:, :3].T + equations[:, 3] < 1e-6).all(axis=1)
    return inside


@pytest.fixture(scope="module")
def points():
    return bracket(np.random.default_rng(0))


def test_a_hollow_that_was_seen_to_be_empty_is_left_out(points):
    whole = corners(points)
    assert intrusion_m3(whole, hollow) > 50 * INTRUDES_M3
    hulls = carved([whole], points, hollow, UP)
    assert 2 <= len(hulls) <= MOST_PIECES
    assert all(intrusion_m3(one, hollow) < INTRUDES_M3 for one in hulls)


def test_every_point_stays_in_some_piece(points):
    assert covered(points, carved([corners(points)], points, hollow, UP)).mean() > 0.995


def test_what_is_not_known_to_be_empty_is_bridged_as_before(points):
    whole = corners(points)
    hulls = carved([whole], points, nothing, UP)
    assert len(hulls) == 1
    assert np.array_equal(hulls[0], whole)


def test_the_empty_volume_inside_a_hull_is_measured():
    box = np.array([[x, y, z] for x in (0, 0.1) for y in (0, 0.2) for z in (0, 0.3)])
    assert intrusion_m3(box, lambda p: p[:, 2] > 0.2) == pytest.approx(0.1 * 0.2 * 0.1, rel=0.1)
    assert intrusion_m3(box, nothing) == 0.0


def test_a_scatter_that_nothing_separates_ends_with_the_pieces_allowed():
    rng = np.random.default_rng(1)
    p = rng.uniform(0.0, 0.3, (3000, 3))
    everywhere = carved([corners(p)], p, lambda q: np.ones(len(q), bool), UP)
    assert 1 <= len(everywhere) <= MOST_PIECES
