"""The paper's figures of merit over many trials, failures counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from s2r_sim.paper.miss import missed, stage_of_miss
from s2r_sim.paper.score import Row

LIMITS = (0.10, 0.30, 0.50)
RESAMPLES = 5000
UNTOLD = "not told"  # of rows written before they kept the terms of their error
PAPER = {  # Sim2Real2, Table I: n, below 10 %, below 30 %, mean |δ| [cm or °], mean |δ_r|
    "drawer": (31, 12, 22, 1.15, 0.218),
    "laptop": (32, 7, 20, 5.69, 0.273),
    "faucet": (30, 0, 9, 10.37, 0.562),
}
UNITS = {
    "drawer": ("cm", 100.0),
    "laptop": ("°", float(np.degrees(1.0))),
    "faucet": ("°", float(np.degrees(1.0))),
}


@dataclass(frozen=True)
class Merit:
    """Of one kind of object.

    Attributes:
        kind: Of object.
        n: Trials.
        done: Trials with a planned manipulation carried out.
        below: How many of all trials ended below each of ``LIMITS``; a trial without a manipulation never does.
        delta, delta_r: Means of |δ| [m or rad] and |δ_r| over ``done``; None without any.
        median_r: Median |δ_r| over ``done``.
        delta_90, delta_r_90: 90 % bootstrap intervals of the two means.
    """

    kind: str
    n: int
    done: int
    below: tuple[int, ...]
    delta: float | None
    delta_r: float | None
    median_r: float | None
    delta_90: tuple[float, float] | None
    delta_r_90: tuple[float, float] | None


@dataclass(frozen=True)
class Causes:
    """Why trials of one kind of object ended as they did, after the last manipulation.

    Attributes:
        failures: Stage that ended a trial -> how often.
        misses: Stage to which a miss is owed -> how often; see :mod:`s2r_sim.paper.miss`.
    """

    failures: dict[str, int]
    misses: dict[str, int]


def relative_errors(rows: Sequence[Row], key: str = "delta") -> np.ndarray:
    """|δ_r| of the trials that have one."""
    return np.array([abs(row[key] / row["change"]) for row in rows if row.get(key) is not None])


def merit(rows: Sequence[Row], kind: str, key: str = "delta") -> Merit:
    """Merit of one kind; ``key`` is ``delta`` (after the last manipulation) or ``delta_first``."""
    mine = [row for row in rows if row["kind"] == kind]
    errors = relative_errors(mine, key)
    absolute = np.array([abs(row[key]) for row in mine if row.get(key) is not None])
    return Merit(
        kind=kind,
        n=len(mine),
        done=len(errors),
        below=tuple(int((errors < limit).sum()) for limit in LIMITS),
        delta=float(absolute.mean()) if len(absolute) else None,
        delta_r=float(errors.mean()) if len(errors) else None,
        median_r=float(np.median(errors)) if len(errors) else None,
        delta_90=interval(absolute, "mean")[1:] if len(absolute) else None,
        delta_r_90=interval(errors, "mean")[1:] if len(errors) else None,
    )


def causes(rows: Sequence[Row], kind: str) -> Causes:
    """Why trials of one kind ended as they did."""
    mine = [row for row in rows if row["kind"] == kind]
    failures = Counter(row["stage"] for row in mine if row["stage"] is not None)
    misses = Counter(stage_of_miss(row) or UNTOLD for row in mine if missed(row))
    return Causes(dict(failures.most_common()), dict(misses))


def wilson(k: int, n: int, z: float = 1.645) -> tuple[float, float]:
    """90 % Wilson score interval of a share k of n."""
    if n == 0:
        return 0.0, 1.0
    p = k / n
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * float(np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)))
    return max(0.0, centre - half), min(1.0, centre + half)


def interval(values: np.ndarray, statistic: str) -> tuple[float, float, float]:
    """Mean or median of some values and its 90 % bootstrap interval."""
    take = {"mean": np.mean, "median": np.median}[statistic]
    drawn = take(np.random.default_rng(0).choice(values, (RESAMPLES, len(values))), axis=1)
    low, high = np.percentile(drawn, [5, 95])
    return float(take(values)), float(low), float(high)
