"""Figures from samples: pure functions.

Wake-up lateness is judged against a reference thread that ran on the same core at the same time, because on a shared
machine the absolute tail belongs to the machine, not to the loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LATE_SHARE = 0.25  # of a period: how late the reference must be to explain a missed cycle


@dataclass(frozen=True)
class Lateness:
    """Wake-up lateness of one loop [µs]; a late wake-up counts once, the periods it overran are ``missed``."""

    wakes: int
    missed: int
    p50_us: float
    p99_us: float
    p999_us: float
    p9999_us: float
    max_us: float


def lateness(deadline_ns: np.ndarray, woke_ns: np.ndarray, period_ns: int) -> Lateness:
    """Figures of one loop.

    Args:
        deadline_ns, woke_ns: Of every wake-up, shape (wakes,).
        period_ns: Of the loop.
    """
    late_us = (woke_ns - deadline_ns) * 1e-3
    p50, p99, p999, p9999 = map(float, np.percentile(late_us, [50.0, 99.0, 99.9, 99.99]))
    missed = int(((woke_ns - deadline_ns) // period_ns).sum())
    return Lateness(len(late_us), missed, p50, p99, p999, p9999, float(late_us.max()))


def unexplained(
    deadline_ns: np.ndarray,
    woke_ns: np.ndarray,
    reference_deadline_ns: np.ndarray,
    reference_woke_ns: np.ndarray,
    period_ns: int,
) -> int:
    """Missed cycles of a loop during which the reference was not late: nothing but the loop explains them.

    Args:
        deadline_ns, woke_ns: Of the loop, shape (wakes,), rising.
        reference_deadline_ns, reference_woke_ns: Of the reference, shape (reference wakes,), rising.
        period_ns: Of both.
    """
    slow = reference_woke_ns - reference_deadline_ns > LATE_SHARE * period_ns
    begins, ends = reference_deadline_ns[slow], reference_woke_ns[slow]
    lost = (woke_ns - deadline_ns) // period_ns
    count = 0
    for i in np.flatnonzero(lost):
        overlaps = (begins < woke_ns[i]) & (ends > deadline_ns[i])
        count += 0 if overlaps.any() else int(lost[i])
    return count


def wakes_of(records: np.ndarray, period_ns: int) -> tuple[np.ndarray, np.ndarray]:
    """Deadlines and wake-ups of s2r-rt from its cycle records (tick, stamp_ns, lateness_ns).

    After lost ticks the core counts its lateness from the newest deadline; here it counts from the first one missed,
    as the reference does.
    """
    ticks, woke = records["tick"].astype(np.int64), records["stamp_ns"].astype(np.int64)
    skipped = np.diff(ticks, prepend=ticks[0] - 1) - 1
    return woke - records["lateness_ns"].astype(np.int64) - skipped * period_ns, woke


@dataclass(frozen=True)
class StopAfterKill:
    """The stop on the path after the front end was killed.

    Attributes:
        planned_s: The ramp that admission had found for that segment.
        taken_s: From the first tick of the stop to rest.
        jerk_share: Largest jerk over its limit.
    """

    planned_s: float
    taken_s: float
    jerk_share: float

    @property
    def ratio(self) -> float:
        """Taken over planned."""
        return self.taken_s / self.planned_s


def stop_after_kill(
    records: np.ndarray,
    stopping: int,
    knots_t: np.ndarray,
    stop_duration: np.ndarray,
    dddq_max: np.ndarray,
    period_s: float,
) -> StopAfterKill | None:
    """Read the first stop in the records; None if there is none, or it was not alone in motion.

    Args:
        records: With tick, state, plan_t and ddq_ref.
        stopping: Number of the state STOPPING.
        knots_t: Of the plan [s], shape (n,).
        stop_duration: Per segment [s], shape (n - 1,).
        dddq_max: Limits [rad/s³], shape (dof,).
        period_s: Of the loop.
    """
    rows = np.flatnonzero(records["state"] == stopping)
    if not len(rows):
        return None
    first, last = int(rows[0]), int(rows[0] + np.argmin(np.diff(rows, append=rows[-1] + 2) == 1))
    segment = int(
        np.clip(
            np.searchsorted(knots_t, records["plan_t"][first], side="right") - 1, 0, len(stop_duration) - 1
        )
    )
    ticks = int(records["tick"][last]) - int(records["tick"][first]) + 1
    window = records[max(first - 1, 0) : last + 2]
    steps = np.diff(window["tick"].astype(np.int64))[:, None] * period_s
    jerk = np.diff(window["ddq_ref"], axis=0)[:, : len(dddq_max)] / steps
    share = float((np.abs(jerk) / dddq_max).max()) if len(jerk) else 0.0
    return StopAfterKill(float(stop_duration[segment]), ticks * period_s, share)


def ratios(loop: Lateness, reference: Lateness) -> dict[str, float]:
    """p50, p99, p99.9 and maximum of the loop over the reference's."""
    names = ("p50_us", "p99_us", "p999_us", "max_us")
    return {name.removesuffix("_us"): getattr(loop, name) / getattr(reference, name) for name in names}


def median_of(slices: list[dict[str, float]]) -> dict[str, float]:
    """Median of each figure over slices that all have it."""
    return {name: float(np.median([one[name] for one in slices])) for name in slices[0]}
