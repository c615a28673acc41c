"""Twin beside recording: the model's pose at moments of the held-out motion, drawn by ray casting (no GL needed)."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from matplotlib.figure import Figure

from s2r_host.gap.output.drawing import TEXT_PT, WIDTH_IN
from s2r_host.gap.output.link_shapes import visible_model
from s2r_host.gap.pipeline import Analysis
from s2r_host.gap.simulation.forward import Errors, Trace, first_held

MOMENTS = 3
WIDTH_PX, HEIGHT_PX = 240, 200
FOV_RAD, MARGIN = 0.4, 1.06  # of the picture's height; distance over the one at which everything is just seen
SEEN = 0.08  # of the machine: a smaller difference of poses is drawn larger
FARTHEST = 2.0  # times where it moves: a larger one is drawn smaller
STEPS = (1, 2, 5)  # factors are these times a power of ten
VIEWS = 16  # directions tried around the vertical
HEIGHTS = (0.35, 0.9)  # rad above the horizon
SKY, OUTLINE, LINK, MOVED = (0.95, 0.96, 0.98), (0.82, 0.29, 0.36), 0.35, np.array([0.45, 0.55, 0.68])
DARK = 0.45  # brightness of a surface seen edge-on; the light is at the eye


@dataclass(frozen=True)
class Moment:
    """One instant of the held-out motion.

    Attributes:
        t: Time in the recording [s]; ``name`` the recording.
        recorded, before, after: Positions [rad or m], shape (joint,).
    """

    name: str
    t: float
    recorded: np.ndarray
    before: np.ndarray
    after: np.ndarray


def moments(a: Analysis) -> tuple[list[Moment], bool]:
    """Where the nominal model is farthest off in each third of what was held out; in the closed loop, if there is one.

    Distances of joints are measured in their travel. Returns the moments and whether the loop was closed.
    """
    if a.before is None or a.after is None:
        return [], False
    closed = any(t.closed for t in a.before.traces)
    rows = [
        (b.session, slice(b.start + skip, b.start + n), b.q[skip:n], c.q[skip:n])
        for b, c in zip(_held(a, a.before, closed), _held(a, a.after, closed), strict=True)
        if (n := min(len(b.q), len(c.q))) > (skip := _skipped(a, b))
    ]
    if not rows:
        return [], closed
    times = np.concatenate([s.t[r] for s, r, _, _ in rows])
    names = np.concatenate([np.full(len(b), k) for k, (_, _, b, _) in enumerate(rows)])
    recorded, before, after = (
        np.concatenate(x)
        for x in ([s.q[r] for s, r, _, _ in rows], [b for _, _, b, _ in rows], [c for _, _, _, c in rows])
    )
    travel = np.maximum(np.ptp(recorded, axis=0), 1e-9)
    off = np.max(np.abs(before - recorded) / travel, axis=1)
    off[~np.isfinite(before).all(1) | ~np.isfinite(after).all(1)] = -1.0
    found = []
    for part in np.array_split(np.arange(len(off)), MOMENTS):
        if part.size and off[part].max() >= 0.0:
            k = int(part[np.argmax(off[part])])
            s = rows[int(names[k])][0]
            found.append(
                Moment(s.rec.name, float(s.rec.start_s + times[k]), recorded[k], before[k], after[k])
            )
    return found, closed


def _held(a: Analysis, errors: Errors, closed: bool) -> list[Trace]:
    return [t for t in errors.traces if t.closed is closed and (t.held or (closed and not a.hold))]


def _skipped(a: Analysis, trace: Trace) -> int:
    """Rows of a simulated stretch before the first one held out."""
    return 0 if a.hold or not trace.closed else max(0, first_held(trace.session) - trace.start)


class Stage:
    """The model to draw, and the corners of what moves in it."""

    def __init__(self, a: Analysis, recorded: np.ndarray) -> None:
        """``recorded``: the poses that the lengths of links without shapes are taken from, shape (moment, joint)."""
        self.model = visible_model(a.model, recorded)
        self.data = mujoco.MjData(self.model)
        names = [self.model.joint(i).name for i in range(self.model.njnt)]
        self.address = [int(self.model.jnt_qposadr[names.index(j)]) for j in a.model.joints]
        m = self.model
        shown = (m.geom_group == 0) & (m.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE))
        self.moving = np.flatnonzero(shown & (m.body_weldid[m.geom_bodyid] != 0))
        self.standing = np.flatnonzero(shown & (m.body_weldid[m.geom_bodyid] == 0))

    def pose(self, q: np.ndarray) -> None:
        """Put the joints where ``q`` says [rad or m], shape (joint,)."""
        self.data.qpos[self.address] = q
        mujoco.mj_kinematics(self.model, self.data)

    def corners(self, q: np.ndarray) -> np.ndarray:
        """Corners of the boxes around everything that moves [m], shape (corner, 3)."""
        self.pose(q)
        signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
        box = self.model.geom_aabb[self.moving]
        local = box[:, None, :3] + signs * box[:, None, 3:]
        R = self.data.geom_xmat[self.moving].reshape(-1, 3, 3)
        return (np.einsum("gij,gkj->gki", R, local) + self.data.geom_xpos[self.moving][:, None]).reshape(
            -1, 3
        )


def exaggeration(stage: Stage, shown: list[Moment]) -> float:
    """Factor by which differences are drawn larger, so that the largest one before can be seen; 1 where it can.

    Below 1 where a slide ran away farther than the machine is large: nothing else would be seen of it.
    """
    recorded = np.array([stage.corners(m.recorded) for m in shown])
    size = float(np.linalg.norm(np.ptp(recorded, axis=1), axis=1).max())
    reach = float(np.linalg.norm(np.ptp(recorded, axis=(0, 1))))
    off = max(
        float(np.linalg.norm(stage.corners(x) - corners, axis=1).max())
        for m, corners in zip(shown, recorded, strict=True)
        for x in (m.before, m.after)
    )
    if off > FARTHEST * reach:
        return 1.0 / _round_up(off / reach)
    return 1.0 if off <= 0.0 or off > SEEN * size else _round_down(SEEN * size / off)


def _round_down(x: float) -> float:
    """The largest of 1, 2, 5, 10, 20 … up to a million that is no larger."""
    return float(max(step * 10**k for k in range(7) for step in STEPS if step * 10**k <= x))


def _round_up(x: float) -> float:
    return float(min((step * 10**k for k in range(7) for step in STEPS if step * 10**k >= x), default=1e6))


def poses_figure(a: Analysis) -> tuple[Figure, str] | None:
    """Recording, nominal twin and patched twin side by side, a row per moment, and a sentence about it.

    None where nothing was simulated or nothing can be drawn.
    """
    shown, closed = moments(a)
    if not shown:
        return None
    stage = Stage(a, np.array([m.recorded for m in shown]))
    if not stage.moving.size:
        return None
    factor = exaggeration(stage, shown)
    poses = [
        [m.recorded, *(m.recorded + factor * (x - m.recorded) for x in (m.before, m.after))] for m in shown
    ]
    origin, rays = _camera(stage, [q for row in poses for q in row])
    figure = Figure(figsize=(WIDTH_IN, 2.75 * len(shown)), layout="constrained")
    panels = figure.subplots(len(shown), 3, squeeze=False)
    for m, row, drawn in zip(shown, poses, panels, strict=True):
        outline = None
        for axes, q, title in zip(drawn, row, _titles(a, stage, m), strict=True):
            picture, mask = _picture(stage, q, origin, rays)
            if outline is None:
                outline = _edges(mask)
            else:
                picture[outline] = OUTLINE
            axes.imshow(picture, interpolation="nearest")
            axes.set_title(title, fontsize=TEXT_PT)
            axes.set_xticks([])
            axes.set_yticks([])
    return figure, _told(factor, closed)


def _told(factor: float, closed: bool) -> str:
    loop = "with the controller in the loop" if closed else "driven by the recorded effort"
    drawn = "Drawn as they are."
    if factor > 1.0:
        drawn = f"Differences are smaller than can be seen and drawn {factor:.0f} times as large"
    elif factor < 1.0:
        drawn = f"Differences are larger than the machine and drawn {1.0 / factor:.0f} times as small"
    drawn += "; the numbers are the true ones." if factor != 1.0 else ""
    return (
        f"The recorded pose, the twin's before and after, {loop}, where the nominal model is farthest off in each "
        f"third of the held-out motion. The red outline is the recorded pose. {drawn}"
    )


def _titles(a: Analysis, stage: Stage, m: Moment) -> list[str]:
    titles = [f"recorded: {m.name}, t = {m.t:.2f} s"]
    corners = stage.corners(m.recorded)
    for x, when in ((m.before, "before"), (m.after, "after")):
        off = np.abs(x - m.recorded)
        units = [a.model.unit(j) for j in a.model.joints]
        parts = [
            f"{_number(1e3 * max(off[k] for k, u in enumerate(units) if u == unit))} m{unit}"
            for unit in dict.fromkeys(units)
        ]
        way = 1e3 * float(np.linalg.norm(stage.corners(x) - corners, axis=1).max())
        parts += [] if units == ["m"] else [f"{_number(way)} mm"]
        titles.append(f"twin {when}: off by {', '.join(parts)}")
    return titles


def _number(x: float) -> str:
    return f"{x:.3g}" if x < 1000.0 else f"{x:.0f}"


def _camera(stage: Stage, poses: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Eye (3,) and ray directions (pixels, 3): from where the poses differ most on the picture."""
    corners = np.array([stage.corners(q) for q in poses])
    centre = 0.5 * (corners.min((0, 1)) + corners.max((0, 1)))
    up = np.array([0.0, 0.0, 1.0])
    best, score = None, -1.0
    spread = (corners - corners.mean(0)).reshape(-1, 3)
    shape = (corners - centre).reshape(-1, 3)
    for height in HEIGHTS:
        for angle in np.arange(VIEWS) * 2.0 * np.pi / VIEWS - 0.9:
            out = np.array([np.cos(angle) * np.cos(height), np.sin(angle) * np.cos(height), np.sin(height)])
            seen = [
                np.linalg.norm(x - np.outer(x @ out, out)) / (np.linalg.norm(x) + 1e-12)
                for x in (spread, shape)
            ]
            if seen[0] + 0.3 * seen[1] > score + 1e-6:
                best, score = out, float(seen[0] + 0.3 * seen[1])
    assert best is not None
    right = np.cross(-best, up)
    right /= np.linalg.norm(right)
    down = np.cross(-best, right)
    across, along = shape @ right, shape @ down
    centre = centre + 0.5 * (across.min() + across.max()) * right + 0.5 * (along.min() + along.max()) * down
    wide, high = np.tan(0.5 * FOV_RAD) * WIDTH_PX / HEIGHT_PX, np.tan(0.5 * FOV_RAD)
    back = MARGIN * max(0.5 * float(np.ptp(across)) / wide, 0.5 * float(np.ptp(along)) / high)
    origin = centre + best * (back + float((shape @ best).max()) + 1e-9)
    x, y = np.linspace(-wide, wide, WIDTH_PX), np.linspace(-high, high, HEIGHT_PX)
    rays = -best + x[None, :, None] * right + y[:, None, None] * down
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    return origin, np.ascontiguousarray(rays.reshape(-1, 3))


