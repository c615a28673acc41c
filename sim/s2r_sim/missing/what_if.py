"""What an effect could change at all: the table of ``tests/bench/bench_left_out.py`` for the page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from s2r_protocol.exits import UsageError

KINDS = {"drawer": "drawers", "lid": "lids", "lever": "levers"}


def read_what_if(path: Path) -> list[dict[str, Any]]:
    """Rows of a result file: case, effect, shift over the change that was asked for.

    Raises:
        UsageError: It cannot be read, or is something else.
    """
    try:
        rows = json.loads(path.read_text())
        return [{key: row[key] for key in ("case", "effect", "shift_r")} for row in rows]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise UsageError(f"--what-if {path} is no result of tests/bench/bench_left_out.py: {error}") from None


def largest_shift(rows: Sequence[dict[str, Any]], effect: str, kind: str) -> float | None:
    """Largest shift of the end by an effect, in shares of the change asked for; None where there is no such row.

    Args:
        rows: As read.
        effect: Of the bench.
        kind: Key of ``KINDS``.
    """
    shifts = [abs(row["shift_r"]) for row in rows if row["effect"] == effect and kind in row["case"]]
    return max(shifts, default=None)


def what_if(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A Markdown section: the largest shift of the end per effect and kind of part."""
    effects = list(dict.fromkeys(row["effect"] for row in rows if row["effect"] != "nothing"))
    count = len({row["case"] for row in rows})
    lines = [
        "## What an effect could change at all",
        "",
        f"{count} planned and timed motions, played with the very model they were planned in plus one effect on the"
        " joint, until the part, let go, has come to rest (`tests/bench/bench_left_out.py`)."
        " Largest shift of the end, in shares of what was asked for; strengths in units of dry friction."
        " A fingertip is position control: what only asks for more force changes little."
        " What pulls harder than friction holds moves the part afterwards, and no plan of a fingertip that lets go"
        " changes that.",
        "",
        f"| effect | {' | '.join(KINDS.values())} |",
        "|---|" + "---|" * len(KINDS),
    ]
    for effect in effects:
        found = [largest_shift(rows, effect, kind) for kind in KINDS]
        cells = ["–" if shift is None else f"{100 * shift:.1f} %" for shift in found]
        lines.append(f"| {effect} | {' | '.join(cells)} |")
    return lines
