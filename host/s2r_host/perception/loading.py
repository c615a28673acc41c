"""Read depth views from files: PLY, NPZ, and 16-bit depth PNG with a camera file.

``camera.json``: ``{"intrinsics": {"fx", "fy", "cx", "cy", "width", "height"}, "base_T_camera": 4x4}``; pixels,
metres, OpenCV camera frame. ``base_T_camera`` may be absent with ``frame="camera"``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from zipfile import BadZipFile, is_zipfile

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.errors import BadViewError, InputError
from s2r_host.perception.frames import Cloud, DepthFrame
from s2r_host.perception.ply_whole import check_whole
from s2r_host.perception.view_checks import FEWEST_POINTS, check_centred, check_points, check_pose

FrameName = Literal["base", "camera"]
WIDEST_PX = 20_000


@dataclass(frozen=True, eq=False)
class Camera:
    """Intrinsics [px] and pose of a camera as read from ``camera.json``."""

    K: NDArray[np.floating]
    width: int
    height: int
    X_base_camera: NDArray[np.floating] | None


def load_camera(path: Path) -> Camera:
    """Read ``camera.json``.

    Raises:
        InputError: The file cannot be read, lacks a field, or tells of no camera; the text says what is wrong.
    """
    try:
        content = json.loads(path.read_text())
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"camera file {path}: {error}") from error
    try:
        intrinsics = content["intrinsics"]
        fx, fy, cx, cy = (float(intrinsics[key]) for key in ("fx", "fy", "cx", "cy"))
        width, height = int(intrinsics["width"]), int(intrinsics["height"])
        pose = content.get("base_T_camera")
        X = None if pose is None else np.asarray(pose, dtype=np.float64)
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise InputError(
            f"camera file {path}: missing or unusable field {error}; it needs"
            ' {"intrinsics": {"fx","fy","cx","cy","width","height"}, "base_T_camera": 4x4}'
        ) from error
    if not (np.isfinite([fx, fy, cx, cy]).all() and fx > 0 and fy > 0):
        raise InputError(
            f"camera file {path}: fx {fx:g}, fy {fy:g}, cx {cx:g}, cy {cy:g}; expected finite pixels, fx and fy above 0"
        )
    if not (1 <= width <= WIDEST_PX and 1 <= height <= WIDEST_PX):
        raise InputError(
            f"camera file {path}: an image of {width}x{height}; expected 1 to {WIDEST_PX} pixels each"
        )
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    try:
        check_centred(K, (height, width))
        if X is not None:
            check_pose(X, "base_T_camera")
    except BadViewError as error:
        raise InputError(f"camera file {path}: {error}") from error
    return Camera(K, width, height, X)


def load_frame(path: Path | str, frame: FrameName = "base", camera: Path | None = None) -> DepthFrame | Cloud:
    """Read one view.

    Args:
        path: ``.ply`` (points in metres), ``.npz`` (``depth`` [m], ``K``, ``T_base_camera``) or ``.png`` (16-bit
            depth [mm]).
        frame: "base": results in the fixed frame (z up) of the poses or points; "camera": in the camera's
            OpenCV frame, any pose in the files is ignored.
        camera: ``camera.json``; needed for PNG, useful for PLY (gives back the free space the camera saw).

    Raises:
        InputError: The file or the combination of options is not usable.
        BadViewError: The content is no depth view.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"view {path}: no such file")
    readers = {".ply": _load_ply, ".npz": _load_npz, ".png": _load_png}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"view {path}: unknown kind '{path.suffix}'; accepted are .ply, .npz and .png")
    try:
        return reader(path, frame, None if camera is None else load_camera(camera))
    except BadViewError as error:
        raise BadViewError(f"view {path}: {error}") from error


