"""Made-up depth views of known objects, to measure perception without a robot.

Objects are boxes. Depth gets the errors of a stereo camera in a simple form: noise that grows with z² and is shared
between neighbouring pixels, near surfaces that are a little too wide, and holes beside them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.frames import DepthFrame, pixel_rays
from s2r_host.perception.motion import JointMotion, rotation, unit

Array = NDArray[np.floating]

_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64) / 2
_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], dtype=np.uint32
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Box:
    """A box with its pose (4, 4) in the base frame and its edge lengths [m]."""

    X_base_box: Array
    size: Array


@dataclass(frozen=True, eq=False)
class Pair:
    """A before/after pair with the motion that lies between."""

    before: DepthFrame
    after: DepthFrame
    motion: JointMotion
    part_before: NDArray[np.bool_]


def look_at(p_camera: Array, p_target: Array) -> Array:
    """Pose (4, 4) of an OpenCV camera at ``p_camera`` that looks at ``p_target`` with its x axis level."""
    z = unit(p_target - p_camera)
    x = unit(np.cross(z, [0, 0, 1.0]))
    X = np.eye(4)
    X[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    X[:3, 3] = p_camera
    return X


def render(
    boxes: list[Box], K: Array, shape: tuple[int, int], X_base_camera: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Exact depth [m] (h, w), 0 = nothing hit, and the index of the box hit (-1 = none)."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    for box in boxes:
        corners = (_CORNERS * box.size) @ box.X_base_box[:3, :3].T + box.X_base_box[:3, 3]
        scene.add_triangles(
            o3d.core.Tensor.from_numpy(corners.astype(np.float32)), o3d.core.Tensor.from_numpy(_FACES)
        )
    v, u = np.mgrid[: shape[0], : shape[1]]
    ray_C = pixel_rays(K, u, v)
    direction = ray_C @ X_base_camera[:3, :3].T
    origin = np.broadcast_to(X_base_camera[:3, 3], direction.shape)
    rays = np.concatenate([origin, direction], axis=-1).astype(np.float32)
    hit = scene.cast_rays(o3d.core.Tensor.from_numpy(rays), nthreads=1)
    depth = hit["t_hit"].numpy().astype(np.float64)  # rays have z = 1 in the camera, so t is depth
    which = hit["geometry_ids"].numpy().astype(np.int64)
    missed = ~np.isfinite(depth)
    depth[missed], which[missed] = 0.0, -1
    return depth, which


def stereo_like(depth: Array, rng: np.random.Generator, sigma_at_1m: float = 0.0016) -> NDArray[np.float32]:
    """Depth with noise ~ z² (half of it shared by 7 px neighbourhoods), 2 px fattening and ragged holes."""
    near = np.where(depth > 0, depth, 100.0)  # nothing hit counts as far away
    fat = cv2.erode(near, np.ones((3, 5), np.uint8))
    jump = (fat < 100.0) & (near - fat > 0.03)
    # Half of the rim becomes too wide foreground, half of it a hole.
    blob = cv2.GaussianBlur(rng.standard_normal(depth.shape), (0, 0), 3.0)
    result = np.where(jump & (blob > 0), fat, depth)
    result = np.where(jump & (blob <= 0), 0.0, result)
    shared = cv2.GaussianBlur(rng.standard_normal(depth.shape), (0, 0), 2.0)
    shared /= shared.std()
    white = rng.standard_normal(depth.shape)
    noise = sigma_at_1m * result**2 * (0.7 * shared + 0.7 * white)
    return np.where(result > 0, result + noise, 0.0).astype(np.float32)


def pair(
    static: list[Box], part: list[Box], motion: JointMotion, K: Array, shape: tuple[int, int],
    X_base_camera: Array, rng: np.random.Generator, sigma_at_1m: float = 0.0016,
) -> Pair:  # fmt: skip
    """Render a part before and after its motion among static boxes."""
    X = motion.transform()
    exact, which = render(static + part, K, shape, X_base_camera)
    carried = [Box(X @ box.X_base_box, box.size) for box in part]
    exact_after, _ = render(static + carried, K, shape, X_base_camera)
    return Pair(
        DepthFrame(stereo_like(exact, rng, sigma_at_1m), K, X_base_camera),
        DepthFrame(stereo_like(exact_after, rng, sigma_at_1m), K, X_base_camera),
        motion,
        which >= len(static),
    )


def drawer_pair(rng: np.random.Generator, push_m: float | None = None, sigma_at_1m: float = 0.0016) -> Pair:
    """A cabinet with one partly open drawer and a bar handle on a table, pushed inwards by 3-6 cm."""
    w, h, d = rng.uniform(0.28, 0.40), rng.uniform(0.2, 0.29), rng.uniform(0.34, 0.44)
    front_h, front_t, wall = rng.uniform(0.12, 0.17), rng.uniform(0.014, 0.022), 0.012
    opening, gap, bar = rng.uniform(0.05, 0.1), rng.uniform(0.03, 0.045), rng.uniform(0.009, 0.016)
    bar_w, drop = rng.uniform(0.08, 0.16), rng.uniform(0.035, 0.06)
    X_WO = np.eye(4)
    X_WO[:3, :3] = rotation(np.array([0, 0, 1.0]), np.pi + rng.uniform(-0.17, 0.17))
    X_WO[:3, 3] = [rng.uniform(0.62, 0.72), rng.uniform(-0.06, 0.06), 0.0]
    static = [
        *_table(),
        _span(X_WO, (-d, w / 2 - wall, 0), (0, w / 2, h)),
        _span(X_WO, (-d, -w / 2, 0), (0, -w / 2 + wall, h)),
        _span(X_WO, (-d, -w / 2, h - wall), (0, w / 2, h)),
        _span(X_WO, (-d, -w / 2, 0), (-d + wall, w / 2, h)),
        _span(X_WO, (-d, -w / 2, 0), (0, w / 2, h - front_h - wall)),
    ]
    s, z0, z1 = opening, h - front_h, h
    zh = z1 - drop
    side = 0.02
    part = [
        _span(X_WO, (s, -w / 2, z0), (s + front_t, w / 2, z1)),
        _span(X_WO, (s - d * 0.85, -w / 2 + side, z0 + 0.012), (s, -w / 2 + side + 0.01, z1 - 0.03)),
        _span(X_WO, (s - d * 0.85, w / 2 - side - 0.01, z0 + 0.012), (s, w / 2 - side, z1 - 0.03)),
        _span(X_WO, (s - d * 0.85, -w / 2 + side, z0 + 0.012), (s, w / 2 - side, z0 + 0.02)),
        _span(
            X_WO,
            (s + front_t + gap, -bar_w / 2, zh - bar / 2),
            (s + front_t + gap + bar, bar_w / 2, zh + bar / 2),
        ),
    ]
    for y in (-bar_w / 2 + bar / 2, bar_w / 2 - bar / 2):
        part.append(
            _span(
                X_WO, (s + front_t, y - bar / 2, zh - bar / 2), (s + front_t + gap, y + bar / 2, zh + bar / 2)
            )
        )
    push = rng.uniform(0.03, 0.045) if push_m is None else push_m
    motion = JointMotion("prismatic", X_WO[:3, 3].copy(), -X_WO[:3, 0], push)
    K, shape, X = _d415(rng, np.array([0.66, 0.0, 0.12]), facing=np.pi)
    return pair(static, part, motion, K, shape, X, rng, sigma_at_1m)


def laptop_pair(rng: np.random.Generator, turn_rad: float | None = None, sigma_at_1m: float = 0.0016) -> Pair:
    """A laptop on a table whose lid turns by 13-35 degrees, closing or opening."""
    w, d, t_base, t_lid = rng.uniform(0.3, 0.36), rng.uniform(0.21, 0.25), 0.018, 0.008
    X_WO = np.eye(4)
    X_WO[:3, :3] = rotation(np.array([0, 0, 1.0]), np.pi + rng.uniform(-0.5, 0.5))
    X_WO[:3, 3] = [rng.uniform(0.6, 0.75), rng.uniform(-0.08, 0.08), 0.0]
    static = [*_table(), _span(X_WO, (0, -w / 2, 0), (d, w / 2, t_base))]
    hinge_O = np.array([0.0, 0.0, t_base + 0.003])
    lid = _span(np.eye(4), (0, -w / 2, 0), (d, w / 2, t_lid))
    open_rad = rng.uniform(np.radians(65), np.radians(115))
    axis_O = np.array([0, -1.0, 0])
    X_hinge = np.eye(4)
    X_hinge[:3, :3], X_hinge[:3, 3] = rotation(axis_O, open_rad), hinge_O
    part = [Box(X_WO @ X_hinge @ lid.X_base_box, lid.size)]
    turn = rng.uniform(np.radians(13), np.radians(35)) if turn_rad is None else turn_rad
    sign = rng.choice([-1.0, 1.0]) if open_rad < np.radians(100) else -1.0
    motion = JointMotion(
        "revolute", (X_WO @ np.append(hinge_O, 1))[:3], sign * (X_WO[:3, :3] @ axis_O), float(turn)
    )
    K, shape, X = _d415(rng, np.array([0.68, 0.0, 0.1]), facing=np.pi)
    return pair(static, part, motion, K, shape, X, rng, sigma_at_1m)


@dataclass(frozen=True, eq=False)
class FaucetView:
    """One view of a column with a spout towards the robot and a lever on top.

    Attributes:
        frame: The view.
        p_root, p_tip: Ends of the lever, base frame [m], (3,).
    """

    frame: DepthFrame
    p_root: Array
    p_tip: Array


def faucet_view(rng: np.random.Generator, yaw_rad: float, lever_m: float = 0.12) -> FaucetView:
    """A faucet 0.6 m before the robot; ``yaw_rad`` turns its lever from above the spout to the robot's left."""
    foot, height_m = np.array([0.6, 0.0, 0.0]), 0.16
    up = np.array([0.0, 0.0, 1.0])
    out = rotation(up, yaw_rad) @ np.array([-1.0, 0.0, 0.0])
    head, low = foot + (height_m + 0.03) * up, foot + 0.6 * height_m * up
    middle, end = np.add(low, (-0.10, 0.0, 0.03)), np.add(low, (-0.15, 0.0, 0.01))
    tip = head + lever_m * out + 0.02 * up
    static = [
        *_table(),
        beam(foot, head, 0.04, 0.04),
        beam(low, middle, 0.022, 0.022),
        beam(middle, end, 0.022, 0.022),
        beam(head, tip, 0.022, 0.012),
    ]
    K, shape = np.array([[600.0, 0, 320], [0, 600.0, 180], [0, 0, 1]]), (360, 640)
    X = look_at(np.array((0.0, -0.45, 0.55)), foot + 0.1 * up)
    still = JointMotion("revolute", foot, up, 0.0)
    return FaucetView(pair(static, [], still, K, shape, X, rng).before, head, tip)


