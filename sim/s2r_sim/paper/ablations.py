"""The same trials with other options: what a part of the system is worth, pair by pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from s2r_sim.paper.score import Row
from s2r_sim.paper.summary import wilson

LIMIT = 0.10
RESAMPLES = 2000


def ablations(rows: Sequence[Row], kinds: Sequence[str], others: Mapping[str, Sequence[Row]]) -> list[str]:
    """A Markdown table: only trials that both campaigns hold are compared; a trial without a manipulation is a miss.

    Args:
        rows: Of the campaign as it is.
        kinds: Of objects.
        others: Campaigns with other options, by label.
    """
    lines = [
        "Only trials that both campaigns hold. δ_r of a trial without a manipulation counts as 100 %. "
        "The last column is the median of the paired differences of |δ_r| after the first manipulation with a 90 % "
        "bootstrap interval; positive: worse than the system as it is.",
        "",
        "| object | system | n | first below 10 % | last below 10 % | first median \\|δ_r\\| | paired difference |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind in kinds:
        mine = _by_number(rows, kind)
        for label, other in others.items():
            theirs = _by_number(other, kind)
            shared = sorted(mine.keys() & theirs.keys())
            if not shared:
                continue
            ours, changed = [mine[k] for k in shared], [theirs[k] for k in shared]
            lines.append(_line(kind, "as it is", ours, "–"))
            lines.append(_line(kind, label, changed, _paired(ours, changed)))
    return lines


def _by_number(rows: Sequence[Row], kind: str) -> dict[int, Row]:
    return {row["number"]: row for row in rows if row["kind"] == kind}


def _errors(rows: Sequence[Row], key: str) -> np.ndarray:
    return np.array([1.0 if row.get(key) is None else abs(row[key] / row["change"]) for row in rows])


def _line(kind: str, label: str, rows: Sequence[Row], difference: str) -> str:
    cells = []
    for key in ("delta_first", "delta"):
        good = int((_errors(rows, key) < LIMIT).sum())
        low, high = wilson(good, len(rows))
        cells.append(f"{good} ({100 * good / len(rows):.0f} %, 90 % in {100 * low:.0f} to {100 * high:.0f})")
    median = 100 * float(np.median(_errors(rows, "delta_first")))
    return f"| {kind} | {label} | {len(rows)} | {cells[0]} | {cells[1]} | {median:.1f} % | {difference} |"


def _paired(ours: Sequence[Row], changed: Sequence[Row]) -> str:
    difference = _errors(changed, "delta_first") - _errors(ours, "delta_first")
    rng = np.random.default_rng(0)
    drawn = np.median(rng.choice(difference, (RESAMPLES, len(difference))), axis=1)
    low, high = np.percentile(drawn, [5, 95])
    return f"{100 * np.median(difference):+.1f} % ({100 * low:+.1f} to {100 * high:+.1f})"
