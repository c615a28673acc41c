"""The part a plan may count on ends before the part that was seen."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from s2r_host.model.belief import REVOLUTE
from s2r_host.model.pieces import box, hull
from s2r_host.model.write import write_mjcf
from s2r_host.perception.motion import JointMotion
from s2r_host.run.sure_part import EDGE_M, EDGE_SHARE, at_an_edge, rims, sure_pieces, sure_within

HINGE = JointMotion("revolute", np.array([0.7, 0.0, 0.02]), np.array([0.0, 1.0, 0.0]), 0.4)


def _frame(tilt_rad: float) -> np.ndarray:
    """Origin on the hinge, x from it outward, y along it, z square to the plate."""
    X = np.eye(4)
    out = np.array([-np.cos(tilt_rad), 0.0, np.sin(tilt_rad)])
    X[:3, :3] = np.column_stack([out, HINGE.direction, np.cross(out, HINGE.direction)])
    X[:3, 3] = HINGE.origin
    return X


def _extent(piece, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    corners = piece.vertices @ piece.X_base_piece[:3, :3].T + piece.X_base_piece[:3, 3]
    local = (corners - X[:3, 3]) @ X[:3, :3]
    return local.min(axis=0), local.max(axis=0)


@pytest.mark.parametrize("tilt_rad", [0.6, 1.9])
@pytest.mark.parametrize("as_box", [True, False])
def test_a_lid_ends_before_its_free_edge_and_its_sides(tilt_rad, as_box):
    X, low, high = _frame(tilt_rad), np.array([0.01, -0.16, 0.0]), np.array([0.23, 0.16, 0.008])
    plate = box("lid", "part", X, low, high)
    if not as_box:
        plate = hull("lid", "part", plate.vertices @ X[:3, :3].T + plate.X_base_piece[:3, 3])
    base = box("base", "base", np.eye(4), np.array([0.4, -0.2, 0.0]), np.array([0.7, 0.2, 0.02]))
    lid, same = sure_pieces((plate, base), sure_within((plate, base), HINGE))
    found = _extent(lid, X)
    np.testing.assert_allclose(found[0], np.add(low, (0.0, EDGE_M, 0.0)), atol=1e-3)
    np.testing.assert_allclose(found[1], np.subtract(high, (EDGE_M, EDGE_M, 0.0)), atol=1e-3)
    assert same is base


def test_a_lever_loses_a_share_of_its_length_and_nothing_of_its_width():
    X = _frame(0.0)
    bar = box("bar", "part", X, np.array([0.03, -0.008, -0.005]), np.array([0.09, 0.008, 0.005]))
    hub = box("hub", "part", X, np.array([-0.02, -0.02, -0.02]), np.array([0.02, 0.02, 0.02]))
    short, whole = sure_pieces((bar, hub), sure_within((bar, hub), HINGE))
    assert _extent(short, X)[1][0] == pytest.approx(0.09 * (1 - EDGE_SHARE), abs=1e-6)
    np.testing.assert_allclose(_extent(short, X)[0], [0.03, -0.008, -0.005], atol=1e-9)
    assert whole is hub


def test_a_cross_about_its_axis_has_no_free_end():
    X = _frame(0.0)
    arms = tuple(
        box(f"arm{k}", "part", X, np.array(low), np.array(high))
        for k, (low, high) in enumerate(
            [((-0.04, -0.01, -0.008), (0.04, 0.01, 0.008)), ((-0.008, -0.01, -0.04), (0.008, 0.01, 0.04))]
        )
    )
    assert tuple(sure_pieces(arms, sure_within(arms, HINGE))) == arms


@pytest.mark.parametrize("as_box", [True, False])
def test_what_was_cut_back_is_in_the_file_as_a_rim_that_nothing_touches(tmp_path, as_box):
    X = _frame(0.6)
    plate = box("lid", "part", X, np.array([0.01, -0.16, 0.0]), np.array([0.23, 0.16, 0.008]))
    if not as_box:
        plate = hull("lid", "part", plate.vertices @ X[:3, :3].T + plate.X_base_piece[:3, 3])
    hub = box("hub", "part", X, np.array([-0.01, -0.1, -0.01]), np.array([0.01, 0.1, 0.01]))
    base = box("base", "base", np.eye(4), np.array([0.4, -0.2, 0.0]), np.array([0.7, 0.2, 0.02]))
    pieces = (plate, hub, base)
    sure = sure_pieces(pieces, sure_within(pieces, HINGE))
    assert rims(pieces, sure) == [plate]
    for name, around in (("without", []), ("with", rims(pieces, sure))):
        write_mjcf(tmp_path / f"{name}.xml", sure, HINGE, (-1.0, 1.0), REVOLUTE, around)
    without, model = (
        mujoco.MjModel.from_xml_path(str(tmp_path / f"{name}.xml")) for name in ("without", "with")
    )
    rim = model.geom("rim_lid")
    assert rim.contype[0] == rim.conaffinity[0] == 0
    assert model.body("object_part").mass == pytest.approx(without.body("object_part").mass)
    outward = X[:3, 0]
    reach = {name: _farthest_m(model, name, outward) for name in ("part_lid", "rim_lid")}
    assert reach["rim_lid"] - reach["part_lid"] == pytest.approx(EDGE_M, abs=1e-3)


def _farthest_m(model: mujoco.MjModel, name: str, direction: np.ndarray) -> float:
    """How far along a direction a geom reaches at joint value 0 [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geom = model.geom(name).id
    R, p, mesh = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom], model.geom_dataid[geom]
    if mesh < 0:
        return float(direction @ p + np.abs(R.T @ direction) @ model.geom_size[geom])
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    return float(((model.mesh_vert[start : start + count] @ R.T + p) @ direction).max())


def test_what_is_pushed_where_the_part_was_cut_back_is_pushed_at_an_edge():
    X = _frame(0.6)
    plate = box("lid", "part", X, np.array([0.01, -0.16, 0.0]), np.array([0.23, 0.16, 0.008]))
    within = sure_within((plate,), HINGE)
    for x, y, edge in (
        (0.23 - EDGE_M, 0.0, True),
        (0.21, 0.0, False),
        (0.1, 0.16 - EDGE_M, True),
        (0.1, -0.14, False),
    ):
        assert at_an_edge(X[:3, :3] @ np.array([x, y, 0.004]) + X[:3, 3], within) == edge
