"""Occupancy of exact solids."""

import numpy as np
import pytest

from s2r_host.learn.solids import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE, drawn_around, inside, moved
from s2r_host.perception.motion import rotation

SIZE = {
    SPHERE: (0.1, 0, 0),
    CAPSULE: (0.05, 0.1, 0),
    ELLIPSOID: (0.1, 0.05, 0.2),
    CYLINDER: (0.05, 0.1, 0),
    BOX: (0.1, 0.2, 0.05),
}
VOLUME = {
    SPHERE: 4 / 3 * np.pi * 1e-3,
    CAPSULE: np.pi * 0.0025 * 0.2 + 4 / 3 * np.pi * 0.05**3,
    ELLIPSOID: 4 / 3 * np.pi * 1e-3,
    CYLINDER: np.pi * 0.0025 * 0.2,
    BOX: 8 * 1e-3,
}


def _solid(shape, R=None, p=(0.0, 0.0, 0.0)):
    R = np.eye(3) if R is None else R
    return np.concatenate([[shape], SIZE[shape], np.c_[R, np.array(p)].ravel()])[None]


@pytest.mark.parametrize("shape", list(SIZE))
def test_as_much_is_inside_as_the_solid_holds(shape):
    rng = np.random.default_rng(0)
    solid = _solid(shape, rotation(np.array([0.6, 0.0, 0.8]), 0.7), np.array([0.3, -0.1, 0.2]))
    p = np.array([0.3, -0.1, 0.2]) + rng.uniform(-0.3, 0.3, (100_000, 3))
    assert inside(p, solid).mean() * 0.6**3 == pytest.approx(VOLUME[shape], rel=0.06)


def test_solids_move_with_their_points():
    rng = np.random.default_rng(1)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = rotation(np.array([0.0, 0.6, 0.8]), 1.1), [0.1, 0.2, -0.3]
    solids = np.concatenate([_solid(BOX), _solid(CYLINDER, p=np.array([0.1, 0.0, 0.1]))])
    p = rng.uniform(-0.3, 0.3, (5000, 3))
    carried = p @ X[:3, :3].T + X[:3, 3]
    np.testing.assert_array_equal(inside(p, solids), inside(carried, moved(solids, X)))


def test_points_are_drawn_around_all_solids_within_the_margin():
    rng = np.random.default_rng(2)
    far = _solid(CAPSULE, p=np.array([1.0, 0.0, 0.0]))
    p = drawn_around(np.concatenate([_solid(BOX), far]), 4000, 0.02, rng)
    near_box = np.all(np.abs(p) <= np.array(SIZE[BOX]) + 0.02 + 1e-9, axis=1)
    near_capsule = np.all(np.abs(p - [1.0, 0, 0]) <= np.array([0.07, 0.07, 0.17]) + 1e-9, axis=1)
    assert (near_box | near_capsule).all()
    assert near_box.any()
    assert near_capsule.any()
    assert 0.2 < inside(p[near_box], _solid(BOX)).mean() < 0.9


def test_other_shapes_are_refused_by_number():
    row = _solid(BOX)
    row[0, 0] = 7
    with pytest.raises(ValueError, match="solid of shape 7"):
        inside(np.zeros((1, 3)), row)
