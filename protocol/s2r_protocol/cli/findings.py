"""Findings as a table on the terminal."""

from __future__ import annotations

from collections.abc import Iterable

from s2r_protocol.machine import Finding, Level

_PIPE_COLUMNS = 160
_COLOURS = {Level.OK: "green", Level.NOTE: "yellow", Level.PROBLEM: "red"}


def print_findings(findings: Iterable[Finding]) -> None:
    """Level, topic, what was found, what to do."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for column in ("", "topic", "finding", "what to do"):
        table.add_column(column, overflow="fold")
    for f in findings:
        table.add_row(f"[{_COLOURS[f.level]}]{f.level}[/]", f.topic, escape(f.text), escape(f.fix))
    # A pipe has no width; a narrow guess would break every path in two.
    console = Console()
    (console if console.is_terminal else Console(width=_PIPE_COLUMNS)).print(table)
