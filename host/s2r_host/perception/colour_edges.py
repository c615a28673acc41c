"""Edges of colour in an image, sub-pixel: where stereo depth is smeared, they are sharp."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

SMOOTH_PX = 0.8
# 8-bit levels a pixel: the edge of a side that is about as grey as what is behind it has no more than two. Where the
# image has grain, an edge stands out from that.
LEAST_CONTRAST, GRAINS = 2.0, 4.0
# An edge that two looks from one place have within so far, at an angle of that cosine, has stayed.
STILL_PX, STILL_SIDE = 1.2, 0.95
NEIGHBOURS = 8


@dataclass(frozen=True, eq=False)
class ColourEdges:
    """Edges in an image: where, sub-pixel, (n, 2), and unit vectors across them, (n, 2)."""

    uv: Array
    across: Array

    @cached_property
    def tree(self) -> cKDTree:
        """Of the places."""
        return cKDTree(self.uv)

    def of(self, chosen: Mask) -> ColourEdges:
        """Some of them."""
        return ColourEdges(self.uv[chosen], self.across[chosen])

    def nearest(self, uv: Array, across: Array, reach_px: float, side: float) -> NDArray[np.int64]:
        """For other edges (m, 2) the nearest of these at about the same angle, -1 where there is none, (m,).

        Args:
            uv, across: The others.
            reach_px: Largest distance.
            side: Least cosine between the vectors across.
        """
        if not len(self.uv):
            return np.full(len(uv), -1)
        distance, index = self.tree.query(uv, k=NEIGHBOURS, distance_upper_bound=reach_px)
        fits = np.isfinite(distance)
        index = np.where(fits, index, 0)
        fits &= np.abs(np.einsum("nki,ni->nk", self.across[index], across)) > side
        first = np.argmax(fits, axis=1)
        return np.where(fits.any(axis=1), index[np.arange(len(index)), first], -1)

    def stayed(self, other: ColourEdges) -> Mask:
        """Which of them another look from the same place has as well, (n,)."""
        return np.asarray(other.nearest(self.uv, self.across, STILL_PX, STILL_SIDE) >= 0)

    def without(self, other: ColourEdges) -> ColourEdges:
        """Without those that another look has at the same place."""
        return self.of(~self.stayed(other))


def colour_edges(colour: NDArray[np.uint8], where: Mask) -> ColourEdges:
    """Ridges of the change of colour, all channels together (Di Zenzo's gradient).

    Args:
        colour: The image, (h, w, 3).
        where: Pixels in which they are wanted, (h, w).
    """
    image = cv2.GaussianBlur(colour.astype(np.float32), (0, 0), SMOOTH_PX)
    gx, gy = (cv2.Sobel(image, cv2.CV_32F, *axes, scale=0.125) for axes in ((1, 0), (0, 1)))
    xx, yy, xy = ((a * b).sum(axis=2) for a, b in ((gx, gx), (gy, gy), (gx, gy)))
    change = np.sqrt(0.5 * (xx + yy + np.sqrt((xx - yy) ** 2 + 4.0 * xy**2)))
    grain = float(np.median(change[where])) if where.any() else 0.0
    v, u = np.nonzero((change > max(LEAST_CONTRAST, GRAINS * grain)) & where)
    if not len(v):
        return ColourEdges(np.empty((0, 2)), np.empty((0, 2)))
    angle = 0.5 * np.arctan2(2.0 * xy[v, u], xx[v, u] - yy[v, u])
    across = np.column_stack([np.cos(angle), np.sin(angle)]).astype(float)
    uv = np.column_stack([u, v]).astype(float)
    low, high = (_at(change, uv + side * across) for side in (-1.0, 1.0))
    here = change[v, u]
    ridge = (here >= low) & (here > high)
    along = 0.5 * (low - high) / np.minimum(low - 2.0 * here + high, -1e-6)
    uv = uv + np.clip(along, -0.5, 0.5)[:, None] * across
    return ColourEdges(uv[ridge], across[ridge])


def _at(image: Array, uv: Array) -> Array:
    """Values between pixels, (n,)."""
    x, y = uv.astype(np.float32).T
    return np.asarray(cv2.remap(image, x[:, None], y[:, None], cv2.INTER_LINEAR)[:, 0], np.float32)
