"""A picture of the built model over the observed cloud: do the pieces sit where the points are?"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from s2r_host.model.build import ObjectModel
from s2r_host.perception.estimate import JointEstimate


def save_model_picture(model: ObjectModel, estimate: JointEstimate, path: Path | str) -> Path:
    """Write the model's outlines over the points of the first view, from above and from the side."""
    figure = model_figure(model, estimate)
    figure.savefig(path, dpi=110)
    return Path(path)


def model_figure(model: ObjectModel, estimate: JointEstimate) -> Figure:
    """Outlines of all pieces (moving: orange, standing: grey, guessed: dashed) over the first view's points."""
    from scipy.spatial import ConvexHull

    figure = Figure(figsize=(12, 5.4), layout="constrained")
    corners = np.concatenate(
        [p.vertices @ p.X_base_piece[:3, :3].T + p.X_base_piece[:3, 3] for p in model.pieces]
    )
    low, high = corners.min(axis=0) - 0.05, corners.max(axis=0) + 0.05
    points = estimate.view_before.points
    inside = ((points > low) & (points < high)).all(axis=1)
    shown = points[inside][:: max(1, int(inside.sum()) // 30_000)]
    for k, (i, j) in enumerate(((0, 1), (0, 2))):
        axes = figure.add_subplot(1, 2, k + 1)
        axes.plot(shown[:, i], shown[:, j], ",", color="0.6")
        for piece in model.pieces:
            flat = (piece.vertices @ piece.X_base_piece[:3, :3].T + piece.X_base_piece[:3, 3])[:, [i, j]]
            outline = flat[ConvexHull(flat).vertices]
            colour = "#d9601a" if piece.body == "part" else "#4a5560"
            axes.add_collection(
                PolyCollection(
                    [outline], facecolors=[(*_rgb(colour), 0.12)], edgecolors=[colour],
                    linestyles=["-" if piece.seen else "--"], linewidths=[1.0],
                )
            )  # fmt: skip
        axes.set_aspect("equal")
        axes.set_xlabel("xyz"[i] + " [m]")
        axes.set_ylabel("xyz"[j] + " [m]")
        axes.set_title("from above" if k == 0 else "from the side", fontsize=9)
    return figure


def _rgb(colour: str) -> tuple[float, float, float]:
    from matplotlib.colors import to_rgb

    return to_rgb(colour)