@dataclass(frozen=True, eq=False)
class LeverLook:
    """A look in colour at a lever on a table that turns about an upright hinge at its end.

    Attributes:
        frame: Its depth smeared over some pixels, as a stereo matcher does it.
        part: Pixels of the lever, (h, w).
    """

    frame: DepthFrame
    part: NDArray[np.bool_]


LEVER_HINGE = np.array([0.6, 0.0, 0.1])  # [m]
LEVER_HALF_M = np.array([0.04, 0.007, 0.007])
LEVER_COLOURS = np.array(
    [[90, 90, 90], [150, 150, 140], [200, 190, 180], [60, 70, 90]], np.uint8
)  # xyz, table


def lever_look(turn_rad: float, half_m: Array = LEVER_HALF_M, p_camera: Array | None = None) -> LeverLook:
    """The look with the lever turned by so much from x.

    Args:
        turn_rad: The turn.
        half_m: Half its edges, (3,).
        p_camera: Where it is seen from, (3,); None for the usual place.
    """
    K, shape = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]]), (480, 640)
    X = look_at(np.array([0.0, -0.5, 0.6]) if p_camera is None else p_camera, LEVER_HINGE)
    v, u = np.mgrid[: shape[0], : shape[1]]
    rays = pixel_rays(K, u, v)
    R = rotation(np.array([0.0, 0.0, 1.0]), turn_rad)
    middle = LEVER_HINGE + half_m[0] * R[:, 0]
    way = rays @ X[:3, :3].T
    near, far = ((side * half_m - (X[:3, 3] - middle) @ R) / (way @ R) for side in (-1.0, 1.0))
    near, far = np.minimum(near, far), np.maximum(near, far)
    face, enters = near.argmax(axis=-1), near.max(axis=-1)
    part = enters < far.min(axis=-1)
    table = (0.06 - X[2, 3]) / way[..., 2]
    depth = cv2.blur(np.where(part, enters, table).astype(np.float32), (9, 5))
    return LeverLook(DepthFrame(depth, K, X, LEVER_COLOURS[np.where(part, face, 3)]), part)


