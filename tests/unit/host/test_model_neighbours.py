"""What stands out of a cabinet around a drawer."""

import numpy as np
import pytest

from s2r_host.model.neighbours import neighbours_of

LEAST = 60


def plate(x, y, z, count=600, seed=0):
    """Points on an upright plate at x, between y and z limits, 1 mm of noise."""
    rng = np.random.default_rng(seed)
    return np.column_stack(
        [x + 0.001 * rng.standard_normal(count), rng.uniform(*y, count), rng.uniform(*z, count)]
    )


def sides_of(q):
    """Above, below, right and left of a front of 30 by 10 cm about the origin."""
    return q[:, 2] > 0.05, q[:, 2] < -0.05, q[:, 1] < -0.15, q[:, 1] > 0.15


def test_a_plain_cabinet_has_none():
    q = np.concatenate([plate(-0.05, (-0.16, 0.16), z) for z in ((0.05, 0.07), (-0.15, -0.05))])
    front, boxes = neighbours_of(q, sides_of(q), LEAST)
    assert front == pytest.approx(-0.05, abs=0.004)
    assert boxes == ()


def test_an_open_drawer_below_is_a_front_and_its_handle_and_the_cabinet_stays_back():
    rim, below = plate(-0.05, (-0.16, 0.16), (0.05, 0.07)), plate(0.02, (-0.15, 0.15), (-0.15, -0.052))
    bar = plate(0.06, (-0.05, 0.05), (-0.10, -0.09), count=150)
    q = np.concatenate([rim, below, bar])
    front, (slab, handle) = neighbours_of(q, sides_of(q), LEAST)
    assert front == pytest.approx(-0.05, abs=0.004)
    assert [slab[0][0], slab[1][0]] == pytest.approx([front, 0.02], abs=0.005)
    assert [slab[0][2], slab[1][2]] == pytest.approx([-0.15, -0.052], abs=0.005)
    assert [handle[0][0], handle[1][0]] == pytest.approx([slab[1][0], 0.06], abs=0.005)
    assert handle[1][1] - handle[0][1] == pytest.approx(0.10, abs=0.01)


def test_a_side_with_few_points_tells_nothing():
    q = np.concatenate(
        [plate(-0.05, (-0.16, 0.16), (0.05, 0.07)), plate(0.05, (-0.15, 0.15), (-0.1, -0.06), 30)]
    )
    assert neighbours_of(q, sides_of(q), LEAST)[1] == ()
