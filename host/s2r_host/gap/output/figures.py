"""Figures of the report: where the residual lives, the map that betrays its cause, before and after."""

from __future__ import annotations

import base64
import html
import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from s2r_host.gap.pipeline import Analysis
from s2r_host.gap.regression.rows import Block
from s2r_host.gap.simulation.forward import Errors

MUTED, BEFORE, AFTER, MEASURED = "#667085", "#d1495b", "#1f7a8c", "#1d2433"
_BETRAYED = ("parameter_off", "physics_missing", "unknown")  # verdicts by which something is off
COLUMNS = 300  # of the heat map, per recording set


def figures(a: Analysis) -> str:
    """All figures as HTML."""
    if a.problem is None:
        return ""
    out = [
        "<h2>Residual over joints and time</h2>",
        _image(heat_map(a), "residual of each joint over time in noise floors, before and after"),
    ]
    heading = "What betrays it" if a.verdict in _BETRAYED else "What is left"
    for j in _figure_joints(a):
        name = a.model.joints[j]
        maps = _image(maps_figure(a, j), f"residual effort of {name} over speed and over position")
        held = _image(
            overlay_figure(a, j), f"held-out effort residual and motion of {name}, before and after"
        )
        out += [f"<h2>{heading}: {html.escape(name)}</h2>", maps]
        out += [f"<h2>Before and after on held-out data: {html.escape(name)}</h2>", held]
    return "\n".join(out)


def _figure_joints(a: Analysis) -> list[int]:
    """Joints of the most probable effects first, then those with the largest share of the gap; two at most."""
    assert a.problem is not None
    effects = a.decision.effects if a.decision else []
    names = [e.joint for e in effects] + [p.joint for p in a.places]
    found = [a.model.index(n) for n in dict.fromkeys(names) if n in a.model.joints]
    return [j for j in found if j in a.problem.joints][:2] or a.problem.joints[:1]


def _image(figure: Figure, alt: str) -> str:
    FigureCanvasAgg(figure)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, bbox_inches="tight")
    data = base64.b64encode(stream.getvalue()).decode()
    return f"<img alt='{html.escape(alt)}' src='data:image/png;base64,{data}'>"


def heat_map(a: Analysis) -> Figure:
    """Residual in noise floors, joint by time, recordings one after another; before above, after below."""
    assert a.problem is not None
    assert a.decision is not None
    p = a.problem
    before, total, marks = _heat(a, p.raw)
    after, _, _ = _heat(a, a.decision.solution.unexplained)
    figure = Figure(figsize=(9, 1.6 + 0.5 * len(p.joints)))
    top = max(4.0, float(np.percentile(before, 98)))
    for k, (values, label) in enumerate(((before, "before"), (after, "after"))):
        axes = figure.add_subplot(2, 1, k + 1)
        image = axes.imshow(
            values, aspect="auto", cmap="magma_r", vmin=0, vmax=top, extent=(0, total, len(p.joints), 0)
        )
        axes.set_yticks(np.arange(len(p.joints)) + 0.5, [a.model.joints[j] for j in p.joints], fontsize=8)
        axes.set_ylabel(label)
        axes.tick_params(labelbottom=k == 1)
        for at, name in marks:
            axes.axvline(at, color=MEASURED, lw=0.8)
            if k == 0:
                axes.annotate(
                    name, (at, 1.04), xycoords=("data", "axes fraction"), fontsize=7, color=MUTED, rotation=25
                )
        figure.colorbar(image, ax=axes, label="noise floors")
    figure.axes[-2].set_xlabel("time, recordings one after another [s]")
    return figure


