"""Figures of the report: where the residual lives, the maps that betray its cause, before and after."""

from __future__ import annotations

import html

import numpy as np
from matplotlib.figure import Figure

from s2r_host.gap.motion.quantities import ACCELERATION, LOAD, POSITION, SPEED, TIME, Quantity
from s2r_host.gap.output.drawing import (
    AFTER,
    BEFORE,
    MEASURED,
    MUTED,
    WIDTH_IN,
    binned,
    dots,
    image,
    plain,
)
from s2r_host.gap.output.effect_maps import EffectMap, effect_figure, effect_map
from s2r_host.gap.output.overlays import overlay_figure
from s2r_host.gap.output.poses import poses_figure
from s2r_host.gap.pipeline import Analysis

_BETRAYED = ("parameter_off", "physics_missing", "unknown")  # verdicts by which something is off
COLUMNS = 300  # of the heat map, per recording set
MAPS = (SPEED, POSITION, ACCELERATION, LOAD, TIME)


def figures(a: Analysis) -> str:
    """All figures as HTML."""
    if a.problem is None:
        return ""
    out = [
        "<h2>Residual over joints and time</h2>",
        image(heat_map(a), "residual of each joint over time in noise floors, before and after"),
        *(_effect_parts(a)),
    ]
    side_by_side = poses_figure(a)
    if side_by_side is not None:
        figure, told = side_by_side
        alt = "the model's pose as recorded and as simulated before and after, at moments of the held-out motion"
        out += ["<h2>Twin beside recording</h2>", image(figure, alt), f"<p class=muted>{told}</p>"]
    heading = "Where it shows" if a.verdict in _BETRAYED else "What is left"
    for j in figure_joints(a):
        name = a.model.joints[j]
        maps = image(
            maps_figure(a, j), f"residual effort of {name} over speed, position, acceleration, load and time"
        )
        held = image(
            overlay_figure(a, j),
            f"held-out effort residual of {name}, motion in the closed and in the open loop, before and after",
        )
        out += [f"<h2>{heading}: {html.escape(name)}</h2>", maps]
        out += [f"<h2>Before and after on held-out data: {html.escape(name)}</h2>", held]
    return "\n".join(out)


def _effect_parts(a: Analysis) -> list[str]:
    """The map of every named effect over the quantity that it follows, with a sentence on what it shows."""
    out: list[str] = []
    for e in a.decision.effects if a.decision and a.verdict in _BETRAYED else []:
        found = effect_map(a, e)
        if found is None:
            continue
        name = a.model.joints[found.joint]
        out += [
            f"<h2>What betrays {html.escape(e.name)} on {html.escape(name)}</h2>",
            image(effect_figure(a, found), f"residual effort of {name} over {found.label}, before and after"),
            f"<p class=muted>{_map_told(a, found)}</p>",
        ]
    return out


def _map_told(a: Analysis, m: EffectMap) -> str:
    unit = html.escape(a.model.effort_unit(a.model.joints[m.joint]))
    before, after = (float(np.sqrt(np.mean(x**2))) for x in (m.before, m.after))
    told = (
        f"All recordings, fitted and held out: {before:.3g} {unit} (rms) before, {after:.3g} {unit} after everything "
        "named. The grey band is the noise floor."
    )
    if m.alone is not None:
        told += (
            " On the right what numbers that moved and other names leave, and the fitted effect as a curve."
        )
    return told


def figure_joints(a: Analysis) -> list[int]:
    """Joints of all named effects, most probable first; where none was named the two with the largest shares."""
    assert a.problem is not None
    effects = a.decision.effects if a.decision else []
    named = [a.model.index(e.joint) for e in effects if e.joint in a.model.joints]
    places = [a.model.index(p.joint) for p in a.places if p.joint in a.model.joints][:2]
    found = [j for j in dict.fromkeys(named or places) if j in a.problem.joints]
    return found or a.problem.joints[:1]


