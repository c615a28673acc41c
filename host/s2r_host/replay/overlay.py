"""Pictures of a replay: both recordings on top of each other, as PNG and as one HTML page."""

from __future__ import annotations

from html import escape
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from s2r_host.replay.replay import Repeatability, Replayed
from s2r_host.report.markup import page, section, table
from s2r_host.report.style import EXECUTED, PLANNED, RC, SEEN, inline_png
from s2r_protocol.whole_file import write_whole


def overlay_figure(replayed: Replayed, joint_names: tuple[str, ...]) -> Figure:
    """Per joint: both executions above, replay minus first below."""
    found = replayed.comparison
    difference = 1e3 * (found.q_again - found.q_first)
    base = "first" if replayed.plan.first is not None else "plan"
    with mpl.rc_context(RC):
        figure = Figure(figsize=(12.5, 4.4), layout="constrained")
        grid = figure.subplots(2, len(joint_names), sharex=True, height_ratios=[2.2, 1.0])
        reach = max(0.05, 1.1 * float(np.abs(difference).max()))
        for i, name in enumerate(joint_names):
            upper, lower = grid[0, i], grid[1, i]
            upper.plot(found.t, found.q_first[:, i], color=PLANNED, lw=3.0, alpha=0.45, label=base)
            upper.plot(found.t, found.q_again[:, i], color=EXECUTED, lw=1.0, label="replay")
            lower.plot(found.t, difference[:, i], color=SEEN, lw=0.8)
            lower.set_ylim(-reach, reach)
            upper.set_title(name)
            lower.set_xlabel("t [s]")
        grid[0, 0].set_ylabel("measured [rad]")
        grid[1, 0].set_ylabel("replay −\nfirst [mrad]")
        grid[0, 0].legend(loc="best", fontsize=8)
        return figure


def write_overlay(
    replayed: Replayed,
    joint_names: tuple[str, ...],
    run: Path,
    folder: Path,
    spread: Repeatability | None = None,
    speed: float = 1.0,
) -> Path:
    """Write ``overlay.png`` and ``replay.html``, with statistics when there were several; the page's path.

    Args:
        replayed: The execution to show.
        joint_names: In the plan's order.
        run: Where the plan came from.
        folder: Where to; made if missing.
        spread: Of all executions, when there were several.
        speed: Share of the recorded speed it was sent at; the curves are over the plan's own time all the same.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figure = overlay_figure(replayed, joint_names)
    figure.savefig(folder / "overlay.png", dpi=110)
    found = replayed.comparison
    rows = [
        (name, f"{1e3 * rms:.4f}", f"{1e3 * largest:.4f}")
        for name, rms, largest in zip(joint_names, found.rms_rad, found.largest_rad, strict=True)
    ]
    plan = replayed.plan
    slower = "" if speed == 1.0 else f", at {speed:g} of its speed and shown over its own time"
    head = (
        f"<h1>Replay of '{escape(plan.label)}'</h1><p class='lead'>plan {plan.number} of {escape(run.name)}, "
        f"{plan.trajectory.duration_s:.2f} s, sent again through the same admission as the executor's plan "
        f"{replayed.seq}{slower}</p>"
    )
    parts = [
        head,
        section("Both recordings", inline_png(figure, "joints of both executions")),
        section("Difference, replay minus first", table(("joint", "RMS [mrad]", "largest [mrad]"), rows)),
    ]
    if spread is not None:
        rows = [
            (name, f"{1e3 * sigma:.4f}", f"{1e3 * span:.4f}")
            for name, sigma, span in zip(joint_names, spread.sigma_rad, spread.range_rad, strict=True)
        ]
        header = ("joint", "standard deviation [mrad]", "largest spread [mrad]")
        parts.append(section(f"Repeatability of {len(spread.q)} replays", table(header, rows)))
    path = folder / "replay.html"
    write_whole(path, page(f"replay of {plan.label}", parts))
    return path
