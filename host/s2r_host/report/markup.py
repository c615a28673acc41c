"""The few pieces of HTML all reports share: one page, sections, tables. No script, no network."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

CSS = """
:root { color-scheme: light; --ink: #1d242d; --soft: #5b6675; --line: #e2e6eb; --good: #2f8f54; --bad: #c0264b; }
* { box-sizing: border-box; }
body { margin: 0; background: #f4f6f8; color: var(--ink); font: 15px/1.5 system-ui, "Segoe UI", sans-serif; }
main { max-width: 1180px; margin: 0 auto; padding: 28px 20px 60px; }
h1 { font-size: 24px; margin: 0 0 4px; } h2 { font-size: 17px; margin: 0 0 10px; }
section { background: #fff; border: 1px solid var(--line); border-radius: 10px; padding: 18px 20px; margin-top: 16px; }
.lead { color: var(--soft); margin: 0; }
.badge { display: inline-block; padding: 1px 10px; border-radius: 20px; color: #fff; font-size: 13px; }
.good { background: var(--good); } .bad { background: var(--bad); }
.numbers { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 12px; margin-top: 16px; }
.number { background: #fff; border: 1px solid var(--line); border-radius: 10px; padding: 12px 14px; }
.number b { display: block; font-size: 20px; white-space: nowrap; font-variant-numeric: tabular-nums; }
.number span { color: var(--soft); font-size: 13px; }
table { border-collapse: collapse; width: 100%; font-size: 14px; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 5px 10px 5px 0; border-bottom: 1px solid var(--line); vertical-align: top; }
th { color: var(--soft); font-weight: 600; } td.r, th.r { text-align: right; }
td.mono { font-family: ui-monospace, Menlo, Consolas, monospace; font-size: 12.5px; word-break: break-all; }
img, svg { max-width: 100%; height: auto; display: block; }
.warn { border-left: 4px solid #d99a1b; padding-left: 12px; margin: 6px 0; }
.note { color: var(--soft); font-size: 13.5px; }
.scroll { overflow-x: auto; }
@media screen and (max-width: 1000px) {
  section { overflow-x: auto; } section > h2, section > p, section > h3 { position: sticky; left: 0; }
  section svg, section img { width: 940px; max-width: none; }  /* readable, and swiped */
}
@media screen and (max-width: 700px) { main { padding: 18px 10px 40px; } section { padding: 14px 12px; } }
@media print {
  body { background: none; } main { padding: 0; } h2, h3 { break-after: avoid; } tr { break-inside: avoid; }
}
"""


def page(title: str, parts: Sequence[str]) -> str:
    """A whole HTML document; empty parts are left out."""
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{CSS}</style></head>'
        f"<body><main>{''.join(part for part in parts if part)}</main></body></html>\n"
    )


def section(title: str, body: str) -> str:
    """A titled box; the body is HTML already."""
    return f"<section><h2>{escape(title)}</h2>{body}</section>"


def table(header: tuple[str, ...], rows: list[tuple[str, ...]], mono: bool = False) -> str:
    """A table; a header of empty strings is left out, ``mono`` is for hashes and paths."""
    kind = ' class="mono"' if mono else ""
    head = (
        "" if not any(header) else "<tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in header) + "</tr>"
    )
    body = "".join(
        "<tr>"
        + f"<td>{escape(row[0])}</td>"
        + "".join(f"<td{kind}>{escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for row in rows
    )
    return f'<div class="scroll"><table>{head}{body}</table></div>'