def heat_map(a: Analysis) -> Figure:
    """Residual in noise floors, joint by time, recordings one after another; before above, after below."""
    assert a.problem is not None
    assert a.decision is not None
    p = a.problem
    before, total, marks = _heat(a, p.raw)
    after, _, _ = _heat(a, a.decision.solution.unexplained)
    figure = Figure(figsize=(WIDTH_IN, 1.6 + 0.5 * len(p.joints)))
    top = max(4.0, float(np.percentile(before, 98)))
    for k, (values, label) in enumerate(((before, "before"), (after, "after"))):
        axes = figure.add_subplot(2, 1, k + 1)
        shown = axes.imshow(
            values, aspect="auto", cmap="magma_r", vmin=0, vmax=top, extent=(0, total, len(p.joints), 0)
        )
        axes.set_yticks(np.arange(len(p.joints)) + 0.5, [a.model.joints[j] for j in p.joints])
        axes.set_ylabel(label)
        axes.tick_params(labelbottom=k == 1)
        for at, name in marks:
            axes.axvline(at, color=MEASURED, lw=0.8)
            if k == 0:
                axes.annotate(
                    name, (at, 1.04), xycoords=("data", "axes fraction"), fontsize=7, color=MUTED, rotation=25
                )
        figure.colorbar(shown, ax=axes, label="noise floors")
    figure.axes[-2].set_xlabel("time, recordings one after another [s]")
    return figure


def _starts(a: Analysis) -> tuple[dict[int, float], float, list[tuple[float, str]]]:
    """Per recording when it starts where all stand one after another [s], the total, starts with names."""
    assert a.problem is not None
    sessions = list({b.session.index: b.session for b in a.problem.blocks}.values())
    starts = np.cumsum([0.0, *[float(s.t[-1]) for s in sessions]])
    marks = [(float(at), s.rec.name) for at, s in zip(starts, sessions, strict=False)]
    return {s.index: at for (at, _), s in zip(marks, sessions, strict=True)}, float(starts[-1]), marks


def _heat(a: Analysis, rows: np.ndarray) -> tuple[np.ndarray, float, list[tuple[float, str]]]:
    """Largest residual per joint and column of time, total time [s], start and name of each recording."""
    assert a.problem is not None
    p = a.problem
    starts, total, marks = _starts(a)
    fewest = min(b.rows.stop - b.rows.start for b in p.blocks) * len(marks)
    columns = int(np.clip(fewest // 2, 10, COLUMNS))
    made = np.zeros((len(p.joints), columns))
    for b in p.blocks:
        t = starts[b.session.index] + b.session.t[b.picks]
        at = np.clip((t / total * columns).astype(int), 0, columns - 1)
        np.maximum.at(made[p.joints.index(b.joint)], at, np.abs(rows[b.rows]) / p.floor[b.joint])
    return made, total, marks


def maps_figure(a: Analysis, j: int) -> Figure:
    """Residual over speed, position, acceleration, load and time, before (red) and after (teal), by direction."""
    assert a.problem is not None
    assert a.decision is not None
    p = a.problem
    after = a.decision.solution.unexplained
    blocks = [b for b in p.blocks if b.joint == j]
    before, left = (np.concatenate([rows[b.rows] for b in blocks]) for rows in (p.raw, after))
    up = np.concatenate([b.session.v[b.picks, j] > 0 for b in blocks])
    starts, _, _ = _starts(a)
    figure = Figure(figsize=(WIDTH_IN, 5.4), layout="constrained")
    panels = figure.subplots(2, 3, sharey=True).ravel()
    for axes, quantity in zip(panels, MAPS, strict=False):
        x = np.concatenate(
            [
                quantity.along(a.model, b.session, j, {})[b.picks]
                + (starts[b.session.index] if quantity is TIME else 0.0)
                for b in blocks
            ]
        )
        dots(axes, x, before, BEFORE)
        dots(axes, x, left, AFTER)
        for mask, style, name in ((up, "-", "forward"), (~up, "--", "backward")):
            axes.plot(*binned(x[mask], before[mask]), style, color=BEFORE, lw=1.6, label=f"before, {name}")
        axes.plot(*binned(x, left), color=AFTER, lw=1.6, label="after")
        axes.axhspan(-p.floor[j], p.floor[j], color=MUTED, alpha=0.15, lw=0, label="noise floor")
        axes.set_xlabel(_axis(a, j, quantity))
        plain(axes)
    for axes in panels[::3]:
        axes.set_ylabel(f"residual effort [{a.model.effort_unit(a.model.joints[j])}]")
    panels[-1].axis("off")
    panels[-1].legend(*panels[0].get_legend_handles_labels(), fontsize=8, frameon=False, loc="center")
    return figure


def _axis(a: Analysis, j: int, quantity: Quantity) -> str:
    return "time, recordings one after another [s]" if quantity is TIME else quantity.label(a.model, j, {})
