"""The picture of the results page: which share of the trials ended below which relative error, beside the paper's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from s2r_sim.paper.score import Row
from s2r_sim.paper.summary import LIMITS, PAPER, relative_errors


def shares_below(rows: Sequence[Row], key: str) -> tuple[np.ndarray, np.ndarray]:
    """Sorted |δ_r| [%], and the share [%] of all trials that ended no further off; the rest had no manipulation."""
    errors = np.sort(100.0 * relative_errors(rows, key))
    return errors, 100.0 / max(len(rows), 1) * np.arange(1, len(errors) + 1)


def draw_distribution(rows: Sequence[Row], kinds: Sequence[str], path: Path) -> None:
    """How many trials end below which |δ_r|, per kind, after the first and the last manipulation, beside the paper's.

    The scale of |δ_r| is logarithmic: most trials end far below the paper's first bar. A curve ends below 100 % where
    trials had no manipulation. Behind the curves stand the numbers of trials after the last manipulation in bins.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    low, high = 0.1, 200.0  # of |δ_r| [%]; what is beyond stands at the edge
    edges = np.geomspace(low, high, 23)
    columns = max(len(kinds), 1)
    figure, all_axes = plt.subplots(
        1, columns, figsize=(4.2 * columns, 3.8), layout="constrained", squeeze=False, sharey=True
    )
    for axes, kind in zip(all_axes[0], kinds, strict=False):
        mine = [row for row in rows if row["kind"] == kind]
        for key, label, colour in (
            ("delta_first", "first manipulation", "#e08e45"),
            ("delta", "last manipulation", "#20639b"),
        ):
            errors, below = shares_below(mine, key)
            if not len(errors):
                continue
            shown = np.clip(errors, low, high)
            if key == "delta":
                axes.hist(shown, edges, weights=np.full(len(shown), below[0]), color=colour, alpha=0.25)
            axes.step([low, *shown, high], [0.0, *below, below[-1]], where="post", color=colour, label=label)
            median = float(np.median(errors))
            axes.plot(np.clip(median, low, high), np.interp(median, errors, below), "o", color=colour, markersize=6,
                      label=f"its median: {median:.1f} %")  # fmt: skip
        n, ten, thirty, _, _ = PAPER[kind]
        told = [100.0 * LIMITS[0], 100.0 * LIMITS[1]]
        axes.bar(told, [100.0 * ten / n, 100.0 * thirty / n], 0.12 * np.array(told), color="#777777",
                 label="paper (real arm)", zorder=3)  # fmt: skip
        for limit in LIMITS:
            axes.axvline(100.0 * limit, color="#999999", linestyle=":", linewidth=1)
        missed = len(mine) - len(relative_errors(mine))
        axes.set(xlabel="|δ_r| [%]", title=f"{kind}: {len(mine)} trials, {missed} without a manipulation",
                 xscale="log", xlim=(low, high), ylim=(0.0, 103.0), xticks=[0.1, 1, 10, 30, 100],
                 xticklabels=["0.1", "1", "10", "30", "100"])  # fmt: skip
        axes.grid(axis="y", alpha=0.3)
        axes.legend(loc="upper left", fontsize=7)
    all_axes[0][0].set_ylabel("trials below [%]")
    figure.savefig(path, dpi=120)
    plt.close(figure)
