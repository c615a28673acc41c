"""A depth view prepared for questions: which surface does the camera see where this point would be?

The plane fit works on inverse depth, which is linear in pixel coordinates on any plane and in which the noise
of a stereo or structured-light camera is uniform (its depth noise grows with z²).
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from s2r_host.perception.errors import BadViewError
from s2r_host.perception.frames import Cloud, DepthFrame, pixel_rays

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

WIDEST_PX = 900
MOST_CLOUD_POINTS = 40_000


class Seen(enum.IntEnum):
    """What a view says about a point in space."""

    OUT = 0  # outside the image
    NO_RETURN = 1  # the camera got no depth there
    SURFACE = 2  # on the surface the camera saw
    FREE = 3  # the camera saw through it: nothing is there
    HIDDEN = 4  # behind a seen surface


@dataclass(frozen=True, eq=False)
class Lookup:
    """Answers for m query points.

    Attributes:
        seen: `Seen` values, uint8, shape (m,).
        index: Index of the surface point in the view's ``points`` (-1 where there is none), shape (m,).
        gap_m: How far the surface lies behind the query along the viewing ray [m] (0 where unknown).
    """

    seen: NDArray[np.uint8]
    index: Index
    gap_m: Array


class View(Protocol):
    """What estimation needs of a view, with or without a camera.

    ``points`` (n, 3) [m] base frame, ``normals`` (n, 3), ``normal_ok`` (n,), ``sigma_m`` (n,) depth noise;
    ``oriented``: normals point to the camera (else their sign means nothing).
    """

    points: Array
    normals: Array
    normal_ok: Mask
    sigma_m: Array
    edge: Mask
    p_camera: Array | None
    oriented: bool

    def look(self, p: Array, sigma_m: Array | float, extra_m: float = 0.0) -> Lookup:
        """Classify points (m, 3); ``sigma_m`` is their own noise, ``extra_m`` widens the surface."""
        ...


def noise_sigma(z: NDArray[np.floating], scale: float = 1.0) -> Array:
    """Depth noise [m] at depth z [m].

    0.4 mm + 1.4 mm/m² z² (1.5 mm at 0.9 m): between a D415 on textured flats (0.8-1.6 mm at 0.9 m) and the
    structured-light head camera of a TIAGo robot (1.5 mm at 0.7-1.0 m).
    """
    return scale * (0.0004 + 0.0014 * np.asarray(z, dtype=np.float64) ** 2)


def thinning(frame: DepthFrame) -> int:
    """Of how many pixels in a row, and of how many rows, a view of a depth image takes one."""
    return max(1, -(-frame.depth_m.shape[1] // WIDEST_PX))


class DepthView:
    """A depth image with per-pixel normals and noise; answers by projection."""

    oriented = True

    def __init__(self, frame: DepthFrame, ignore: Mask | None = None, noise_scale: float = 1.0) -> None:
        """Prepare a view.

        Args:
            frame: The depth image.
            ignore: Pixels (h, w) to forget, e.g. the robot.
            noise_scale: Factor on the depth noise.

        Raises:
            BadViewError: ``ignore`` is not of the image's size.
        """
        if ignore is not None and ignore.shape != frame.depth_m.shape:
            raise BadViewError(
                f"ignore has shape {ignore.shape}, the frame's depth {frame.depth_m.shape}; they must agree"
            )
        stride = thinning(frame)
        depth = np.array(frame.depth_m, dtype=np.float64)
        # Images of 0 and 1, as OpenCV has masks, would be taken for numbers of rows.
        self.ignored: Mask = np.zeros(depth.shape, bool) if ignore is None else ignore.astype(bool)
        depth[self.ignored] = 0.0
        self.stride = stride
        self.full_shape: tuple[int, int] = (depth.shape[0], depth.shape[1])
        depth, self.ignored = depth[::stride, ::stride], self.ignored[::stride, ::stride]
        self.K = frame.K.astype(np.float64)
        self.K[:2] /= stride
        self.depth = depth
        self.shape: tuple[int, int] = (depth.shape[0], depth.shape[1])
        self.X_base_camera = frame.X_base_camera
        self.X_camera_base = np.linalg.inv(frame.X_base_camera)
        self.p_camera: Array | None = frame.X_base_camera[:3, 3]
        self.colour = None if frame.colour is None else frame.colour[::stride, ::stride]
        self.noise_scale = noise_scale
        self._prepare()

    def _prepare(self) -> None:
        h, w = self.shape
        valid = self.depth > 0
        far = np.where(valid, self.depth, 0.0)
        near = np.where(valid, self.depth, np.inf)
        kernel = np.ones((3, 3), np.uint8)
        self._z_max = cv2.dilate(far, kernel)
        self._z_min = cv2.erode(near, kernel)
        smooth, normal_C, ok = fit_planes(self.depth, self.K, self.noise_scale)
        self.flat = np.flatnonzero(valid)  # pixel of every point
        self.index_of_pixel = np.full(h * w, -1, dtype=np.int64)
        self.index_of_pixel[self.flat] = np.arange(len(self.flat))
        v, u = np.divmod(self.flat, w)
        z = smooth.ravel()[self.flat]
        p_C = pixel_rays(self.K, u, v) * z[:, None]
        R = self.X_base_camera[:3, :3]
        self.points: Array = p_C @ R.T + self.X_base_camera[:3, 3]
        self.normals: Array = normal_C.reshape(-1, 3)[self.flat] @ R.T
        self.normal_ok: Mask = ok.ravel()[self.flat]
        self.sigma_m: Array = noise_sigma(z, self.noise_scale)
        self.edge: Mask = self._occluding_edges().ravel()[self.flat]

    def _occluding_edges(self) -> Mask:
        """Pixels on the near side of a depth jump, up to three pixels across a hole."""
        far = cv2.dilate(np.where(self.depth > 0, self.depth, 0.0), np.ones((7, 7), np.uint8))
        step = cv2.dilate(np.where(self.depth > 0, self.depth, 0.0), np.ones((3, 3), np.uint8))
        jump = 0.02 * np.maximum(self.depth, 0.3)
        border = (step - self.depth > 0.6 * jump) | (
            cv2.erode((self.depth > 0).astype(np.uint8), np.ones((3, 3), np.uint8)) == 0
        )
        return (self.depth > 0) & (far - self.depth > jump) & border

    def look(self, p: Array, sigma_m: Array | float, extra_m: float = 0.0) -> Lookup:
        """Classify points (m, 3) by projecting them into the image; see `View.look`."""
        h, w = self.shape
        X = self.X_camera_base
        z = p @ X[2, :3] + X[2, 3]
        ahead = z > 0.02
        inverse = 1.0 / np.where(ahead, z, 1.0)
        u = np.rint(self.K[0, 0] * (p @ X[0, :3] + X[0, 3]) * inverse + self.K[0, 2])
        v = np.rint(self.K[1, 1] * (p @ X[1, :3] + X[1, 3]) * inverse + self.K[1, 2])
        inside = ahead & (u >= 0) & (u < w) & (v >= 0) & (v < h)
        flat = np.where(inside, v * w + u, 0).astype(np.int64)
        index = np.where(inside, self.index_of_pixel[flat], -1)
        z_max, z_min = self._z_max.ravel()[flat], self._z_min.ravel()[flat]
        own = noise_sigma(z, self.noise_scale)
        tolerance = 3.0 * np.hypot(own, sigma_m) + extra_m
        seen = np.full(len(p), Seen.SURFACE, dtype=np.uint8)
        seen[z < z_min - tolerance] = Seen.FREE
        seen[z > z_max + tolerance] = Seen.HIDDEN
        seen[index < 0] = Seen.NO_RETURN
        seen[~inside] = Seen.OUT
        gap = np.where(index >= 0, self.depth.ravel()[flat] - z, 0.0)
        return Lookup(seen, index, gap)

    def image(self, per_point: NDArray[np.generic], fill: float | int | bool = 0) -> NDArray[np.generic]:
        """Spread values per point over the full-resolution image, shape (h, w)."""
        small = np.full(self.shape[0] * self.shape[1], fill, dtype=per_point.dtype)
        small[self.flat] = per_point
        small = small.reshape(self.shape)
        if self.stride > 1:
            small = small.repeat(self.stride, axis=0).repeat(self.stride, axis=1)
            small = small[: self.full_shape[0], : self.full_shape[1]]
        return small


class CloudView:
    """A cloud without a camera: only nearness to its points is known, never free space."""

    oriented = False

    def __init__(self, cloud: Cloud, rng: np.random.Generator) -> None:
        points = cloud.points
        if len(points) > MOST_CLOUD_POINTS:
            points = points[np.sort(rng.permutation(len(points))[:MOST_CLOUD_POINTS])]
        self.points: Array = points
        self.p_camera: Array | None = cloud.p_camera
        self._tree = cKDTree(points)
        distance, neighbour = self._tree.query(points, k=min(24, len(points)))
        self.spacing_m = float(np.median(distance[:, 4]))
        centred = points[neighbour] - points[neighbour].mean(axis=1, keepdims=True)
        values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
        self.normals: Array = vectors[:, :, 0]
        self.normal_ok: Mask = values[:, 0] < 0.05 * values[:, 1]
        self.sigma_m: Array = np.full(len(points), 0.0016)
        self.edge: Mask = np.zeros(len(points), dtype=bool)

    def look(self, p: Array, sigma_m: Array | float, extra_m: float = 0.0) -> Lookup:
        """Classify points (m, 3) by their nearest neighbour; see `View.look`."""
        reach = 2.0 * self.spacing_m + extra_m
        distance, index = self._tree.query(p, distance_upper_bound=max(reach, 0.06))
        near = np.isfinite(distance)
        index = np.where(near, index, 0).astype(np.int64)
        offset = np.einsum("ni,ni->n", p - self.points[index], self.normals[index])
        across = np.sqrt(np.maximum(np.where(near, distance, 0) ** 2 - offset**2, 0.0))
        tolerance = 3.0 * np.hypot(self.sigma_m[index], sigma_m) + extra_m
        on = near & (np.abs(offset) < tolerance) & (across < reach)
        seen = np.where(on, Seen.SURFACE, np.where(near, Seen.NO_RETURN, Seen.OUT)).astype(np.uint8)
        return Lookup(seen, np.where(near, index, -1), np.where(on, -offset, 0.0))


def agreement(n: Array, other: Array, oriented: bool) -> Array:
    """Cosine between normals (m, 3); its absolute value where their signs mean nothing."""
    cosine = np.einsum("ni,ni->n", n, other)
    return cosine if oriented else np.abs(cosine)


def fit_planes(depth: Array, K: Array, noise_scale: float = 1.0) -> tuple[Array, Array, Mask]:
    """Local planes by least squares on inverse depth.

    Returns:
        Smoothed depth [m] (h, w), unit normals towards the camera in the camera frame (h, w, 3), and where
        the fit is good (elsewhere raw depth and the viewing direction are returned).
    """
    valid = depth > 0
    inverse = np.where(valid, 1.0 / np.where(valid, depth, 1.0), 0.0)
    kernel = np.ones((3, 3), np.uint8)
    top = cv2.dilate(np.where(valid, depth, 0.0), kernel)
    low = cv2.erode(np.where(valid, depth, np.inf), kernel)
    weight = (valid & (top - low < 0.02 * np.maximum(depth, 0.3))).astype(np.float64)
    h, w = depth.shape
    u, v = np.meshgrid(np.arange(w, dtype=np.float64), np.arange(h, dtype=np.float64))
    sigma_d = noise_sigma(depth, noise_scale) * inverse**2
    slope_u, slope_v, value, good = np.zeros((h, w)), np.zeros((h, w)), inverse.copy(), np.zeros((h, w), bool)
    for size in (11, 5):
        a, b, c, rms, count = _window_fit(inverse, weight, u, v, size)
        fits = valid & (weight > 0) & (count > 0.5 * size * size) & (rms < 2.0 * sigma_d) & (c > 0)
        take = fits & ~good
        slope_u[take], slope_v[take], value[take] = a[take], b[take], c[take]
        good |= take
    # On the plane: 1/z = a (u - u0) + b (v - v0) + c with u = fx x/z + cx, hence the normal below.
    ray = pixel_rays(K, u, v)
    nx, ny = slope_u * K[0, 0], slope_v * K[1, 1]
    nz = value - nx * ray[..., 0] - ny * ray[..., 1]
    normal = np.stack([nx, ny, nz], axis=-1)
    normal = np.where(good[..., None], normal, ray)
    normal = -normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    smooth = np.where(good, 1.0 / np.where(good, value, 1.0), depth)
    return smooth, normal, good


def _window_fit(
    d: Array, w: Array, u: Array, v: Array, size: int
) -> tuple[Array, Array, Array, Array, Array]:
    """Weighted fit d ~ a (u-u0) + b (v-v0) + c in a square window: a, b, c, rms, count, each (h, w)."""

    def box(image: Array) -> Array:
        summed = cv2.boxFilter(
            image, cv2.CV_64F, (size, size), normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        return np.asarray(summed, dtype=np.float64)

    sw, su, sv, sd = box(w), box(w * u), box(w * v), box(w * d)
    suu, suv, svv = box(w * u * u), box(w * u * v), box(w * v * v)
    sud, svd, sdd = box(w * u * d), box(w * v * d), box(w * d * d)
    n = np.maximum(sw, 1e-9)
    mu, mv, md = su / n, sv / n, sd / n
    cuu, cuv, cvv = suu / n - mu * mu, suv / n - mu * mv, svv / n - mv * mv
    cud, cvd, cdd = sud / n - mu * md, svd / n - mv * md, sdd / n - md * md
    det = cuu * cvv - cuv * cuv
    flat = det < 1e-3
    det = np.where(flat, 1.0, det)
    a = np.where(flat, 0.0, (cud * cvv - cvd * cuv) / det)
    b = np.where(flat, 0.0, (cvd * cuu - cud * cuv) / det)
    c = md + a * (u - mu) + b * (v - mv)
    rms = np.sqrt(np.maximum(cdd - a * cud - b * cvd, 0.0))
    return a, b, c, np.where(flat, np.inf, rms), sw
