"""The object's points of one depth view, as the push network sees them: centred, a fixed number, with neighbours.

Everything here is numpy, so that training and use prepare their input by the same code.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from s2r_host.perception.errors import BadViewError
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.view import DepthView

Array = NDArray[np.floating]
Index = NDArray[np.int64]

POINTS = 2000
COARSE = (256, 64)  # points of the two coarser levels
NEIGHBOURS = 16
TABLE_M = 0.008  # lower points are taken for the table
REACH_M = 1.5  # from the camera
CELL_M = 0.03
FEWEST = 200
DETAIL = 3.0  # so many times likelier is a point of an edge or of something too small for a plane
SCALES = (16, 96)  # neighbours of the two scales of local shape
SHAPE = 2 + 3 * len(SCALES)
FEATURES = 7 + SHAPE


@dataclass(frozen=True, eq=False)
class ObjectCloud:
    """Points of the largest thing on the table.

    Attributes:
        points: In the base frame [m], shape (POINTS, 3).
        normals: Unit, towards the camera, shape (POINTS, 3).
        pixels: Index of each point in the flattened depth image, shape (POINTS,).
        centre: Mean of the points [m], shape (3,).
        shape: What the surface around each point is like, see `local_shape`, shape (POINTS, SHAPE).
    """

    points: Array
    normals: Array
    pixels: Index
    centre: Array
    shape: NDArray[np.float32]

    def features(self) -> NDArray[np.float32]:
        """Input of the network: centred points [dm], normals, height [dm], local shape; (POINTS, FEATURES)."""
        height = self.points[:, 2:3]
        x = np.hstack([10 * (self.points - self.centre), self.normals, 10 * height])
        return np.hstack([x.astype(np.float32), self.shape])

    def reordered(self, order: Index) -> ObjectCloud:
        """The same cloud with its points in another order (the first ones stand for the whole)."""
        return ObjectCloud(
            self.points[order], self.normals[order], self.pixels[order], self.centre, self.shape[order]
        )


@dataclass(frozen=True, eq=False)
class Pyramid:
    """Neighbourhoods of the network's three levels; level 0 is the cloud, the others its first points.

    Attributes:
        down: Indices of the neighbours of each coarser point one level below, shapes (coarse[i], neighbours).
        up: Indices of the three nearest coarser points of each finer one, shapes (finer, 3).
        weight: Their weights, rows sum to 1, shapes as ``up``.
    """

    down: tuple[Index, Index]
    up: tuple[Index, Index]
    weight: tuple[NDArray[np.float32], NDArray[np.float32]]


class SeenObject:
    """The largest connected thing above the table, ready to be sampled."""

    def __init__(self, frame: DepthFrame) -> None:
        """Prepare one view.

        Raises:
            BadViewError: Nothing stands on the table.
        """
        view = DepthView(frame)
        assert view.p_camera is not None
        near = np.linalg.norm(view.points - view.p_camera, axis=1) < REACH_M
        index = np.flatnonzero(near & (view.points[:, 2] > TABLE_M))
        if len(index) < FEWEST:
            raise BadViewError(
                f"only {len(index)} points lie above the table (z > {TABLE_M * 1e3:.0f} mm) within {REACH_M:g} m, at"
                f" least {FEWEST} are needed; is the object in view and the camera's pose right?"
            )
        self._view, self._index = view, index[_largest_piece(view.points[index])]
        detail = view.edge[self._index] | ~view.normal_ok[self._index]
        weight = np.where(detail, DETAIL, 1.0)
        self._share = weight / weight.sum()

    def sample(self, rng: np.random.Generator) -> ObjectCloud:
        """`POINTS` points in random order; edges and small things get more of them than plain faces."""
        view, few = self._view, len(self._index) < POINTS
        chosen = rng.choice(self._index, POINTS, replace=few, p=None if few else self._share)
        p, n = view.points[chosen], view.normals[chosen]
        flags = np.stack([view.edge[chosen], view.normal_ok[chosen]], axis=1)
        shape = np.hstack([flags, local_shape(p, n)]).astype(np.float32)
        return ObjectCloud(p, n, view.flat[chosen], p.mean(axis=0), shape)


def object_cloud(frame: DepthFrame, rng: np.random.Generator) -> ObjectCloud:
    """Sample the largest connected thing above the table.

    Raises:
        BadViewError: Nothing stands there.
    """
    return SeenObject(frame).sample(rng)


def local_shape(points: Array, normals: Array) -> Array:
    """Relief at two scales: (POINTS, 2 * 3).

    Per scale: how far a point stands out of the mean of its neighbours along its own normal [cm], how much their
    normals differ from its own (0 = plane), and how wide the neighbourhood is [dm].
    """
    tree = cKDTree(points)
    columns = []
    _, neighbour = tree.query(points, k=SCALES[-1])
    for count in SCALES:
        near = np.asarray(neighbour)[:, :count]
        offset = points[near].mean(axis=1) - points
        bend = 1.0 - np.einsum("nki,ni->n", normals[near], normals) / count
        spread = np.linalg.norm(points[near] - points[:, None], axis=2).mean(axis=1)
        columns += [-100 * np.einsum("ni,ni->n", offset, normals), bend, 10 * spread]
    return np.stack(columns, axis=1)


def pyramid(points: Array, coarse: tuple[int, int] = COARSE, neighbours: int = NEIGHBOURS) -> Pyramid:
    """Neighbourhoods of a cloud in random order (its first points stand for the whole)."""
    levels = [points, points[: coarse[0]], points[: coarse[1]]]
    trees = [cKDTree(level) for level in levels]
    down, up, weight = [], [], []
    for fine in (0, 1):
        _, neighbour = trees[fine].query(levels[fine + 1], k=neighbours)
        down.append(np.asarray(neighbour, dtype=np.int64))
        distance, nearest = trees[fine + 1].query(levels[fine], k=3)
        inverse = 1.0 / (np.asarray(distance) + 1e-4)
        up.append(np.asarray(nearest, dtype=np.int64))
        weight.append((inverse / inverse.sum(axis=1, keepdims=True)).astype(np.float32))
    return Pyramid((down[0], down[1]), (up[0], up[1]), (weight[0], weight[1]))


def _largest_piece(points: Array) -> NDArray[np.bool_]:
    at = np.floor(points / CELL_M).astype(np.int64)
    at -= at.min(axis=0)
    # One number per cell: sorting numbers is far quicker than sorting rows.
    number, inverse = np.unique(np.ravel_multi_index(tuple(at.T), at.max(axis=0) + 1), return_inverse=True)
    cell = np.stack(np.unravel_index(number, at.max(axis=0) + 1), axis=1)
    tree = cKDTree(cell.astype(np.float64))
    _, label = connected_components(
        tree.sparse_distance_matrix(tree, 1.8, output_type="coo_matrix"), directed=False
    )
    of_point = label[inverse]
    return of_point == np.bincount(of_point).argmax()