def _load_npz(path: Path, frame: FrameName, camera: Camera | None) -> DepthFrame:
    if not is_zipfile(path):  # NumPy would take it for a pickle and say so
        raise InputError(f"view {path}: not a readable NPZ file (it is no ZIP archive of arrays)")
    try:
        with np.load(path, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
    except (OSError, ValueError, EOFError, KeyError, AttributeError, BadZipFile) as error:
        raise InputError(f"view {path}: not a readable NPZ file ({error})") from error
    missing = [name for name in ("depth", "K") if name not in arrays]
    if frame == "base" and "T_base_camera" not in arrays and (camera is None or camera.X_base_camera is None):
        missing.append("T_base_camera (or --frame camera)")
    if missing:
        raise InputError(
            f"view {path}: missing {', '.join(missing)}; an NPZ view holds depth [m] (h,w), K (3,3)"
            " and T_base_camera (4,4)"
        )
    depth = np.asarray(arrays["depth"])
    if depth.dtype.kind not in "fiu":
        raise InputError(f"view {path}: depth has type {depth.dtype}; expected metres as float")
    depth = np.array(depth, dtype=np.float32)
    depth[~np.isfinite(depth)] = 0.0  # NaN and, by REP 117, infinity are common for "no return"
    K = np.asarray(arrays["K"], dtype=np.float64)
    if camera is not None:
        _check_needed(path, frame, camera, arrays)
    if frame == "camera":
        X = np.eye(4)
    elif "T_base_camera" in arrays:
        X = np.asarray(arrays["T_base_camera"], dtype=np.float64)
    else:
        assert camera is not None
        X = _pose(path, frame, camera)
    view = DepthFrame(depth, K, X, arrays.get("colour", arrays.get("color")))
    check_centred(K, depth.shape)
    return view


def _check_needed(
    path: Path, frame: FrameName, camera: Camera, arrays: Mapping[str, NDArray[np.generic]]
) -> None:
    """Refuse a camera file beside an NPZ view that has all of its own: one of the two would be left out in silence.

    Raises:
        InputError: The camera gives no pose that the view lacks, or other intrinsics than the view's.
    """
    if frame == "camera" or "T_base_camera" in arrays:
        own = "K, and --frame camera asks for no pose" if frame == "camera" else "K and T_base_camera"
        raise InputError(
            f"view {path} has its own {own}: leave --camera out, or write into the NPZ what shall count"
        )
    K, shape = np.asarray(arrays["K"]), np.shape(arrays["depth"])
    if K.shape != (3, 3) or not np.allclose(K, camera.K, rtol=1e-3) or shape != (camera.height, camera.width):
        raise InputError(
            f"view {path} has a K and a size of its own, and the camera file has others; --camera gives an NPZ view its"
            " pose only: make them agree"
        )


def _load_png(path: Path, frame: FrameName, camera: Camera | None) -> DepthFrame:
    import cv2

    if camera is None:
        raise InputError(f"view {path}: a depth PNG needs --camera camera.json")
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise InputError(f"view {path}: not a readable PNG")
    if image.dtype != np.uint16 or image.ndim != 2:
        raise InputError(
            f"view {path}: a depth PNG is one 16-bit channel in millimetres; this one is {image.dtype}"
            f" with shape {image.shape}"
        )
    if image.shape != (camera.height, camera.width):
        raise InputError(
            f"view {path} is {image.shape[1]}x{image.shape[0]} but the camera file says"
            f" {camera.width}x{camera.height}"
        )
    return DepthFrame((image / np.float32(1000)).astype(np.float32), camera.K, _pose(path, frame, camera))


def _load_ply(path: Path, frame: FrameName, camera: Camera | None) -> DepthFrame | Cloud:
    import open3d as o3d

    check_whole(path)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        cloud = o3d.io.read_point_cloud(path, remove_nan_points=False, remove_infinite_points=False)
    points = np.asarray(cloud.points, dtype=np.float64)
    colour = np.asarray(cloud.colors) if cloud.has_colors() else None
    if len(points) == 0:
        raise BadViewError("holds no points")
    finite = np.isfinite(points).all(axis=1)
    if finite.sum() < FEWEST_POINTS:
        raise BadViewError(
            f"holds {int(finite.sum())} finite points of {len(points)}; {FEWEST_POINTS} needed"
        )
    points = points[finite]
    rgb = None if colour is None else (colour[finite] * 255).astype(np.uint8)
    check_points(points)  # before any projection: wrong units must be named as such
    if frame == "camera":
        K, shape = (camera.K, (camera.height, camera.width)) if camera else virtual_pinhole(points)
        return rasterise(points, K, shape, np.eye(4))
    if camera is not None:
        return rasterise(points, camera.K, (camera.height, camera.width), _pose(path, frame, camera))
    return Cloud(points, None, rgb)


def _pose(path: Path, frame: FrameName, camera: Camera) -> NDArray[np.floating]:
    if frame == "camera":
        return np.eye(4)
    if camera.X_base_camera is None:
        raise InputError(f"view {path}: camera file has no base_T_camera; add it or use --frame camera")
    return camera.X_base_camera


def virtual_pinhole(points_camera: NDArray[np.floating]) -> tuple[NDArray[np.floating], tuple[int, int]]:
    """A pinhole camera at the origin that sees the cloud at about one point per pixel.

    Args:
        points_camera: Points in the OpenCV camera frame [m], shape (n, 3).

    Returns:
        K (3, 3) and the image shape (height, width).

    Raises:
        BadViewError: The points do not lie in front of a camera.
    """
    front = points_camera[:, 2] > 0.05
    if front.mean() < 0.95:
        raise BadViewError(
            f"{100 * (1 - front.mean()):.0f} % of the points lie behind the camera; with --frame camera, z points"
            " forward. Is the cloud in the base frame?"
        )
    xy = points_camera[front, :2] / points_camera[front, 2:]
    low, high = np.percentile(xy, [0.2, 99.8], axis=0)
    size = np.maximum(high - low, 1e-3)
    # Holes are common, so aim at a grid a little coarser than one point per pixel.
    focal = float(np.clip(np.sqrt(front.sum() / np.prod(size)) * 0.9, 60, 900))
    width, height = (int(n) for n in np.ceil(size * focal) + 3)
    K = np.array([[focal, 0, -low[0] * focal + 1.0], [0, focal, -low[1] * focal + 1.0], [0, 0, 1]])
    return K, (height, width)


def rasterise(
    points: NDArray[np.floating],
    K: NDArray[np.floating],
    shape: tuple[int, int],
    X_base_camera: NDArray[np.floating],
) -> DepthFrame:
    """Depth image of a cloud seen by a pinhole camera: nearest point per pixel, single-pixel gaps closed.

    It has no colour: a cloud knows none where it has no point, and just there, at rims and in the shadow of what is
    near, colour images tell what moved.

    Args:
        points: Points in the base frame [m], shape (n, 3).
        K: Pinhole matrix [px].
        shape: Image (height, width).
        X_base_camera: Camera pose.

    Raises:
        BadViewError: Fewer than half of the points are in the image.
    """
    import cv2

    X_CB = np.linalg.inv(X_base_camera)
    p = points @ X_CB[:3, :3].T + X_CB[:3, 3]
    z = p[:, 2]
    safe = np.where(z > 1e-3, z, np.inf)
    u = np.rint(K[0, 0] * p[:, 0] / safe + K[0, 2]).astype(np.int64)
    v = np.rint(K[1, 1] * p[:, 1] / safe + K[1, 2]).astype(np.int64)
    inside = (z > 1e-3) & (u >= 0) & (u < shape[1]) & (v >= 0) & (v < shape[0])
    if inside.mean() < 0.5:
        raise BadViewError(
            f"only {100 * inside.mean():.0f} % of the points lie in the camera's image; wrong --frame or --camera?"
        )
    order = np.argsort(-z[inside], kind="stable")  # far first, so that the nearest is written last
    flat = (v[inside] * shape[1] + u[inside])[order]
    depth = np.zeros(shape[0] * shape[1], dtype=np.float32)
    depth[flat] = z[inside][order]
    depth = depth.reshape(shape)
    closed = cv2.medianBlur(depth, 3)
    depth = np.where(depth > 0, depth, closed)
    return DepthFrame(depth.astype(np.float32), K, X_base_camera)
