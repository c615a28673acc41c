"""Plates: a flat patch becomes as large as its points, whichever way it lies and wherever its outline begins."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_host.model.plates import PLATE_M, part_pieces
from s2r_host.model.points import ObservedObject

CELL_M = 0.005


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
