"""Before and after on held-out data: effort residual, motion in the closed and in the open loop."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from s2r_host.gap.output.drawing import AFTER, BEFORE, MEASURED, MUTED, WIDTH_IN
from s2r_host.gap.pipeline import Analysis
from s2r_host.gap.regression.rows import Block
from s2r_host.gap.simulation.forward import Trace, first_held

SLACK = 0.4  # room for a simulation that leaves the recorded travel, over that
LOOPS = {True: "closed loop", False: "open loop"}


def shown_block(a: Analysis, j: int) -> tuple[Block | None, list[bool]]:
    """The recording whose held-out part is shown, and the loops in which it was simulated there, True for closed.

    Strokes can be too short for an open-loop window; the first one that is not shows more.
    """
    assert a.problem is not None
    held = [b for b in a.problem.blocks if b.joint == j and b.held.any()]
    simulated = {
        closed: {t.session.index for t in _traces(a) if t.closed is closed and _is_held(a, t)}
        for closed in (True, False)
    }
    best = max(held, key=lambda b: sum(b.session.index in x for x in simulated.values()), default=None)
    if best is None:
        return None, []
    return best, [closed for closed, found in simulated.items() if best.session.index in found]


def _traces(a: Analysis) -> list[Trace]:
    return [t for errors in (a.before, a.after) if errors is not None for t in errors.traces]


def _is_held(a: Analysis, trace: Trace) -> bool:
    """Does a simulated stretch reach into rows held out? In the closed loop it runs along the whole recording."""
    return trace.held or (trace.closed and not a.hold)


def overlay_figure(a: Analysis, j: int) -> Figure:
    """Held-out effort residual; where it was simulated, position and its error, a column per loop.

    In the closed loop also what the controller asks for, by which it hides a mismatch.
    """
    assert a.problem is not None
    block, loops = shown_block(a, j)
    figure = Figure(figsize=(WIDTH_IN, 2.6 + 3.8 * bool(loops) + 1.9 * (True in loops)), layout="constrained")
    rows = 1 + 2 * bool(loops) + (True in loops)
    grid = figure.add_gridspec(rows, max(1, len(loops)))
    top = figure.add_subplot(grid[0, :])
    _residual(a, j, block, top)
    drawn = [top]
    for column, closed in enumerate(loops):
        assert block is not None
        panels: list[Axes] = []
        for k in range(3 if closed else 2):
            panels.append(figure.add_subplot(grid[1 + k, column], sharex=top))
        _motion(a, j, block, closed, panels)
        drawn += panels
    for axes in drawn:
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _residual(a: Analysis, j: int, block: Block | None, top: Axes) -> None:
    assert a.problem is not None
    assert a.decision is not None
    p = a.problem
    if block is not None:
        t = block.session.t[block.picks][block.held]
        top.plot(t, p.raw[block.rows][block.held], color=BEFORE, lw=0.9, label="before")
        left = a.decision.solution.unexplained[block.rows][block.held]
        top.plot(t, left, color=AFTER, lw=0.9, label="after")
        top.axhspan(-p.floor[j], p.floor[j], color=MUTED, alpha=0.2, lw=0, label="noise floor")
        top.legend(fontsize=8, frameon=False, ncols=3)
    top.set_ylabel(f"effort residual [{a.model.effort_unit(a.model.joints[j])}]")
    top.set_xlabel("time [s]")


def _motion(a: Analysis, j: int, block: Block, closed: bool, panels: list[Axes]) -> None:
    """Simulated position over the recorded one and what it is off by; in the closed loop the effort's error as well."""
    name = a.model.joints[j]
    unit, loop = a.model.unit(name), LOOPS[closed]
    late = block.session.t[block.picks][block.held]
    for errors, colour, label in ((a.before, BEFORE, "before"), (a.after, AFTER, "after")):
        first = True
        for trace in errors.traces if errors is not None else []:
            s = trace.session
            if trace.closed is not closed or s.index != block.session.index or not _is_held(a, trace):
                continue
            skip = 0 if a.hold or not closed else max(0, first_held(s) - trace.start)
            rows = slice(trace.start + skip, trace.start + len(trace.q))
            q, u = trace.q[skip:, j], trace.u[skip:, j]
            panels[0].plot(s.t[rows], q, color=colour, lw=0.9, label=label if first else None)
            panels[1].plot(s.t[rows], q - s.q[rows, j], color=colour, lw=0.9)
            if len(panels) > 2:
                panels[2].plot(s.t[rows], u - s.u[rows, j], color=colour, lw=0.9)
            first = False
    s = block.session
    shown = (s.t >= late[0]) & (s.t <= late[-1])
    q = s.q[shown, j]
    panels[0].plot(s.t[shown], q, color=MEASURED, lw=1.3, ls=":", label="recorded")
    slack = SLACK * float(np.ptp(q)) + 1e-9
    panels[0].set_ylim(float(q.min()) - slack, float(q.max()) + slack)
    panels[0].legend(fontsize=8, frameon=False, ncols=3)
    panels[0].set_ylabel(f"{loop} [{unit}]")
    panels[1].set_ylabel(f"its error [{unit}]")
    if len(panels) > 2:
        panels[2].set_ylabel(f"effort's error [{a.model.effort_unit(name)}]")
    panels[-1].set_xlabel("time [s]")
