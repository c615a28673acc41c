"""Flat meshes as thin solids: panels and stickers of the data sets are sheets, and what is flat has no mass."""

from __future__ import annotations

import numpy as np

from s2r_sim.errors import WorldFileError

FLAT_M = 1e-5  # thinner than rounding in the files makes anything
THICKNESS_M = 0.002


def is_flat(points: np.ndarray) -> bool:
    """Whether points (n, 3) [m] lie in one plane."""
    normal = _main_axes(points)[2]
    return bool(np.ptp(points @ normal) < FLAT_M)


def thickened(points: np.ndarray, triangles: np.ndarray, who: str) -> tuple[np.ndarray, np.ndarray]:
    """A flat mesh as a closed one, `THICKNESS_M` thick and half of that to either side of the sheet.

    Args:
        points: Vertices in one plane [m], shape (n, 3).
        triangles: Their numbers, shape (m, 3).
        who: What the text of a refusal begins with.

    Returns:
        Vertices [m], shape (2 n, 3), and triangles.

    Raises:
        WorldFileError: The mesh has no area.
    """
    a, b, c = np.swapaxes(points[triangles], 0, 1)
    doubled_area = np.cross(b - a, c - a)
    _, across, normal = _main_axes(points)
    if not (np.linalg.norm(doubled_area, axis=1) > FLAT_M**2).any() or np.ptp(points @ across) < FLAT_M:
        raise WorldFileError(
            f"{who} has no area: its vertices lie on a line, or no face spans them; leave it out"
        )
    # All faces the one way round, each once: those that are there for either side of the sheet would have no rim.
    triangles = np.where((doubled_area @ normal < 0)[:, None], triangles[:, ::-1], triangles)
    triangles = np.unique(_from_least(triangles), axis=0)
    rim, n = _rim(triangles), len(points)
    half = 0.5 * THICKNESS_M * normal
    walls = np.concatenate([np.c_[rim, rim[:, 1] + n], np.c_[rim[:, 0], rim[:, ::-1] + n]])
    faces = np.concatenate([triangles[:, ::-1], triangles + n, walls])
    return np.concatenate([points - half, points + half]), faces


def _main_axes(points: np.ndarray) -> np.ndarray:
    """Directions of points, the longest spread first, (3, 3) by rows."""
    return np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]


def _from_least(triangles: np.ndarray) -> np.ndarray:
    """The same triangles, each from its least number on."""
    first = triangles.argmin(axis=1)[:, None]
    return np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)


def _rim(triangles: np.ndarray) -> np.ndarray:
    """Edges that no other triangle has the other way round, (n, 2), as their triangle goes."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    there = {(a, b) for a, b in edges.tolist()}
    return np.array([(a, b) for a, b in edges.tolist() if (b, a) not in there], dtype=np.int64).reshape(-1, 2)
