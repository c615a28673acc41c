"""Plates: a flat patch becomes as large as its points, whichever way it lies and wherever its outline begins."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_host.model.plates import PLATE_M, part_pieces
from s2r_host.model.points import ObservedObject

CELL_M = 0.005
UP = np.array([0.0, 0.0, 1.0])


def _seen(points: np.ndarray, normal: np.ndarray) -> ObservedObject:
    nothing = np.empty((0, 3))
    normals = np.broadcast_to(normal, points.shape)
    up = np.array([0.0, 0.0, 1.0])
    return ObservedObject(points, normals, nothing, nothing, up, 0.0, points.mean(axis=0) + 0.8 * normal)


@pytest.mark.parametrize("size_m", [(0.30, 0.22), (0.10, 0.06)])
@pytest.mark.parametrize("tilt_rad", [0.0, 0.7, 1.4])
def test_a_plate_is_as_large_as_what_was_seen_of_it(size_m, tilt_rad):
    rng = np.random.default_rng(3)
    width, length = size_m
    across = np.array([0.0, 1.0, 0.0])
    along = np.array([np.cos(tilt_rad), 0.0, np.sin(tilt_rad)])
    flat = rng.uniform(-0.5, 0.5, (9000, 2)) * size_m
    points = np.array([0.7, 0.1, 0.3]) + flat[:, :1] * across + flat[:, 1:] * along
    (plate,), warnings = part_pieces(_seen(points, np.cross(along, across)), rng, 5.0)
    assert not warnings
    corners = plate.vertices @ plate.X_base_piece[:3, :3].T + plate.X_base_piece[:3, 3] - [0.7, 0.1, 0.3]
    assert np.ptp(corners @ across) == pytest.approx(width, abs=1.5 * CELL_M)
    assert np.ptp(corners @ along) == pytest.approx(length, abs=1.5 * CELL_M)
    assert np.ptp(corners @ np.cross(along, across)) == pytest.approx(PLATE_M, abs=0.001)


def _extent(piece) -> tuple[float, float]:
    """From where to where a piece reaches upwards [m]."""
    heights = piece.vertices[:, 2] + piece.X_base_piece[2, 3]
    return float(heights.min()), float(heights.max())


def _faces(*faces: tuple[float, float]) -> ObservedObject:
    """Level faces of a lid at some heights [m], each seen from above (1) or below (-1); the first camera is above."""
    rng = np.random.default_rng(5)
    points, normals = [], []
    for height_m, sense in faces:
        flat = rng.uniform(-0.1, 0.1, (5000, 2))
        points.append(np.column_stack([flat, height_m + rng.normal(0, 0.0005, 5000)]))
        normals.append(np.tile(sense * UP, (5000, 1)))
    nothing = np.empty((0, 3))
    return ObservedObject(
        np.concatenate(points), np.concatenate(normals), nothing, nothing, UP, 0.0, np.array([0, 0, 0.8])
    )


@pytest.mark.parametrize(("apart_m", "each_m"), [(0.010, 0.005), (0.014, 0.007), (0.030, PLATE_M)])
def test_two_faces_of_a_lid_make_one_plate_as_thick_as_it(apart_m, each_m):
    """The far face was extruded out of the lid, away from the camera that did not see it: 20 mm instead of 8."""
    pieces, _ = part_pieces(_faces((0.1, 1.0), (0.1 - apart_m, -1.0)), np.random.default_rng(0), 5.0)
    below, above = sorted(_extent(piece) for piece in pieces)
    assert above == pytest.approx((0.1 - each_m, 0.1), abs=0.0005)
    assert below == pytest.approx((0.1 - apart_m, 0.1 - apart_m + each_m), abs=0.0005)


def test_a_face_that_the_second_view_alone_shows_lies_before_its_plate():
    (plate,), _ = part_pieces(_faces((0.1, -1.0)), np.random.default_rng(0), 5.0)
    assert _extent(plate) == pytest.approx((0.1, 0.1 + PLATE_M), abs=0.0005)


def test_steps_of_one_side_are_as_thick_as_any_plate():
    pieces, _ = part_pieces(_faces((0.1, 1.0), (0.088, 1.0)), np.random.default_rng(0), 5.0)
    assert [np.ptp(_extent(piece)) for piece in pieces] == pytest.approx([PLATE_M, PLATE_M], abs=0.0005)