def beam(start: Array, end: Array, width_m: float, thick_m: float) -> Box:
    """A bar between two points, its width level."""
    x = (end - start) / np.linalg.norm(end - start)
    y = np.cross([0.0, 0.0, 1.0], x)
    y = y / np.linalg.norm(y) if np.linalg.norm(y) > 1e-6 else np.array([0.0, 1.0, 0.0])
    X = np.eye(4)
    X[:3, :3] = np.column_stack([x, y, np.cross(x, y)])
    X[:3, 3] = (start + end) / 2
    return Box(X, np.array([np.linalg.norm(end - start), width_m, thick_m]))


def _table() -> list[Box]:
    return [_span(np.eye(4), (0.1, -0.8, -0.03), (1.4, 0.8, 0.0))]


def _span(X: Array, low: tuple[float, float, float], high: tuple[float, float, float]) -> Box:
    """The box between two corners given in the frame X."""
    a, b = np.array(low, dtype=np.float64), np.array(high, dtype=np.float64)
    X_box = X.copy()
    X_box[:3, 3] = X[:3, :3] @ (0.5 * (a + b)) + X[:3, 3]
    return Box(X_box, b - a)


def _d415(rng: np.random.Generator, p_target: Array, facing: float) -> tuple[Array, tuple[int, int], Array]:
    """A camera like a D415 at 640x360, 0.65-0.95 m away, up to 50 degrees to the side, 20-45 degrees above."""
    azimuth = facing + rng.uniform(-np.radians(50), np.radians(50))
    elevation = rng.uniform(np.radians(20), np.radians(45))
    distance = rng.uniform(0.65, 0.95)
    offset = distance * np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    K = np.array([[460.0, 0, 320], [0, 460.0, 180], [0, 0, 1]])  # 1280x720 at f 920, halved
    return K, (360, 640), look_at(p_target + offset, p_target)
