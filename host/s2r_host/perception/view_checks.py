"""What makes depth, colour, points or a camera no measurement, and is refused by name."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.errors import BadViewError

FloatArray = NDArray[np.floating]

NEAREST_M = 0.05
FARTHEST_M = 20.0
FEWEST_POINTS = 200
MOST_SKEW = 1e-3  # of the focal length; nothing here reckons with skew
# Of an image, how far from its middle its camera may look: lenses sit within a tenth. Intrinsics of 4/3 of the image's
# resolution are a sixth off.
MOST_OFF_CENTRE = 0.15


def check_depth(depth_m: FloatArray) -> None:
    """Refuse an image that holds no distances in metres.

    Raises:
        BadViewError: Says what it holds.
    """
    if depth_m.ndim != 2 or depth_m.size == 0:
        raise BadViewError(f"depth has shape {depth_m.shape}; expected a (height, width) image in metres")
    if not np.isfinite(depth_m).all():
        bad = int((~np.isfinite(depth_m)).sum())
        raise BadViewError(
            f"depth holds {bad} values that are not finite; write 0 where the camera has no return"
        )
    valid = depth_m[depth_m != 0]
    if valid.size < FEWEST_POINTS:
        raise BadViewError(
            f"depth holds {valid.size} returns, at least {FEWEST_POINTS} are needed; is the view empty?"
        )
    _check_range("depth", valid)


def check_colour(colour: NDArray[np.generic], shape: tuple[int, ...]) -> None:
    """Refuse colours that are not one per pixel of a depth image of some shape.

    Raises:
        BadViewError: Says which shape and type are expected.
    """
    if colour.shape != (*shape, 3) or colour.dtype != np.uint8:
        raise BadViewError(
            f"colour is {colour.dtype} with shape {colour.shape}; expected uint8 with shape {(*shape, 3)},"
            " a colour per pixel of the depth: convert it, or leave it out"
        )


def check_points(points: NDArray[np.floating]) -> None:
    """Refuse a cloud that holds no points in metres.

    Raises:
        BadViewError: Says what it holds.
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise BadViewError(f"a cloud has shape (points, 3), got {points.shape}")
    if len(points) < FEWEST_POINTS:
        raise BadViewError(f"the cloud holds {len(points)} points, at least {FEWEST_POINTS} are needed")
    if not np.isfinite(points).all():
        bad = int((~np.isfinite(points).all(axis=1)).sum())
        raise BadViewError(f"the cloud holds {bad} points that are not finite; drop them before writing")
    extent = np.ptp(np.percentile(points, [5, 95], axis=0), axis=0)
    if extent.max() > FARTHEST_M:
        raise BadViewError(
            f"the cloud spans {extent.max():.4g} m, beyond {FARTHEST_M:g} m: these look like millimetres;"
            " give metres"
        )
    if extent.max() < 0.01:
        raise BadViewError(f"the cloud spans only {extent.max() * 1e3:.3g} mm; give metres")


def check_pinhole(K: NDArray[np.floating]) -> None:
    """Refuse a matrix that is no pinhole camera's.

    Raises:
        BadViewError: Says what is wrong with it.
    """
    if K.shape != (3, 3) or not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise BadViewError(
            "K must be a finite 3x3 pinhole matrix with positive focal lengths in pixels, got\n" + str(K)
        )
    if np.abs(K[2] - (0.0, 0.0, 1.0)).max() > 1e-6 or abs(K[1, 0]) > 1e-6:
        raise BadViewError(
            f"K must end in the row 0 0 1 and have no skew below its diagonal, got\n{K}\nis it transposed (column by"
            " column)?"
        )
    if abs(K[0, 1]) > MOST_SKEW * K[0, 0]:
        raise BadViewError(
            f"K has a skew of {K[0, 1]:.4g} px, which nothing here reckons with; rectify the images"
        )


def check_centred(K: NDArray[np.floating], shape: tuple[int, ...]) -> None:
    """Refuse intrinsics that do not look at the middle of their image, as those of another resolution do not.

    For what a user or a camera gives: images that are cut out or made up here are off centre on purpose.

    Raises:
        BadViewError: Names the image that the intrinsics would fit.
    """
    size = np.array(shape[1::-1])
    if np.abs(K[:2, 2] / size - 0.5).max() > MOST_OFF_CENTRE:
        w, h = size
        raise BadViewError(
            f"principal point ({K[0, 2]:.1f}, {K[1, 2]:.1f}) px does not belong to a {w}x{h} image: it would be the"
            f" middle of {2 * K[0, 2]:.0f}x{2 * K[1, 2]:.0f}. Are the intrinsics of another resolution? Of an image"
            " that was cut out of another one give that whole one, 0 (no return) beside the cut"
        )


def check_pose(X_base_camera: NDArray[np.floating], name: str = "T_base_camera") -> None:
    """Refuse a matrix that is no pose of a camera in metres.

    Args:
        X_base_camera: The matrix.
        name: What a user knows it by.

    Raises:
        BadViewError: Says what is wrong with it.
    """
    if X_base_camera.shape != (4, 4) or not np.isfinite(X_base_camera).all():
        raise BadViewError(f"{name} must be a finite 4x4 matrix")
    if np.abs(X_base_camera[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-6:
        raise BadViewError(
            f"{name} must end in the row 0 0 0 1, got\n{X_base_camera}\nis it transposed (column by column)?"
        )
    R = X_base_camera[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        raise BadViewError(
            f"the rotation in {name} is not a rotation matrix"
            f" (|R Rᵀ - 1| = {np.abs(R @ R.T - np.eye(3)).max():.3g}, det {np.linalg.det(R):.3f})"
        )
    if np.abs(X_base_camera[:3, 3]).max() > FARTHEST_M:
        raise BadViewError(
            f"{name} puts the camera {np.abs(X_base_camera[:3, 3]).max():.4g} m away; give metres"
        )


def _check_range(what: str, distance_m: FloatArray) -> None:
    if distance_m.min() < 0:
        raise BadViewError(f"{what} holds negative values (least {distance_m.min():.3g} m)")
    median = float(np.median(distance_m))
    if median > FARTHEST_M:
        raise BadViewError(
            f"{what} has a median of {median:.4g} m, beyond {FARTHEST_M:g} m: these look like millimetres;"
            " give metres"
        )
    if median < NEAREST_M:
        raise BadViewError(
            f"{what} has a median of {median:.3g} m, nearer than {NEAREST_M:g} m; give metres, not kilometres"
        )
