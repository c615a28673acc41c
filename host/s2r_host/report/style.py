"""Colours and figure defaults shared by all pictures of a report."""

from __future__ import annotations

import base64
import io
from typing import Any

from matplotlib.figure import Figure

PLANNED = "#3b6fb6"
EXECUTED = "#d9722e"
SEEN = "#222222"
TARGET = "#3a9d5d"
PART = "#d9722e"
REST = "#8c96a3"
ARM = "#b9a7d6"
AXIS = "#c0264b"
FAILED = "#c0264b"

RC: dict[Any, Any] = {  # keys are a literal type of matplotlib's stubs
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e7ec",
    "grid.linewidth": 0.8,
    "axes.edgecolor": "#98a1ad",
    "axes.labelcolor": "#39424e",
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "xtick.color": "#39424e",
    "ytick.color": "#39424e",
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "s2r",
}


def inline_svg(figure: Figure) -> str:
    """The figure as an SVG element."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def inline_png(figure: Figure, alt: str, dpi: int = 110) -> str:
    """The figure as an ``img`` element with its data inside."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    data = base64.b64encode(stream.getvalue()).decode()
    return f'<img alt="{alt}" src="data:image/png;base64,{data}">'
