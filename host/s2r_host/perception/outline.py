"""Where a thing ends in the image: its outline in colour, sharper than its depth edge.

A stereo matcher compares windows, so a near thing's depth reaches some pixels beyond its outline on one side and ends
short of it on the other, where the second imager or the projector does not see. The colour image knows nothing of that:
from each end of the near depth the outline is looked for across it, up to the first return from farther away.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

INSIDE_PX, OUTSIDE_PX, STEP_PX = 6.0, 10.0, 0.25
HOLE_PX = 10  # a gap without returns so wide may lie between a near thing's depth and what is behind it
NORMAL_SIGMA_PX = 2.5  # of the smoothing before the edge's normal is taken
COLOUR_SIGMA_PX = 0.7
LEAST_CONTRAST = 8.0  # 8-bit levels a pixel
LEAST_SHARE = 0.5  # of the strongest change on the way, for one further out to be the outline
DEEPER_PX = 2.0  # how far inside of the outline its depth is read
JUMP = 0.02  # of the depth, at least of that at 0.3 m: from there on it is another surface


@dataclass(frozen=True, eq=False)
class Outline:
    """Points of outlines, at the depth of the nearer thing.

    Attributes:
        pixel: Index of the depth pixel at whose side each lies, (n,).
        p_C: In the camera frame [m], (n, 3).
        outward_C: Unit vectors in the image plane, away from the nearer thing, camera frame, (n, 3).
    """

    pixel: NDArray[np.int64]
    p_C: Array
    outward_C: Array


def outline(depth_m: Array, colour: NDArray[np.uint8], K: Array, wanted: Mask) -> Outline:
    """Outlines of the nearer things.

    Args:
        depth_m: Shape (h, w), 0 = no return.
        colour: RGB registered to the depth, (h, w, 3).
        K: Pinhole matrix, (3, 3).
        wanted: Pixels of things whose outline is wanted, (h, w).
    """
    far = cv2.dilate(depth_m, np.ones((2 * HOLE_PX + 1,) * 2, np.uint8))
    near = (depth_m > 0) & (far - depth_m > JUMP * np.maximum(depth_m, 0.3))
    ends = near & wanted & _beside(depth_m)
    pixel = np.flatnonzero(ends)
    v, u = np.divmod(pixel, depth_m.shape[1])
    n = _outward(np.where(depth_m > 0, depth_m, far), v, u)
    ok = np.isfinite(n).all(axis=1)
    pixel, u, v, n = pixel[ok], u[ok], v[ok], n[ok]
    if not len(pixel):
        return Outline(pixel, np.empty((0, 3)), np.empty((0, 3)))
    along = np.arange(-INSIDE_PX, OUTSIDE_PX + 1e-9, STEP_PX)
    x = (u[:, None] + along * n[:, :1]).astype(np.float32)
    y = (v[:, None] + along * n[:, 1:]).astype(np.float32)
    image = cv2.GaussianBlur(colour.astype(np.float32), (0, 0), COLOUR_SIGMA_PX)
    # Beyond the image nothing changes: black there would be the clearest edge of all.
    seen = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    change = np.linalg.norm(np.gradient(seen, STEP_PX, axis=1), axis=2)
    behind = cv2.remap(depth_m.astype(np.float32), x, y, cv2.INTER_NEAREST)
    own = depth_m.ravel()[pixel]
    behind = behind > own[:, None] + JUMP * np.maximum(own, 0.3)[:, None]
    change[np.cumsum(behind & (along > 0), axis=1) > round(1 / STEP_PX)] = 0.0
    row, k = _outermost(change)
    a, b, c = change[row, k - 1], change[row, k], change[row, k + 1]
    s = along[k] + STEP_PX * 0.5 * (a - c) / np.minimum(a - 2 * b + c, -1e-9)
    uv = np.stack([u[row], v[row]], axis=1) + s[:, None] * n[row]
    z = _near_depth(depth_m, uv, n[row], own[row])
    p_C = np.column_stack([(uv - K[:2, 2]) / K[[0, 1], [0, 1]] * z[:, None], z])
    return Outline(pixel[row], p_C, np.column_stack([n[row], np.zeros(len(row))]))


def _beside(depth_m: Array) -> Mask:
    """Pixels next to one without a return or much farther away."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    returned = cv2.erode((depth_m > 0).astype(np.uint8), cross) > 0
    return ~returned | (cv2.dilate(depth_m, cross) - depth_m > JUMP * np.maximum(depth_m, 0.3))


def _outermost(change: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows (m,) with a clear change of colour and the column of its outermost peak, (m,)."""
    peak = np.zeros(change.shape, bool)
    peak[:, 1:-1] = (change[:, 1:-1] >= change[:, :-2]) & (change[:, 1:-1] > change[:, 2:])
    peak &= (change >= LEAST_CONTRAST) & (change >= LEAST_SHARE * change.max(axis=1, keepdims=True))
    row = np.flatnonzero(peak.any(axis=1))
    return row, peak.shape[1] - 1 - np.argmax(peak[row, ::-1], axis=1)


def _outward(depth_m: Array, v: NDArray[np.int64], u: NDArray[np.int64]) -> Array:
    """Unit normals in the image from near to far, NaN where it does not tell, (n, 2)."""
    smooth = cv2.GaussianBlur(depth_m.astype(np.float32), (0, 0), NORMAL_SIGMA_PX)
    slope = [cv2.Sobel(smooth, cv2.CV_32F, *axes)[v, u] for axes in ((1, 0), (0, 1))]
    n = np.stack(slope, axis=1).astype(float)
    length = np.linalg.norm(n, axis=1, keepdims=True)
    return np.where(length > 1e-4, n / np.maximum(length, 1e-9), np.nan)


def _near_depth(depth_m: Array, uv: Array, outward: Array, own: Array) -> Array:
    """Depth of the nearer thing some pixels inside of its outline; that of its own pixel where nothing returned."""
    u, v = np.rint(uv - DEEPER_PX * outward).astype(int).T
    h, w = depth_m.shape
    z = np.where((u >= 0) & (u < w) & (v >= 0) & (v < h), depth_m[v.clip(0, h - 1), u.clip(0, w - 1)], 0.0)
    return np.where((z > 0) & (np.abs(z - own) < JUMP * own), z, own)
