"""A strip of pictures of a motion in the fine model, drawn by ray casting: no graphics library is needed."""

from __future__ import annotations

from pathlib import Path

import cv2
import mujoco
import numpy as np

from s2r_host.planning.execution import FineWorld
from s2r_host.planning.scene import GeomKind, Scene
from s2r_host.trajectory.trajectory import Trajectory
from s2r_host.trajectory.verify import Replay

_WIDTH, _HEIGHT, _FOV_RAD = 300, 260, 0.75
_LIGHT = np.array([0.35, 0.45, 0.82])
_PART, _FINGER = np.array([0.93, 0.55, 0.20]), np.array([0.15, 0.35, 0.80])
_SKY = np.array([0.93, 0.95, 0.97])
_FRAMES = 6
_TITLE_PX, _GAP_PX, _TEXT_PX = 24, 8, 10


def save_picture_strip(
    path: Path,
    scene: Scene,
    trajectory: Trajectory,
    played: Replay,
    q_initial: np.ndarray,
    s_initial: float,
    begins_s: tuple[float, ...] = (0.0,),
) -> Path:
    """Write a PNG of the start, moments on the way and the end; the moving part is orange, the fingertip blue.

    Every leg has a row of its own; ``begins_s`` are the times at which they begin.
    """
    world = FineWorld(scene, q_initial, s_initial)
    model = _visible(scene)
    strip = np.full(
        (len(begins_s) * (_TITLE_PX + _HEIGHT), _FRAMES * (_WIDTH + _GAP_PX) - _GAP_PX, 3), 255, np.uint8
    )
    origin, vectors = _camera(scene, world.data, played)
    ends_s = (*begins_s[1:], np.inf)
    for leg, (begin_s, end_s) in enumerate(zip(begins_s, ends_s, strict=True)):
        for k, t in enumerate(_moments(played, begin_s, end_s)):
            row = int(np.argmin(np.abs(played.t - t)))
            world.data.qpos[: scene.dof] = played.q_meas[row]
            world.data.qpos[scene.s_qpos] = played.s[row]
            mujoco.mj_kinematics(scene.fine, world.data)
            unit = "m" if scene.prismatic else "rad"
            held = "" if t <= trajectory.duration_s else " (held)"
            which = f"leg {leg + 1}: " if len(begins_s) > 1 else ""
            title = f"{which}t = {t:.2f} s{held},  s = {played.s[row]:+.3f} {unit}"
            frame = strip[leg * (_TITLE_PX + _HEIGHT) :, k * (_WIDTH + _GAP_PX) :][
                : _TITLE_PX + _HEIGHT, :_WIDTH
            ]
            frame[_TITLE_PX:] = np.round(255.0 * _shaded(scene, model, world.data, origin, vectors))
            _write_title(frame, title)
    path.write_bytes(cv2.imencode(".png", strip[..., ::-1])[1].tobytes())  # OpenCV's colours are blue first
    return path


def _write_title(frame: np.ndarray, title: str) -> None:
    """Write a line of black text above a picture, centred."""
    font, thickness = cv2.FONT_HERSHEY_SIMPLEX, 1
    scale = cv2.getFontScaleFromHeight(font, _TEXT_PX, thickness)
    (width, _), _ = cv2.getTextSize(title, font, scale, thickness)
    scale *= min(1.0, frame.shape[1] / width)
    left = max(0, (frame.shape[1] - min(width, frame.shape[1])) // 2)
    drawn = np.ascontiguousarray(frame[:_TITLE_PX])
    cv2.putText(drawn, title, (left, _TITLE_PX - 8), font, scale, (0, 0, 0), thickness, cv2.LINE_AA)
    frame[:_TITLE_PX] = drawn


def _moments(played: Replay, begin_s: float, end_s: float) -> np.ndarray:
    """Start of a leg, the part's first motion in it, moments to the end of that, and its end, the hold included."""
    inside = (played.t >= begin_s) & (played.t <= end_s)
    t, s = played.t[inside], played.s[inside]
    moving = np.abs(s - s[0]) > 0.02 * max(np.abs(s - s[0]).max(), 1e-9)
    touch = t[int(np.argmax(moving))] if moving.any() else (t[0] + t[-1]) / 2.0
    return np.array([t[0], t[0] + 0.6 * (touch - t[0]), *np.linspace(touch, t[-1], _FRAMES - 2)])


def _visible(scene: Scene) -> mujoco.MjModel:
    """A model whose geom group 0 holds what is drawn: what is solid and what the file shows."""
    import copy

    model = copy.copy(scene.fine)
    shown = scene.solid | (scene.geom_kind >= GeomKind.ROBOT) | (model.geom_group < 3)
    model.geom_group[:] = np.where(shown & (model.geom_rgba[:, 3] > 0.0), 0, 5)
    return model


def _camera(scene: Scene, data: mujoco.MjData, played: Replay) -> tuple[np.ndarray, np.ndarray]:
    """Eye (3,) and ray directions (pixels, 3) that see the part and the hand from the side."""
    part = np.flatnonzero((scene.geom_kind == GeomKind.PART) & scene.solid)
    centre = data.geom_xpos[part].mean(axis=0) if len(part) else data.xpos[scene.part_body]
    up = (
        -scene.gravity / max(np.linalg.norm(scene.gravity), 1e-9)
        if scene.gravity.any()
        else np.array([0, 0, 1.0])
    )
    out = centre - (centre @ up) * up
    out /= max(np.linalg.norm(out), 1e-9)
    side = np.cross(up, out)
    look_at = centre - 0.18 * out + 0.05 * up
    origin = look_at + 1.15 * side * (-1.0 if played.q_meas[0, 0] > 0 else 1.0) - 0.45 * out + 0.65 * up
    ahead = look_at - origin
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    span = np.tan(_FOV_RAD / 2.0)
    x = np.linspace(-span, span, _WIDTH)
    y = np.linspace(-span, span, _HEIGHT) * _HEIGHT / _WIDTH
    rays = ahead + x[None, :, None] * right + y[:, None, None] * down
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    return origin, np.ascontiguousarray(rays.reshape(-1, 3))


def _shaded(
    scene: Scene, model: mujoco.MjModel, data: mujoco.MjData, origin: np.ndarray, vectors: np.ndarray
) -> np.ndarray:
    """Picture (h, w, 3) of colours by geom, darker where a surface turns away from the light."""
    count = len(vectors)
    geom, distance, normal = np.empty(count, np.int32), np.empty(count), np.empty((count, 3))
    groups = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
    mujoco.mj_multiRay(
        model,
        data,
        origin,
        vectors.ravel(),
        groups,
        True,
        -1,
        geom,
        distance,
        normal.reshape(-1),
        count,
        20.0,
    )
    colours = model.geom_rgba[:, :3].copy()
    colours[scene.geom_kind == GeomKind.PART] = (
        0.35 * colours[scene.geom_kind == GeomKind.PART] + 0.65 * _PART
    )
    colours[scene.geom_kind == GeomKind.FINGER] = _FINGER
    hit = geom >= 0
    light = 0.55 + 0.45 * np.clip(normal @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
    picture = np.tile(_SKY, (count, 1))
    picture[hit] = colours[geom[hit]] * light[hit, None]
    return np.clip(picture.reshape(_HEIGHT, _WIDTH, 3), 0.0, 1.0)
