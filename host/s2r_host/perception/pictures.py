"""Pictures of an estimate: both views coloured by part, with the estimated axis drawn in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.frames import project
from s2r_host.perception.view import DepthView, View

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

PART_RGB = np.array([0.88, 0.36, 0.10])
AXIS_RGB = "#1f5fd0"
MOST_POINTS = 25_000


def save_pictures(estimate: JointEstimate, folder: Path | str) -> list[Path]:
    """Write ``view_before.png``, ``view_after.png`` and ``cloud.png``; returns their paths."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in (
        ("view_before.png", view_figure(estimate, after=False)),
        ("view_after.png", view_figure(estimate, after=True)),
        ("cloud.png", cloud_figure(estimate)),
    ):
        figure.savefig(folder / name, dpi=110)
        paths.append(folder / name)
    return paths


def view_figure(estimate: JointEstimate, after: bool) -> Figure:
    """One view as the camera saw it (a depth image with part and axis), or the cloud from the side."""
    view = estimate.view_after if after else estimate.view_before
    mask = estimate.parts.after if after else estimate.parts.before
    title = f"{'after' if after else 'before'}: {_sentence(estimate)}"
    figure = Figure(figsize=(7.2, 5.6), layout="constrained")
    axes = figure.add_subplot()
    if isinstance(view, DepthView):
        axes.imshow(_shaded(view, mask))
        _axis_in_image(axes, estimate, view)
        axes.set_axis_off()
    else:
        _side_view(axes, view.points, mask, estimate)
    axes.set_title(title, fontsize=9)
    return figure


def cloud_figure(estimate: JointEstimate) -> Figure:
    """Both clouds around the part from above and from the side, part before and after, axis as a line."""
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    panels = [figure.add_subplot(1, 2, k + 1) for k in range(2)]
    for k, (axes, (i, j)) in enumerate(zip(panels, ((0, 1), (0, 2)), strict=True)):
        box = _box(estimate)
        for view, mask, colour, label in (
            (estimate.view_before, estimate.parts.before, PART_RGB, "part before"),
            (estimate.view_after, estimate.parts.after, np.array([0.12, 0.55, 0.30]), "part after"),
        ):
            inside = ((view.points > box[0]) & (view.points < box[1])).all(axis=1)
            rest = np.flatnonzero(inside & ~mask)[:: max(1, int(inside.sum()) // MOST_POINTS)]
            own = np.flatnonzero(mask)[:: max(1, int(mask.sum()) // MOST_POINTS)]
            axes.plot(*view.points[rest][:, [i, j]].T, ",", color="0.75", zorder=1)
            axes.plot(*view.points[own][:, [i, j]].T, ".", ms=1.2, color=colour, label=label, zorder=2)
        a, b = _axis_ends(estimate)
        axes.annotate(
            "",
            tuple(b[[i, j]]),
            tuple(a[[i, j]]),
            arrowprops={"arrowstyle": "-|>", "color": AXIS_RGB, "lw": 2.2},
            zorder=4,
        )
        axes.plot(*estimate.axis_origin_m[[i, j]], "o", color=AXIS_RGB, ms=5, zorder=4, label="axis")
        axes.set_aspect("equal")
        axes.set_xlabel("xyz"[i] + " [m]")
        axes.set_ylabel("xyz"[j] + " [m]")
        axes.set_title("from above" if k == 0 else "from the side", fontsize=9)
    legend = panels[1].legend(fontsize=8, loc="best")
    for handle in legend.legend_handles:
        if isinstance(handle, Line2D):
            handle.set_markersize(6)
    figure.suptitle(_sentence(estimate), fontsize=10)
    return figure


def _sentence(estimate: JointEstimate) -> str:
    iv = estimate.intervals90
    if estimate.unit == "rad":
        amount = f"{np.degrees(estimate.delta):.1f}° ± {np.degrees(iv.delta[1] - iv.delta[0]) / 2:.1f}°"
    else:
        amount = f"{estimate.delta * 1e3:.1f} mm ± {(iv.delta[1] - iv.delta[0]) * 500:.1f} mm"
    return (
        f"{estimate.joint_type}, {amount}, axis ± {np.degrees(iv.axis_angle_rad):.1f}° (90 %),"
        f" residual {estimate.residual_m * 1e3:.1f} mm"
    )


def _shaded(view: DepthView, mask: Mask) -> Array:
    """Image lit from the camera: grey for the rest, orange for the part, black for no return."""
    light = np.abs(np.einsum("ni,ni->n", view.normals, _rays(view)))
    light = np.where(view.normal_ok, 0.35 + 0.65 * light, 0.45)
    colour = light[:, None] * np.ones(3)
    if view.colour is not None:
        colour = 0.25 * colour + 0.75 * view.colour.reshape(-1, 3)[view.flat] / 255.0
    colour[mask] = 0.35 * colour[mask] + 0.65 * light[mask, None] * PART_RGB
    image = np.zeros((view.shape[0] * view.shape[1], 3))
    image[view.flat] = colour
    return np.clip(image.reshape(*view.shape, 3), 0, 1)


def _rays(view: DepthView) -> Array:
    ray = view.points - view.X_base_camera[:3, 3]
    return ray / np.linalg.norm(ray, axis=1, keepdims=True)


def _axis_ends(estimate: JointEstimate) -> tuple[Array, Array]:
    """Ends of the drawn axis: as long as the part for a hinge, an arrow from the part's middle for a slide."""
    points = estimate.view_before.points[estimate.parts.before]
    sense = estimate.axis_direction * (1.0 if estimate.delta >= 0 else -1.0)
    if len(points) == 0:
        return estimate.axis_origin_m, estimate.axis_origin_m + 0.1 * sense
    along = (points - estimate.axis_origin_m) @ sense
    if estimate.joint_type == "prismatic":
        return estimate.axis_origin_m, estimate.axis_origin_m + max(0.08, abs(estimate.delta)) * sense
    low, high = np.percentile(along, [1, 99])
    return estimate.axis_origin_m + low * sense, estimate.axis_origin_m + high * sense


def _axis_in_image(axes: Axes, estimate: JointEstimate, view: DepthView) -> None:
    uv, z = project(np.stack(_axis_ends(estimate)), view.K, view.X_base_camera)
    if (z < 0.05).any():
        return
    axes.annotate(
        "",
        uv[1],
        uv[0],
        arrowprops={"arrowstyle": "-|>", "color": AXIS_RGB, "lw": 2.5},
        annotation_clip=False,
    )


def _side_view(axes: Axes, points: Array, mask: Mask, estimate: JointEstimate) -> None:
    low, high = _box(estimate)
    inside = ((points > low) & (points < high)).all(axis=1)
    axes.plot(*points[inside & ~mask][:, [1, 2]].T, ",", color="0.7")
    axes.plot(*points[mask][:, [1, 2]].T, ".", ms=1.2, color=PART_RGB)
    a, b = _axis_ends(estimate)
    axes.annotate(
        "", tuple(b[[1, 2]]), tuple(a[[1, 2]]), arrowprops={"arrowstyle": "-|>", "color": AXIS_RGB, "lw": 2.5}
    )
    axes.set_aspect("equal")
    axes.set_xlabel("y [m]")
    axes.set_ylabel("z [m]")


def _box(estimate: JointEstimate, margin: float = 0.15) -> tuple[Array, Array]:
    views: list[tuple[View, Mask]] = [
        (estimate.view_before, estimate.parts.before), (estimate.view_after, estimate.parts.after)
    ]  # fmt: skip
    points = np.concatenate([view.points[mask] for view, mask in views])
    return points.min(axis=0) - margin, points.max(axis=0) + margin
