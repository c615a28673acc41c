"""The same trials with other options: what a part of the system is worth, pair by pair."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from s2r_protocol.exits import UsageError
from s2r_sim.batch import jobs_in, results_in
from s2r_sim.paper.score import Row
from s2r_sim.paper.summary import interval

LIMITS = (0.10, 0.30)
MISSED = 1.0  # |δ_r| of a trial without a manipulation: the part stays where it was
LEAST = 4  # trials for an interval
FIRST, LAST = "delta_first", "delta"
WITHOUT_CORRECTION = "without correction"


@dataclass(frozen=True, eq=False)
class Pairs:
    """Trials of one kind that two campaigns hold, row by row the same trial.

    Attributes:
        kind: Of object, or "all".
        label: What is other in the second campaign.
        ours: Of the system as it is.
        changed: Of the other one.
    """

    kind: str
    label: str
    ours: list[Row]
    changed: list[Row]

    @property
    def only_last(self) -> bool:
        """Whether the two are the same up to the first manipulation by definition."""
        return self.label.startswith(WITHOUT_CORRECTION)

    def differences(self, key: str) -> np.ndarray:
        """|δ_r| of the changed system less that of the system as it is, (n,)."""
        return relative(self.changed, key) - relative(self.ours, key)


def campaign_in(results: Path) -> list[Row]:
    """All trials of a campaign, as they can be told by kind and number from those of another one.

    Raises:
        UsageError: Some were run with other numbers of manipulations: one kind and number may then be two trials.
    """
    attempts = sorted({job[2] for job in jobs_in(results)})
    if len(attempts) > 1:
        several = f"{', '.join(map(str, attempts[:-1]))} and {attempts[-1]}"
        raise UsageError(
            f"{results} holds trials with {several} attempts, which are other trials under the same numbers: move the "
            'lines of one number (the third in "job") into the results.jsonl of another folder, and compare one of the '
            "two"
        )
    return results_in(results)


def pairs_of(rows: Sequence[Row], others: Sequence[Row], label: str, kinds: Sequence[str]) -> list[Pairs]:
    """One per kind that has trials in both campaigns, and one of them all where there are several."""
    found = []
    for kind in kinds:
        mine, theirs = _by_number(rows, kind), _by_number(others, kind)
        shared = sorted(mine.keys() & theirs.keys())
        if shared:
            found.append(Pairs(kind, label, [mine[k] for k in shared], [theirs[k] for k in shared]))
    if len(found) > 1:
        ours, changed = ([row for one in found for row in getattr(one, side)] for side in ("ours", "changed"))
        found.append(Pairs("all", label, ours, changed))
    return found


def uncorrected(rows: Sequence[Row], kinds: Sequence[str], name: str) -> list[Pairs]:
    """A campaign, of some name, against its own first manipulations: what correcting is worth."""
    alone = [{**row, LAST: row.get(FIRST)} for row in rows]
    return pairs_of(rows, alone, f"{WITHOUT_CORRECTION} ({name})", kinds)


def ablations(rows: Sequence[Row], kinds: Sequence[str], others: Mapping[str, Sequence[Row]]) -> list[str]:
    """Markdown tables: after the first manipulation and after the last, and what a trial costs.

    Args:
        rows: Of the campaign as it is.
        kinds: Of objects.
        others: Campaigns with other options, by label.
    """
    return tables([pairs_of(rows, other, label, kinds) for label, other in others.items()])


def tables(comparisons: Sequence[Sequence[Pairs]]) -> list[str]:
    """The tables for several option sets, each with its pairs by kind."""
    told = [pairs for pairs in comparisons if not pairs[0].only_last]
    return [
        "Cells with an arrow: the system as it is → with the option set, on the trials that both campaigns hold. "
        "|δ_r| of a trial without a manipulation counts as 100 %. "
        "Differences are paired, trial by trial, with a 90 % bootstrap interval; positive: worse than the system as it "
        "is.",
        "",
        "**After the first manipulation**",
        "",
        *_errors_table(told, FIRST),
        "",
        "**After the last manipulation**",
        "",
        *_errors_table(comparisons, LAST),
        "",
        "**What a trial costs**",
        "",
        "Medians of wall time, of processor time and of its paired ratio; means of manipulations and pushes.",
        "",
        *_costs_table(told),
    ]


def relative(rows: Sequence[Row], key: str) -> np.ndarray:
    """|δ_r| after the first or the last manipulation, (n,); ``MISSED`` where there was none."""
    return np.array([MISSED if row.get(key) is None else abs(row[key] / row["change"]) for row in rows])


def _by_number(rows: Sequence[Row], kind: str) -> dict[int, Row]:
    return {row["number"]: row for row in rows if row["kind"] == kind}


def _errors_table(comparisons: Sequence[Sequence[Pairs]], key: str) -> list[str]:
    lines = [
        "| option set | object | n | below 10 % | below 30 % | mean \\|δ_r\\| | median \\|δ_r\\| | "
        "mean of the differences | median of the differences |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for pairs in comparisons:
        for one in pairs:
            ours, changed = relative(one.ours, key), relative(one.changed, key)
            cells = [f"{(ours < limit).sum()} → {(changed < limit).sum()}" for limit in LIMITS]
            cells += [
                f"{100 * take(ours):.1f} → {100 * take(changed):.1f} %" for take in (np.mean, np.median)
            ]
            cells += [_told(changed - ours, statistic) for statistic in ("mean", "median")]
            lines.append(f"| {one.label} | {one.kind} | {len(ours)} | {' | '.join(cells)} |")
    return lines


def _told(differences: np.ndarray, statistic: str) -> str:
    middle, low, high = (100 * value for value in interval(differences, statistic))
    if len(differences) < LEAST:
        return f"{middle:+.1f} %"
    return f"{middle:+.1f} % ({low:+.1f} to {high:+.1f})"


def _costs_table(comparisons: Sequence[Sequence[Pairs]]) -> list[str]:
    lines = [
        "| option set | object | n | wall [s] | processor time [s] | its paired ratio | manipulations | pushes |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for pairs in comparisons:
        for one in pairs:
            cells = [_both(one, key, np.median, 0) for key in ("wall_s", "cpu_s")]
            ratio = _column(one.changed, "cpu_s") / _column(one.ours, "cpu_s")
            cells.append("–" if np.isnan(ratio).any() else f"{np.median(ratio):.2f} ×")
            cells += [_both(one, key, np.mean, 1) for key in ("manipulations", "pushes")]
            lines.append(f"| {one.label} | {one.kind} | {len(one.ours)} | {' | '.join(cells)} |")
    return lines


def _column(rows: Sequence[Row], key: str) -> np.ndarray:
    return np.array([np.nan if row.get(key) is None else row[key] for row in rows], dtype=float)


def _both(one: Pairs, key: str, take: Callable[[np.ndarray], Any], digits: int) -> str:
    columns = (_column(rows, key) for rows in (one.ours, one.changed))
    return " → ".join("–" if np.isnan(a).any() else f"{take(a):.{digits}f}" for a in columns)