def _picture(
    stage: Stage, q: np.ndarray, origin: np.ndarray, rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Shaded picture (h, w, 3) and mask of what moves (h, w)."""
    stage.pose(q)
    count = len(rays)
    geom, distance, normal = np.empty(count, np.int32), np.empty(count), np.empty((count, 3))
    mujoco.mj_multiRay(
        stage.model, stage.data, origin, rays.ravel(), np.array([1, 0, 0, 0, 0, 0], np.uint8), True, -1,
        geom, distance, normal.reshape(-1), count, 1e3,
    )  # fmt: skip
    m = stage.model
    colours = LINK * m.geom_rgba[:, :3] + (1.0 - LINK) * MOVED
    colours[stage.standing] = LINK * m.geom_rgba[stage.standing, :3] + (1.0 - LINK) * 0.8
    hit = geom >= 0
    light = DARK + (1.0 - DARK) * np.abs(np.sum(normal * rays, axis=1))
    picture = np.tile(np.array(SKY), (count, 1))
    picture[hit] = colours[geom[hit]] * light[hit, None]
    mask = np.isin(geom, stage.moving)
    return np.clip(picture, 0.0, 1.0).reshape(HEIGHT_PX, WIDTH_PX, 3), mask.reshape(HEIGHT_PX, WIDTH_PX)


def _edges(mask: np.ndarray) -> np.ndarray:
    """Border of a mask, on its outside."""
    grown = mask.copy()
    grown[1:] |= mask[:-1]
    grown[:-1] |= mask[1:]
    grown[:, 1:] |= mask[:, :-1]
    grown[:, :-1] |= mask[:, 1:]
    return grown & ~mask
