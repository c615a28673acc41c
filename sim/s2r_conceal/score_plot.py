"""One page of plots beside the table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from s2r_conceal.score import STRENGTH_BINS, confusion, every_stated, reliability, where_asked
from s2r_conceal.score_case import CaseScore


def plot_page(scores: Sequence[CaseScore], path: Path) -> None:
    """Naming by strength, reliability of probabilities, overlap and oracle ratio, confusion; one SVG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure = plt.figure(figsize=(13, 13), layout="constrained")
    grid = figure.add_gridspec(2, 3, height_ratios=[1.0, 2.4])
    _by_strength(figure.add_subplot(grid[0, 0]), scores)
    _reliability(figure.add_subplot(grid[0, 1]), scores)
    _distributions(figure.add_subplot(grid[0, 2]), scores)
    _confusion(figure.add_subplot(grid[1, :]), scores)
    figure.savefig(path)
    plt.close(figure)


def _by_strength(axes, scores: Sequence[CaseScore]) -> None:  # noqa: ANN001 - matplotlib axes
    single = [s for s in scores if s.group == "single" and s.strength is not None]
    for k, (_, low, high) in enumerate(STRENGTH_BINS):
        part = [s for s in single if low <= (s.strength or 0.0) < high]
        share = np.mean([bool(s.top1) for s in part]) if part else 0.0
        held = np.mean([bool(s.in_set) for s in part]) if part else 0.0
        axes.bar(k - 0.18, share, 0.34, color="tab:blue", label="first name" if k == 0 else None)
        axes.bar(k + 0.18, held, 0.34, color="tab:cyan", label="in the answer set" if k == 0 else None)
        axes.text(k, 1.02, f"n = {len(part)}", ha="center", fontsize=8)
    axes.set_xticks(range(3), [b[0] for b in STRENGTH_BINS])
    axes.set(ylim=(0, 1.12), ylabel="share right", title="single effects, strength in floors")
    axes.legend(loc="lower right", fontsize=8)


def _reliability(axes, scores: Sequence[CaseScore]) -> None:  # noqa: ANN001 - matplotlib axes
    axes.plot([0, 1], [0, 1], color="0.7")
    for stated, face, edge, label in (
        (every_stated(scores), "tab:blue", "tab:blue", "every stated name"),
        (where_asked(scores), "none", "tab:orange", "where an effect is to be named"),
    ):
        found = reliability(stated)
        said, right, counts = zip(*found, strict=True) if found else ((), (), ())
        label = f"{label} (n = {sum(counts)})"
        axes.scatter(said, right, (4 + np.sqrt(counts)) ** 2, facecolor=face, edgecolor=edge, label=label)
    axes.set(xlabel="stated probability", ylabel="share right", title="calibration of the first name")
    axes.set(xlim=(0, 1), ylim=(-0.02, 1.02))
    axes.legend(loc="upper left", fontsize=8)


def _distributions(axes, scores: Sequence[CaseScore]) -> None:  # noqa: ANN001 - matplotlib axes
    for name, colour in (("iou", "tab:green"), ("oracle_ratio", "tab:orange")):
        values = np.sort([getattr(s, name) for s in scores if getattr(s, name) is not None])
        if values.size:
            label = f"{name.replace('_', ' ')} (n = {values.size})"
            axes.step(
                np.clip(values, -0.5, 1.2),
                (np.arange(values.size) + 1) / values.size,
                color=colour,
                label=label,
            )
    axes.set(xlabel="value", ylabel="share of cases below", title="regime overlap and oracle ratio")
    axes.legend(fontsize=8)


def _confusion(axes, scores: Sequence[CaseScore]) -> None:  # noqa: ANN001 - matplotlib axes
    counts = confusion(scores)
    rows = sorted(counts)
    columns = sorted({said for row in counts.values() for said in row})
    matrix = np.array([[counts[r].get(c, 0) for c in columns] for r in rows], float).reshape(
        len(rows), len(columns)
    )
    axes.imshow(
        matrix / np.maximum(matrix.sum(1, keepdims=True), 1), cmap="Blues", vmin=0, vmax=1, aspect="auto"
    )
    for i, j in zip(*np.nonzero(matrix), strict=True):
        axes.text(j, i, f"{matrix[i, j]:.0f}", ha="center", va="center", fontsize=7)
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha="right", fontsize=7)
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.set(xlabel="answered first", ylabel="hidden", title="what was hidden and what was answered")
