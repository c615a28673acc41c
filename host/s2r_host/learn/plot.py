"""Losses and validation figures over the epochs, as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def plot_metrics(metrics: list[dict[str, Any]], path: Path) -> None:
    """One line per loss, and the validation AUC."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    epoch = [row["epoch"] for row in metrics]
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for name in ("critic", "part", "line", "proposal", "actionability"):
        left.plot(epoch, [row[name] for row in metrics], label=name)
    for name in ("critic", "part"):
        left.plot(
            epoch, [row[f"validation_{name}"] for row in metrics], "--", label=f"{name}, unseen objects"
        )
    left.set(xlabel="epoch", ylabel="loss", title="losses")
    right.plot(epoch, [row["validation_auc"] for row in metrics], color="#20639b", label="useful pushes")
    right.plot(
        epoch, [row["validation_part_auc"] for row in metrics], color="#ed553b", label="points of the part"
    )
    right.axhline(0.5, color="#999", linestyle=":")
    right.set(xlabel="epoch", ylabel="AUC", ylim=(0.4, 1.0), title="telling apart, unseen objects")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)
