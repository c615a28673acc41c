"""Small pieces of HTML and SVG the screens are made of. Everything that comes from outside is escaped here."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from html import escape

import numpy as np

INK, SOFT, LINE = "#1d242d", "#5b6675", "#e2e6eb"
GOOD, WARN, BAD, CALM = "#2f8f54", "#9a6700", "#c0264b", "#3b6fb6"
STATE_COLOURS = {
    "RUN": GOOD,
    "HOLD": CALM,
    "PAUSED": WARN,
    "STOPPING": WARN,
    "STOP1": WARN,
    "ARMING": WARN,
    "DISARMED": SOFT,
    "BOOT": SOFT,
    "FAULT": BAD,
    "ESTOP": BAD,
}
_FONT = "font-family:system-ui,'Liberation Sans',sans-serif"


def block(*parts: str) -> str:
    """A card's content with the console's type."""
    style = f"{_FONT};font-size:13.5px;line-height:1.45;color:{INK};padding:2px 10px 8px"
    return f'<div style="{style}">{"".join(parts)}</div>'


def styles() -> str:
    """Rules the page's own widgets cannot be given otherwise: a STOP that cannot be missed, its icon off the word.

    On a phone its words take two lines.
    """
    return (
        "<style>"
        'button[style*="-red-"]{height:58px!important;font-size:19px!important;font-weight:700!important}'
        'button[style*="-red-"] [data-position="left"]{margin-right:20px!important}'
        'div:has(>button[style*="-red-"]){position:sticky;top:0;z-index:10}'
        'button[style*="-red-"] .mantine-Button-label{white-space:normal;line-height:1.15}'
        "</style>"
    )


def chip(text: str, colour: str) -> str:
    """A coloured label."""
    return (
        f'<span style="background:{colour};color:#fff;border-radius:14px;padding:2px 12px;font-weight:650;'
        f'font-size:14px;letter-spacing:.02em">{escape(text)}</span>'
    )


def line(text: str, colour: str = SOFT, size_px: float = 13) -> str:
    """One line of text."""
    return f'<div style="color:{colour};font-size:{size_px}px;margin-top:4px">{escape(text)}</div>'


def facts(rows: Sequence[tuple[str, str]]) -> str:
    """Names and values in two columns."""
    cells = "".join(
        f'<div style="color:{SOFT}">{escape(name)}</div>'
        f'<div style="font-variant-numeric:tabular-nums;overflow-wrap:anywhere">{escape(value)}</div>'
        for name, value in rows
    )
    return (
        f'<div style="display:grid;grid-template-columns:112px 1fr;gap:2px 10px;margin-top:8px">{cells}</div>'
    )


def heading(text: str) -> str:
    """A small heading."""
    return f'<div style="font-weight:650;margin:12px 0 4px">{escape(text)}</div>'


def progress(share: float, colour: str = CALM) -> str:
    """A thin bar, share in [0, 1]."""
    width = 100 * min(max(share, 0.0), 1.0)
    return (
        f'<div style="background:{LINE};border-radius:4px;height:7px;margin-top:6px">'
        f'<div style="background:{colour};width:{width:.1f}%;height:7px;border-radius:4px"></div></div>'
    )


def table(header: Sequence[str], rows: Sequence[Sequence[str]], widths: str = "") -> str:
    """A table; cells are escaped. ``widths`` is a CSS grid template."""
    template = widths or " ".join(["auto"] * len(header))
    cell = f"padding:3px 0;border-bottom:1px solid {LINE};overflow-wrap:anywhere"
    parts = [f'<div style="{cell};color:{SOFT};font-weight:600">{escape(h)}</div>' for h in header]
    parts += [f'<div style="{cell}">{escape(value)}</div>' for row in rows for value in row]
    return (
        f'<div style="display:grid;grid-template-columns:{template};gap:0 10px;font-size:12.5px;'
        f'font-variant-numeric:tabular-nums">{"".join(parts)}</div>'
    )


def band(value: float, low: float, high: float, ghost: float | None = None) -> str:
    """Where a value lies in its limits: a track, its middle, a dot, and a paler mark for the reference."""
    span = high - low
    share = 0.5 if span <= 0 else min(max((value - low) / span, 0.0), 1.0)
    used = abs(2 * share - 1)
    colour = BAD if used > 0.95 else WARN if used > 0.8 else CALM
    marks = [
        _mark(0.0, "0px", 5, 6, LINE, "width:100%;border-radius:3px"),
        _mark(0.5, "0.5px", 2, 12, "#aab3bf", "width:1px"),
    ]
    if ghost is not None and span > 0:
        at = min(max((ghost - low) / span, 0.0), 1.0)
        marks.append(_mark(at, "1px", 1, 14, SOFT, "width:2px;opacity:.55"))
    marks.append(_mark(share, "5px", 3, 10, colour, "width:10px;border-radius:5px"))
    limits = f"{low:.4g} to {high:.4g}"
    return f'<div style="position:relative;height:16px" title="{limits}">{"".join(marks)}</div>'


def _mark(share: float, half: str, top_px: int, height_px: int, colour: str, more: str) -> str:
    return (
        f'<div style="position:absolute;left:calc({100 * share:.2f}% - {half});top:{top_px}px;'
        f'height:{height_px}px;background:{colour};{more}"></div>'
    )


def bars(labels: Sequence[str], values: Sequence[float], notes: Sequence[str], colours: Sequence[str]) -> str:
    """Vertical bars on a logarithmic scale of counts, from 1."""
    height, width, step = 150, 460, 460 / max(len(values), 1)
    top = max(1.0, np.log10(max([1.0, *values])))
    parts = []
    for i, (value, colour) in enumerate(zip(values, colours, strict=True)):
        h = 0.0 if value <= 0 else max(3.0, (height - 30) * np.log10(value + 1) / np.log10(10**top + 1))
        x = i * step
        parts.append(
            f'<rect x="{x + 2:.1f}" y="{height - 14 - h:.1f}" width="{step - 4:.1f}" height="{h:.1f}" rx="2" '
            f'fill="{colour}"/>'
            f'<text x="{x + step / 2:.1f}" y="{height - 3}" font-size="8.5" text-anchor="middle" fill="{SOFT}">'
            f"{escape(labels[i])}</text>"
        )
        if value > 0:
            parts.append(
                f'<text x="{x + step / 2:.1f}" y="{height - 18 - h:.1f}" font-size="8.5" text-anchor="middle" '
                f'fill="{INK}">{escape(notes[i])}</text>'
            )
    return f'<svg viewBox="0 0 {width} {height}" width="100%">{"".join(parts)}</svg>'


def heat_map(values: np.ndarray, row_names: Sequence[str], t_end_s: float, unit: str, scale: float) -> str:
    """Rows over time as coloured cells: magnitudes of ``values`` (n, rows); ``scale`` turns them into ``unit``."""
    columns = min(len(values), 120)
    edges = np.linspace(0, len(values), columns + 1).astype(int)
    cells = np.array([np.abs(values[a:b]).max(axis=0) for a, b in itertools.pairwise(edges)])
    top = max(float(cells.max()), 1e-12)
    left, row_h, width = 52, 19, 460
    step = (width - left) / columns
    parts = []
    for r, name in enumerate(row_names):
        y = r * row_h
        parts.append(f'<text x="0" y="{y + 13}" font-size="10" fill="{SOFT}">{escape(name)}</text>')
        for c in range(columns):
            parts.append(
                f'<rect x="{left + c * step:.1f}" y="{y}" width="{step + 0.4:.1f}" height="{row_h - 2}" '
                f'fill="{_heat(cells[c, r] / top)}"/>'
            )
    worst_c, worst_r = np.unravel_index(cells.argmax(), cells.shape)
    parts.append(
        f'<rect x="{left + worst_c * step - 2:.1f}" y="{worst_r * row_h - 2}" width="{step + 4:.1f}" '
        f'height="{row_h + 2}" fill="none" stroke="{INK}" stroke-width="1.4"/>'
    )
    bottom = len(row_names) * row_h
    parts.append(f'<text x="{left}" y="{bottom + 12}" font-size="10" fill="{SOFT}">0 s</text>')
    parts.append(
        f'<text x="{width}" y="{bottom + 12}" font-size="10" text-anchor="end" fill="{SOFT}">{t_end_s:.2f} s</text>'
        f'<text x="{(left + width) / 2}" y="{bottom + 12}" font-size="10" text-anchor="middle" fill="{SOFT}">'
        f"white 0, dark {scale * top:.3g} {escape(unit)}; framed: the worst</text>"
    )
    return f'<svg viewBox="0 0 {width} {bottom + 18}" width="100%">{"".join(parts)}</svg>'


def _heat(share: float) -> str:
    """White over orange to dark red."""
    stops = np.array([[250, 250, 250], [253, 208, 162], [230, 85, 13], [103, 0, 13]], float)
    at = min(max(share, 0.0), 1.0) * (len(stops) - 1)
    i = min(int(at), len(stops) - 2)
    r, g, b = (stops[i] + (at - i) * (stops[i + 1] - stops[i])).astype(int)
    return f"#{r:02x}{g:02x}{b:02x}"
