"""A plan counts on the part up to a little before where it was seen to end."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_host.model.pieces import box, hull
from s2r_host.perception.motion import JointMotion
from s2r_host.run.sure_part import EDGE_M, EDGE_SHARE, outside, sure_within

HINGE = JointMotion("revolute", np.array([0.7, 0.0, 0.02]), np.array([0.0, 1.0, 0.0]), 0.4)
JUST_M = 0.001


def _frame(tilt_rad: float) -> np.ndarray:
    """Origin on the hinge, x from it outward, y along it, z square to the plate."""
    X = np.eye(4)
    out = np.array([-np.cos(tilt_rad), 0.0, np.sin(tilt_rad)])
    X[:3, :3] = np.column_stack([out, HINGE.direction, np.cross(out, HINGE.direction)])
    X[:3, 3] = HINGE.origin
    return X


def _at(X: np.ndarray, x: float, y: float) -> np.ndarray:
    return X[:3, :3] @ np.array([x, y, 0.004]) + X[:3, 3]


@pytest.mark.parametrize("tilt_rad", [0.6, 1.9])
@pytest.mark.parametrize("as_box", [True, False])
def test_a_lid_is_pushed_short_of_its_free_edge_and_its_sides(tilt_rad, as_box):
    X, low, high = _frame(tilt_rad), np.array([0.01, -0.16, 0.0]), np.array([0.23, 0.16, 0.008])
    plate = box("lid", "part", X, low, high)
    if not as_box:
        plate = hull("lid", "part", plate.vertices @ X[:3, :3].T + plate.X_base_piece[:3, 3])
    base = box("base", "base", np.eye(4), np.array([0.4, -0.2, 0.0]), np.array([0.7, 0.2, 0.02]))
    within = sure_within((plate, base), HINGE)
    for x, y in ((0.23 - EDGE_M, 0.0), (0.1, 0.16 - EDGE_M), (0.1, -0.16 + EDGE_M)):
        beyond = np.array([x - 0.1, y])
        beyond *= JUST_M / np.linalg.norm(beyond)
        assert not outside(_at(X, x - beyond[0], y - beyond[1]), within)
        assert outside(_at(X, x + beyond[0], y + beyond[1]), within)


def test_a_lever_loses_a_share_of_its_length_and_nothing_of_its_width():
    X = _frame(0.0)
    bar = box("bar", "part", X, np.array([0.03, -0.008, -0.005]), np.array([0.09, 0.008, 0.005]))
    hub = box("hub", "part", X, np.array([-0.02, -0.02, -0.02]), np.array([0.02, 0.02, 0.02]))
    ((*n, d),) = sure_within((bar, hub), HINGE)
    np.testing.assert_allclose(n, X[:3, 0], atol=0.2)  # about along the bar: its hub is off that line
    assert d - n @ HINGE.origin == pytest.approx(0.09 * (1 - EDGE_SHARE), rel=0.05)


def test_a_cross_about_its_axis_has_no_free_end():
    X = _frame(0.0)
    arms = tuple(
        box(f"arm{k}", "part", X, np.array(low), np.array(high))
        for k, (low, high) in enumerate(
            [((-0.04, -0.01, -0.008), (0.04, 0.01, 0.008)), ((-0.008, -0.01, -0.04), (0.008, 0.01, 0.04))]
        )
    )
    assert sure_within(arms, HINGE) == ()
