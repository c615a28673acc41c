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
    for name in ("critic", "proposal", "actionability"):
        left.plot(epoch, [row[name] for row in metrics], label=name)
    left.plot(epoch, [row["validation_critic"] for row in metrics], "--", label="critic, unseen objects")
    left.set(xlabel="epoch", ylabel="loss", title="losses")
    right.plot(epoch, [row["validation_auc"] for row in metrics], color="#20639b")
    right.axhline(0.5, color="#999", linestyle=":")
    right.set(xlabel="epoch", ylabel="AUC", ylim=(0.4, 1.0), title="telling useful pushes, unseen objects")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    left.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)
