"""The page of ablations: each option set beside the system as it is, on the same trials, with one picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from s2r_sim.paper.ablations import FIRST, LAST, LEAST, Pairs, tables
from s2r_sim.paper.picture import picture_link, picture_of
from s2r_sim.paper.summary import interval

_COLOURS = {"drawer": "#20639b", "laptop": "#e08e45", "faucet": "#3a8f5c", "all": "#222222"}
_LINEAR = 3.0  # percent up to which the picture's scale is linear, logarithmic beyond
_ROW = 0.17  # of the height of an option set, between its kinds


def write_page(comparisons: Sequence[Sequence[Pairs]], path: Path, command: str, remarks: str = "") -> None:
    """Write the page and, beside it, its picture.

    Args:
        comparisons: Per option set its pairs by kind.
        path: Of the page.
        command: That wrote it.
        remarks: Markdown that goes before the tables.
    """
    lines = [
        "# Ablations",
        "",
        "The experiments of Sim2Real² on the parts of the system, redone with the whole loop: the same concealed "
        "objects, the same wanted motions, one part of the system left out or added.",
        "**Simulated stand-in objects with concealed physics; paired comparisons on numbers that were opened before, "
        "and no report of accuracy: that is in [results](results.md).**",
        "",
        f"Written by `{command}`.",
        "",
        *([remarks.strip(), ""] if remarks else []),
        "## Tables",
        "",
        *tables(comparisons),
        "",
        picture_link("Paired differences per option set", path),
        "",
        "Each dot is a trial, the diamond the mean with its 90 % bootstrap interval. Left of zero: better than the "
        "system as it is. The scale is logarithmic beyond ±3 %.",
        "",
        "## Every trial",
        "",
        *_trials(comparisons),
    ]
    path.write_text("\n".join(lines) + "\n")
    draw(comparisons, picture_of(path))


def _trials(comparisons: Sequence[Sequence[Pairs]]) -> list[str]:
    lines = [
        "δ_r after the first and after the last manipulation; – where there was none.",
        "",
        "| option set | object | trial | as it is | with the option set |",
        "|---|---|---|---|---|",
    ]
    for pairs in comparisons:
        for one in pairs:
            if one.kind == "all" or one.only_last:
                continue
            for ours, changed in zip(one.ours, one.changed, strict=True):
                shown = [
                    ", ".join(
                        "–" if row.get(key) is None else f"{100 * row[key] / row['change']:+.1f} %"
                        for key in (FIRST, LAST)
                    )
                    for row in (ours, changed)
                ]
                lines.append(f"| {one.label} | {one.kind} | {ours['number']} | {shown[0]} | {shown[1]} |")
    return lines


def draw(comparisons: Sequence[Sequence[Pairs]], path: Path) -> None:
    """Paired differences of |δ_r| per option set and kind, after the first and after the last manipulation."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D

    figure, panels = plt.subplots(
        1, 2, figsize=(12.0, 1.6 + 0.85 * len(comparisons)), layout="constrained", sharey=True
    )
    titles = (("after the first manipulation", FIRST), ("after the last manipulation", LAST))
    for axes, (title, key) in zip(panels, titles, strict=True):
        for place, pairs in enumerate(comparisons):
            if key == FIRST and pairs[0].only_last:
                continue  # the same by definition
            for k, one in enumerate(pairs):
                y = place + _ROW * (k - 0.5 * (len(pairs) - 1))
                values = 100 * one.differences(key)
                colour = _COLOURS.get(one.kind, "#777777")
                if one.kind != "all":
                    axes.plot(values, np.full(len(values), y), "o", color=colour, markersize=3.5, alpha=0.5)
                mean, low, high = interval(values, "mean")
                if len(values) >= LEAST:
                    axes.plot([low, high], [y, y], color=colour, linewidth=2.2)
                axes.plot(mean, y, "D", color=colour, markersize=5, markeredgecolor="white")
        axes.set_xscale("symlog", linthresh=_LINEAR)
        axes.axvline(0.0, color="#999999", linewidth=1)
        axes.set(xlabel="difference of |δ_r| [% of the wanted motion]", title=title, xlim=(-300, 300))
        axes.set_xticks([-100, -30, -10, -3, -1, 0, 1, 3, 10, 30, 100])
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:+.0f}" if value else "0")
        axes.xaxis.set_minor_locator(mpl.ticker.NullLocator())
        axes.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(range(len(comparisons)), [pairs[0].label for pairs in comparisons])
    panels[0].invert_yaxis()
    kinds = dict.fromkeys(one.kind for pairs in comparisons for one in pairs)
    handles = [Line2D([], [], color=_COLOURS.get(kind, "#777777"), marker="D", label=kind) for kind in kinds]
    panels[1].legend(handles=handles, loc="lower right", fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)