def _heat(a: Analysis, rows: np.ndarray) -> tuple[np.ndarray, float, list[tuple[float, str]]]:
    """Largest residual per joint and column of time, total time [s], start and name of each recording."""
    assert a.problem is not None
    p = a.problem
    sessions = list({b.session.index: b.session for b in p.blocks}.values())
    starts = dict(
        zip([s.index for s in sessions], np.cumsum([0.0, *[float(s.t[-1]) for s in sessions]]), strict=False)
    )
    total = sum(float(s.t[-1]) for s in sessions)
    fewest = min(b.rows.stop - b.rows.start for b in p.blocks) * len(sessions)
    columns = int(np.clip(fewest // 2, 10, COLUMNS))
    image = np.zeros((len(p.joints), columns))
    for b in p.blocks:
        t = starts[b.session.index] + b.session.t[b.picks]
        at = np.clip((t / total * columns).astype(int), 0, columns - 1)
        np.maximum.at(image[p.joints.index(b.joint)], at, np.abs(rows[b.rows]) / p.floor[b.joint])
    return image, total, [(float(starts[s.index]), s.rec.name) for s in sessions]


def maps_figure(a: Analysis, j: int) -> Figure:
    """Residual against speed and position, before (red) and after (teal), binned by direction."""
    assert a.problem is not None
    assert a.decision is not None
    p = a.problem
    figure = Figure(figsize=(9, 3.2))
    after = a.decision.solution.unexplained
    unit, effort = a.model.unit(a.model.joints[j]), a.model.effort_unit(a.model.joints[j])
    for k, (label, pick) in enumerate((("speed", "v"), ("position", "q"))):
        axes = figure.add_subplot(1, 2, k + 1)
        x, up, r, left = [], [], [], []
        for b in p.blocks:
            if b.joint == j:
                x.append(getattr(b.session, pick)[b.picks, j])
                up.append(b.session.v[b.picks, j] > 0)
                r.append(p.raw[b.rows])
                left.append(after[b.rows])
        X, U, R, L = (np.concatenate(v) for v in (x, up, r, left))
        axes.plot(X, R, ".", ms=1.5, color=BEFORE, alpha=0.25)
        axes.plot(X, L, ".", ms=1.5, color=AFTER, alpha=0.25)
        for mask, style, name in ((U, "-", "forward"), (~U, "--", "backward")):
            c, m = _binned(X[mask], R[mask])
            axes.plot(c, m, style, color=BEFORE, lw=1.6, label=f"before, {name}")
        c, m = _binned(X, L)
        axes.plot(c, m, color=AFTER, lw=1.6, label="after")
        axes.axhspan(-p.floor[j], p.floor[j], color=MUTED, alpha=0.15, lw=0)
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.set_xlabel(f"{label} [{unit}{'/s' if pick == 'v' else ''}]")
        axes.set_ylabel(f"residual effort [{effort}]" if k == 0 else "")
        axes.spines[["top", "right"]].set_visible(False)
        if k == 0:
            axes.legend(fontsize=7, frameon=False)
    return figure


def _binned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    bins = int(np.clip(len(x) // 8, 4, 40))
    if len(x) < 2 * bins:
        return np.zeros(0), np.zeros(0)
    edges = np.linspace(x.min(), x.max(), bins + 1)
    index = np.clip(np.digitize(x, edges) - 1, 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    mean = np.bincount(index, y, minlength=bins) / np.maximum(count, 1)
    good = count > 2
    return (0.5 * (edges[1:] + edges[:-1]))[good], mean[good]


def _first(errors: Errors) -> int:
    """Start of the first held-out open-loop window."""
    return min(trace.start for trace in errors.traces if not trace.closed and trace.held)


def _shown_block(a: Analysis, j: int) -> tuple[Block | None, bool]:
    """The recording whose held-out part is shown, and whether it was simulated in the open loop there.

    Strokes can be too short for a window of it; the first one that is not shows more.
    """
    assert a.problem is not None
    held = [b for b in a.problem.blocks if b.joint == j and b.held.any()]
    simulated = {
        trace.session.index
        for errors in (a.before, a.after)
        if errors is not None
        for trace in errors.traces
        if trace.held and not trace.closed
    }
    block = next((b for b in held if b.session.index in simulated), None)
    return (block, True) if block is not None else (held[0] if held else None, False)


def overlay_figure(a: Analysis, j: int) -> Figure:
    """Held-out effort residual before and after; where it was simulated, open-loop position and its error as well."""
    assert a.problem is not None
    assert a.decision is not None
    p = a.problem
    block, simulated = _shown_block(a, j)
    figure = Figure(figsize=(9, 6.4 if simulated else 2.4))
    panels = figure.subplots(3 if simulated else 1, 1, sharex=True, squeeze=False)[:, 0]
    top = panels[0]
    if block is not None:
        t = block.session.t[block.picks][block.held]
        top.plot(t, p.raw[block.rows][block.held], color=BEFORE, lw=0.9, label="before")
        left = a.decision.solution.unexplained[block.rows][block.held]
        top.plot(t, left, color=AFTER, lw=0.9, label="after")
        top.axhspan(-p.floor[j], p.floor[j], color=MUTED, alpha=0.2, lw=0)
        top.legend(fontsize=8, frameon=False, ncols=2)
    top.set_ylabel(f"effort residual [{a.model.effort_unit(a.model.joints[j])}]")
    if simulated and block is not None:
        _overlay_motion(a, j, block, panels[1], panels[2])
    panels[-1].set_xlabel("time [s]")
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _overlay_motion(a: Analysis, j: int, block: Block, motion: Axes, error: Axes) -> None:
    """Open-loop position over the recorded one, and what it is off by."""
    for errors, colour, name in ((a.before, BEFORE, "before"), (a.after, AFTER, "after")):
        if errors is None:
            continue
        for trace in errors.traces:
            if trace.closed or not trace.held or trace.session.index != block.session.index:
                continue
            stop = trace.start + len(trace.q)
            clock = trace.session.t[trace.start : stop]
            label = name if trace.start == _first(errors) else None
            motion.plot(clock, trace.q[:, j], color=colour, lw=0.9, label=label)
            error.plot(clock, trace.q[:, j] - trace.session.q[trace.start : stop, j], color=colour, lw=0.9)
    s, late = block.session, block.session.t[block.picks][block.held]
    shown = (s.t >= late[0]) & (s.t <= late[-1])
    q = s.q[shown, j]
    motion.plot(s.t[shown], q, color=MEASURED, lw=1.3, ls=":", label="recorded")
    slack = 0.6 * float(np.ptp(q)) + 1e-9
    motion.set_ylim(float(q.min()) - slack, float(q.max()) + slack)
    motion.legend(fontsize=8, frameon=False, ncols=3)
    unit = a.model.unit(a.model.joints[j])
    motion.set_ylabel(f"open loop [{unit}]")
    error.set_ylabel(f"error [{unit}]")
