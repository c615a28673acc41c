"""Losses and validation figures over the epochs, as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

LONG = 12  # epochs from which on points would only hide the lines


def plot_metrics(metrics: list[dict[str, Any]], path: Path) -> None:
    """One line per loss of the push network, and the validation AUC."""
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
    right.set(xlabel="epoch", ylabel="AUC", ylim=(0.0, 1.02), title="telling apart, unseen objects")
    _dress((left, right), len(epoch))
    figure.savefig(path, dpi=110)
    plt.close(figure)


def plot_pair_metrics(metrics: list[dict[str, Any]], path: Path) -> None:
    """Losses of the pair network, and how far its joints are off on unseen objects."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    epoch = [row["epoch"] for row in metrics]
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(14, 4), layout="constrained")
    for k, name in enumerate(("part", "type", "direction", "line", "state")):
        left.plot(epoch, [row[name] for row in metrics], color=f"C{k}", label=name)
        left.plot(epoch, [row[f"validation_{name}"] for row in metrics], "--", color=f"C{k}")
    left.set(xlabel="epoch", ylabel="loss", title="losses (dashed: unseen objects)")
    units = {
        "axis_deg": "axis [degrees]",
        "line_mm": "line [mm]",
        "turn_deg": "turn [degrees]",
        "slide_mm": "slide [mm]",
    }
    for name, label in units.items():
        middle.plot(epoch, [row.get(f"validation_{name}", np.nan) for row in metrics], label=label)
    middle.set(xlabel="epoch", ylabel="median error", yscale="log", title="joint, unseen objects")
    right.plot(epoch, [row["validation_type_right"] for row in metrics], label="type right")
    right.plot(epoch, [row["validation_iou"] for row in metrics], label="part, IoU")
    right.set(xlabel="epoch", ylim=(0.0, 1.02), title="type and part, unseen objects")
    _dress((left, middle, right), len(epoch))
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _dress(panels: tuple[Any, ...], epochs: int) -> None:
    """Grid, legend and whole epochs; a point per epoch where they are few, as one alone makes no line."""
    for axes in panels:
        for line in axes.get_lines():
            line.set_marker("." if epochs < LONG else "None")
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.grid(alpha=0.3)
        axes.legend()
