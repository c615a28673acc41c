"""Pictures of the views: what the camera saw with the moved part marked, and the clouds with the estimated axis."""

from __future__ import annotations

from collections.abc import Callable

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from s2r_host.motion.robot_mask import back_project
from s2r_host.motion.scene import Region
from s2r_host.perception.frames import project
from s2r_host.report.style import ARM, AXIS, PART, RC, REST
from s2r_host.run.belief import Belief
from s2r_host.run.observe import Observation

MOST_POINTS = 60_000
Projection = Callable[[np.ndarray], np.ndarray]
"""Points (n, 3) in the base frame to picture coordinates (n, 2) or, with depth, (n, 3)."""
LIGHT = np.array([-0.5, -0.45, 0.74])


def views_figure(before: Observation, after: Observation, belief: Belief | None) -> Figure:
    """Two rows: the camera's pictures and the clouds from a side; left and right the views that told the joint."""
    with mpl.rc_context(RC):
        figure = Figure(figsize=(12.5, 7.0), layout="constrained")
        grid = figure.subplots(2, 2, height_ratios=[1.0, 0.85])
        for column, view in enumerate((before, after)):
            part = None
            if belief is not None:
                estimate = belief.estimate
                part = estimate.moved_mask_before if column == 0 else estimate.moved_mask_after
            _picture(grid[0, column], view, part, belief)
            _cloud(grid[1, column], view, part, belief)
        return figure


def single_view_figure(view: Observation) -> Figure:
    """One view, for runs that ended early."""
    with mpl.rc_context(RC):
        figure = Figure(figsize=(12.5, 4.4), layout="constrained")
        left, right = figure.subplots(1, 2)
        _picture(left, view, None, None)
        _cloud(right, view, None, None)
        return figure


def _picture(axes: Axes, view: Observation, part: np.ndarray | None, belief: Belief | None) -> None:
    frame = view.capture.frame
    depth = np.where(frame.depth_m > 0, frame.depth_m, np.nan)
    if frame.colour is not None:
        image = np.asarray(frame.colour, float) / 255.0
    else:
        low, high = np.nanpercentile(depth, [2, 98])
        grey = np.clip(1.0 - 0.8 * (depth - low) / (high - low), 0.05, 1.0)
        image = np.repeat(np.nan_to_num(grey, nan=0.0)[..., None], 3, axis=2)
    image = _tint(image, view.arm_mask, ARM, 0.45)
    if part is not None and part.shape == image.shape[:2]:
        image = _tint(image, part, PART, 0.45)
    axes.imshow(image, interpolation="nearest")
    axes.set_title(
        f"view {view.name}: what the camera saw" + (" (moved part tinted)" if part is not None else "")
    )
    axes.set_axis_off()
    if belief is not None:
        _draw_axis(axes, lambda p: project(p, frame.K, frame.X_base_camera)[0], belief, image.shape[:2])


def _cloud(axes: Axes, view: Observation, part: np.ndarray | None, belief: Belief | None) -> None:
    points = back_project(view.capture.frame)
    middle = np.median(view.scene.p_base, axis=0)
    region = Region((middle[0] - 0.42, middle[0] + 0.35), (middle[1] - 0.36, middle[1] + 0.36), (-0.02, 0.9))
    keep = region.contains(points) & ~view.arm_mask
    colour = np.broadcast_to(to_rgb(REST), (*keep.shape, 3)).copy()
    if part is not None and part.shape == keep.shape:
        colour[part] = to_rgb(PART)
    shade = _shading(points)
    colour = np.clip(colour * shade[..., None], 0.0, 1.0)
    p, rgb = points[keep], colour[keep]
    stride = max(1, len(p) // MOST_POINTS)
    p, rgb = p[::stride], rgb[::stride]
    project = _oblique(np.array([-0.62, -0.60, 0.50]))
    flat = project(p)
    order = np.argsort(flat[:, 2])
    axes.scatter(
        flat[order, 0], flat[order, 1], s=1.2, c=rgb[order], marker="s", linewidths=0, rasterized=True
    )
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(f"view {view.name}: the cloud from the side" + (", estimated axis" if belief else ""))
    if belief is not None:
        _draw_axis(axes, project, belief, None)


def _draw_axis(axes: Axes, project: Projection, belief: Belief, shape: tuple[int, int] | None) -> None:
    """The axis with an arrow towards + (of a hinge: turning by the right-hand rule), beside the part."""
    origin, direction = belief.estimate.axis_origin_m, belief.axis
    slides = belief.template.slides
    if not slides:  # any point of the line may be the origin: draw the piece that is beside the part
        origin = origin + ((belief.template.p.mean(axis=0) - origin) @ direction) * direction
    line = project(np.array([origin - (0.10 if slides else 0.24) * direction, origin + 0.24 * direction]))
    (x0, y0), (x1, y1) = line[:, :2].tolist()
    arrow = {"arrowstyle": "-|>", "color": AXIS, "lw": 2.2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=(x1, y1), xytext=(x0, y0), arrowprops=arrow)
    halo = [withStroke(linewidth=3, foreground="white")]
    place = {"xytext": (-4, -8), "textcoords": "offset points", "ha": "right", "va": "top"}
    axes.annotate(
        "+ out" if slides else "+",
        (x1, y1),
        color=AXIS,
        fontsize=10,
        fontweight="bold",
        path_effects=halo,
        **place,
    )
    if shape is not None:
        axes.set_xlim(0, shape[1])
        axes.set_ylim(shape[0], 0)


def _oblique(eye: np.ndarray) -> Projection:
    """Parallel projection to (right, up, towards the eye)."""
    towards = eye / np.linalg.norm(eye)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    basis = np.stack([right, np.cross(towards, right), towards], axis=1)
    return lambda p: np.asarray(p) @ basis


def _shading(points: np.ndarray) -> np.ndarray:
    """Brightness from the surface normal, shape (h, w); differences over a few pixels smooth the noise."""
    k = 4
    du = np.full_like(points, np.nan)
    dv = np.full_like(points, np.nan)
    du[:, k:-k] = points[:, 2 * k :] - points[:, : -2 * k]
    dv[k:-k] = points[2 * k :] - points[: -2 * k]
    normal = np.cross(dv, du)
    length = np.linalg.norm(normal, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        lit = np.abs(normal @ (LIGHT / np.linalg.norm(LIGHT))) / length
    return 0.55 + 0.6 * np.nan_to_num(lit, nan=0.4)


def _tint(image: np.ndarray, mask: np.ndarray, colour: str, share: float) -> np.ndarray:
    tinted = image.copy()
    tinted[mask] = (1.0 - share) * tinted[mask] + share * np.array(to_rgb(colour))
    return tinted
