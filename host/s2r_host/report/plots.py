"""Plots of a run: joints planned and executed, the part over time, stage timings."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from s2r_host.errors import RecordingError
from s2r_host.recording import JointTrack, plan_track
from s2r_host.report.style import EXECUTED, FAILED, PLANNED, RC, SEEN, TARGET
from s2r_host.run.journal import Stage
from s2r_host.run.record import Goal, RunRecord
from s2r_host.run.session import Executed


def tracking_error(executed: Executed) -> tuple[JointTrack, np.ndarray] | None:
    """(measured track, measured minus planned [rad] (n, dof)) over the planned time; None without a recording."""
    if executed.recording is None:
        return None
    try:
        track = plan_track(executed.recording, executed.seq)
    except RecordingError:
        return None
    return track, track.q - executed.trajectory.sample(track.t)[0]


def joints_figure(
    executed: Executed, joint_names: Sequence[str], found: tuple[JointTrack, np.ndarray] | None
) -> Figure:
    """One column per joint: planned and executed above, their difference below, as :func:`tracking_error` has it."""
    with mpl.rc_context(RC):
        figure = Figure(figsize=(12.5, 4.2))
        # Set by hand: to measure the labels of so many axes takes as long as to draw them.
        space = {"left": 0.07, "right": 0.995, "bottom": 0.1, "top": 0.88, "wspace": 0.36, "hspace": 0.1}
        grid = figure.subplots(2, len(joint_names), sharex=True, height_ratios=[2.2, 1.0], gridspec_kw=space)
        t = np.linspace(0.0, executed.trajectory.duration_s, 300)
        q_planned = executed.trajectory.sample(t)[0]
        for i, name in enumerate(joint_names):
            upper, lower = grid[0, i], grid[1, i]
            upper.plot(t, q_planned[:, i], color=PLANNED, lw=3.0, alpha=0.45, label="planned")
            if found is not None:
                track, error = found
                upper.plot(track.t, track.q[:, i], color=EXECUTED, lw=1.0, label="executed")
                lower.plot(track.t, 1e3 * error[:, i], color=EXECUTED, lw=0.8)
            upper.set_title(name)
            lower.set_xlabel("t [s]")
        grid[0, 0].set_ylabel("position [rad]")
        grid[1, 0].set_ylabel("executed −\nplanned [mrad]")
        if found is not None:
            reach = max(0.5, 1.05e3 * float(np.abs(found[1]).max()))
            for lower in grid[1]:
                lower.set_ylim(-reach, reach)
        # Above all axes: a small one has no corner that every curve leaves free.
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="upper left", ncols=2, fontsize=8)
        return figure


def state_figure(record: RunRecord) -> Figure:
    """The part over time: seen by the camera, and as each delivered plan foresaw it; the targets while they held.

    Joint values count as the command line's targets do.
    """
    task, origin = record.settings.task, record.origin
    scale, unit = task.unit.factor, task.unit.name
    with mpl.rc_context(RC):
        figure = Figure(figsize=(12.5, 3.6), layout="constrained")
        axes = figure.subplots()
        for k, (goal, begin, end) in enumerate(_times(record.goals)):
            middle, half = scale * (goal.target - origin), scale * task.tolerance
            label = f"target ± {half:.3g} {unit}" if k == 0 else None
            axes.fill_between(
                [begin, end], middle - half, middle + half, color=TARGET, alpha=0.14, lw=0, label=label
            )
            axes.plot([begin, end], [middle] * 2, color=TARGET, lw=1.2)
        for k, done in enumerate(record.attempts):
            replay, executed = done.planned.delivery.replay, done.executed[0]
            pace = executed.wall_s / executed.trajectory.duration_s  # a stepped clock runs slower or faster
            label = "foreseen by the plan" if k == 0 else None
            foreseen = scale * (replay.s + done.shift - origin)
            axes.plot(executed.begun_s + pace * replay.t, foreseen, color=PLANNED, lw=1.8, label=label)
        t, s, sigma, names = (list(column) for column in zip(*_seen(record), strict=True))
        axes.errorbar(
            t,
            scale * np.array(s),
            yerr=2.0 * scale * np.array(sigma),
            fmt="o",
            color=SEEN,
            ms=5,
            capsize=3,
            label="seen by the camera (± 2σ)",
        )
        for ti, si, name in zip(t, s, names, strict=True):
            axes.annotate(name, (ti, scale * si), xytext=(6, -12), textcoords="offset points", color=SEEN)
        axes.margins(y=0.12)
        axes.set_xlabel("time since the run began [s]")
        axes.set_ylabel(f"{task.part} [{unit}]")
        axes.legend(loc="best", fontsize=8)
        return figure


def _times(goals: Sequence[Goal]) -> list[tuple[Goal, float, float]]:
    """Goals with the times from which and until which they were aimed at [s]; the first from the beginning."""
    aimed = [goal for goal in goals if goal.attempts]
    ends = [goal.last.view.taken_s for goal in aimed]
    return list(zip(aimed, [0.0, *ends], ends, strict=False))


def _seen(record: RunRecord) -> list[tuple[float, float, float, str]]:
    """(time, state as targets are counted, standard error, name) of every look at the part."""
    known = {record.zero_view: (0.0, 0.0), record.origin_view: (record.origin, 0.0)}
    if record.s_found is not None:
        known[record.found_view] = (record.s_found, 0.0)
    for done in record.attempts:
        sigma = done.measured.sigma
        known[done.view.name] = (done.measured.s, sigma if np.isfinite(sigma) else 0.0)
    looks = [(view, *known[view.name]) for view in record.views if view.name in known]
    return [(view.taken_s, s - record.origin, sigma, view.name) for view, s, sigma in looks]


def stages_figure(stages: Sequence[Stage]) -> Figure:
    """One bar per stage over wall time; the darker part is this process's share of computing."""
    with mpl.rc_context(RC):
        figure = Figure(figsize=(12.5, 0.30 * len(stages) + 0.9), layout="constrained")
        axes = figure.subplots()
        for row, stage in enumerate(stages):
            colour = FAILED if stage.failed else PLANNED
            axes.barh(row, stage.wall_s, left=stage.start_s, color=colour, alpha=0.35, height=0.72)
            axes.barh(row, min(stage.cpu_s, stage.wall_s), left=stage.start_s, color=colour, height=0.72)
            axes.text(
                stage.start_s + stage.wall_s,
                row,
                f"  {stage.wall_s:.2f} s",
                va="center",
                fontsize=8,
                color=SEEN,
            )
        axes.set_yticks(range(len(stages)), [stage.name for stage in stages])
        axes.invert_yaxis()
        axes.set_xlabel("time since the run began [s]; dark: computing in this process (one core's worth)")
        axes.grid(axis="y", visible=False)
        axes.margins(x=0.06)
        return figure
