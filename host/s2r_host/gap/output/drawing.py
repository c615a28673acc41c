"""What the figures of a report share: colours, pictures inside the page, means over bins."""

from __future__ import annotations

import base64
import html
import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

MUTED, BEFORE, AFTER, MEASURED = "#667085", "#d1495b", "#1f7a8c", "#1d2433"
WIDTH_IN, TEXT_PT = 9.0, 9.0  # a page is 7 inches wide: text of 7 points there
DOTS, DOTS_MOST = {"marker": ".", "ls": "", "ms": 1.8, "alpha": 0.25}, 4000
LEAST_BINS, MOST_BINS, ROWS_PER_BIN = 4, 40, 12


def image(figure: Figure, alt: str) -> str:
    """A figure as an ``img`` that needs no other file."""
    return picture(png(figure), alt)


def png(figure: Figure) -> bytes:
    """A figure as PNG."""
    for axes in figure.axes:
        axes.tick_params(labelsize=TEXT_PT - 1)
        axes.xaxis.label.set_size(TEXT_PT)
        axes.yaxis.label.set_size(TEXT_PT)
    FigureCanvasAgg(figure)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, bbox_inches="tight")
    return stream.getvalue()


def picture(content: bytes, alt: str) -> str:
    """A PNG as an ``img`` that needs no other file."""
    return f"<img alt='{html.escape(alt)}' src='data:image/png;base64,{base64.b64encode(content).decode()}'>"


def dots(axes: Axes, x: np.ndarray, y: np.ndarray, colour: str) -> None:
    """A cloud of points, thinned out evenly where there are very many."""
    some = slice(None, None, max(1, len(x) // DOTS_MOST))
    axes.plot(x[some], y[some], color=colour, rasterized=True, **DOTS)


def plain(axes: Axes) -> None:
    """Frame of a map: two sides, few ticks."""
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.spines[["top", "right"]].set_visible(False)


def binned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres of even bins over ``x`` and the mean of ``y`` in each; bins with hardly any rows are left out."""
    bins = int(np.clip(len(x) // ROWS_PER_BIN, LEAST_BINS, MOST_BINS))
    if len(x) < 2 * bins:
        return np.zeros(0), np.zeros(0)
    edges = np.linspace(x.min(), x.max(), bins + 1)
    index = np.clip(np.digitize(x, edges) - 1, 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    mean = np.bincount(index, y, minlength=bins) / np.maximum(count, 1)
    good = count > 2
    return (0.5 * (edges[1:] + edges[:-1]))[good], mean[good]
