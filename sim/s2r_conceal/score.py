"""From case scores to the table: rates with their counts, calibration of probabilities, coverage of intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from s2r_conceal.score_case import CaseScore

STRENGTH_BINS = (("weak, 1.5 ×", 0.0, 2.5), ("clear, 3 ×", 2.5, 6.5), ("strong, 10 ×", 6.5, np.inf))


@dataclass(frozen=True)
class Line:
    """One line of the table: a rate or a statistic, over how many cases, and the goal it is held against.

    ``interval`` is the 95 % interval of a rate after Wilson (1927), None for a statistic.
    """

    name: str
    value: float | None
    count: int
    goal: str = ""
    interval: tuple[float, float] | None = None


def wilson(rate: float, count: int, z: float = 1.96) -> tuple[float, float]:
    """Interval of a rate seen in ``count`` cases: Wilson, J. Am. Stat. Assoc. 22 (1927), 209-212."""
    centre = (rate + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * float(np.sqrt(rate * (1 - rate) / count + z**2 / (4 * count**2)))
    return max(0.0, centre - half), min(1.0, centre + half)


def table(scores: Sequence[CaseScore]) -> list[Line]:
    """All lines of the result table."""
    single = [s for s in scores if s.group == "single"]
    known = [s for s in single if s.strength is not None and s.strength >= 3.0]
    clean = [s for s in scores if s.group == "clean"]
    unknown = [s for s in scores if s.group == "unknown"]
    return [
        *_strength_lines(single),
        _rate("single ≥ 3 ×: first name right", known, lambda s: s.top1, "≥ 0.92"),
        _rate("single ≥ 3 ×: first name right or in its class", known, lambda s: s.top1_or_class),
        _rate("single ≥ 3 ×: set of at most 2 holds it", known, _small_set, "≥ 0.99"),
        _mean("single ≥ 3 ×: size of the set", known, lambda s: s.set_size),
        _rate("single ≥ 3 ×: joint right", known, lambda s: s.joint_right, "≥ 0.98"),
        _median("single ≥ 3 ×: regime overlap, median", known, lambda s: s.iou, "≥ 0.70"),
        _rate("clean: false alarms", clean, lambda s: s.false_alarm, "≤ 0.01"),
        *(
            _rate(
                f"clean, {v}: right verdict", [s for s in clean if s.variant == v], lambda s: s.right_verdict
            )
            for v in ("plain", "parameter_off", "in_model")
        ),
        _rate("unknown: wrong name", unknown, lambda s: s.wrong_name, "≤ 0.03"),
        _rate("unknown: called unknown", unknown, lambda s: s.right_verdict),
        _rate("unknown: place right", unknown, lambda s: s.joint_right, "≥ 0.90"),
        _rate("pairs: both named", _group(scores, "pairs"), lambda s: s.all_named_exactly, "≥ 0.85"),
        _rate("pairs: both named or in their classes", _group(scores, "pairs"), lambda s: s.all_named),
        _mean("pairs: invented names per case", _group(scores, "pairs"), lambda s: s.extra),
        _rate("triples: all named", _group(scores, "triples"), lambda s: s.all_named_exactly, "≥ 0.60"),
        _rate("triples: all named or in their classes", _group(scores, "triples"), lambda s: s.all_named),
        _rate(
            "masked, effort kept: first name right", _variant(scores, "high_gain"), lambda s: s.top1, "≥ 0.90"
        ),
        _rate(
            "masked, no effort: right verdict",
            _variant(scores, "no_effort"),
            lambda s: s.right_verdict,
            "≥ 0.95",
        ),
        _rate(
            "masked, no effort, positions tell: first name right",
            [s for s in _variant(scores, "no_effort") if s.expected[:1] == ("physics_missing",)],
            lambda s: s.top1,
        ),
        _rate("insufficient: right verdict", _group(scores, "insufficient"), lambda s: s.right_verdict),
        _rate("wrong log: refused", _group(scores, "wrong_log"), lambda s: s.right_verdict),
        _median("oracle ratio, median", scores, lambda s: s.oracle_ratio, "≥ 0.95"),
        _percentile("oracle ratio, 10th percentile", scores, lambda s: s.oracle_ratio, 10.0, "≥ 0.80"),
        coverage(scores),
        _parameter_error(scores),
        calibration_error("calibration error of every stated first name", every_stated(scores), "≤ 0.05"),
        calibration_error("calibration error where a catalogue effect is to be named", where_asked(scores)),
        _median("wall time, median [s]", scores, lambda s: s.wall_s, "≤ 60 (one joint)"),
        _percentile("wall time, 95th percentile [s]", scores, lambda s: s.wall_s, 95.0),
        _rate("no answer at all", list(scores), lambda s: s.answered == "none", "0"),
    ]


def _strength_lines(single: list[CaseScore]) -> list[Line]:
    return [
        _rate(
            f"single, {words}: first name right",
            [s for s in single if s.strength is not None and low <= s.strength < high],
            lambda s: s.top1,
        )
        for words, low, high in STRENGTH_BINS
    ]


def _small_set(s: CaseScore) -> bool | None:
    return None if s.in_set is None else s.in_set and (s.set_size or 0) <= 2


def _group(scores: Sequence[CaseScore], group: str) -> list[CaseScore]:
    return [s for s in scores if s.group == group]


def _variant(scores: Sequence[CaseScore], variant: str) -> list[CaseScore]:
    return [s for s in scores if s.group == "masked" and s.variant == variant]


Measure = Callable[[CaseScore], float | bool | None]


def _values(scores: Iterable[CaseScore], measure: Measure) -> np.ndarray:
    return np.array([float(v) for s in scores if (v := measure(s)) is not None])


def _statistic(values: np.ndarray, f: Callable[[np.ndarray], float]) -> float | None:
    return float(f(values)) if values.size else None


def _rate(name: str, scores: Iterable[CaseScore], measure: Measure, goal: str = "") -> Line:
    line = _mean(name, scores, measure, goal)
    return line if line.value is None else replace(line, interval=wilson(line.value, line.count))


def _mean(name: str, scores: Iterable[CaseScore], measure: Measure, goal: str = "") -> Line:
    values = _values(scores, measure)
    return Line(name, _statistic(values, np.mean), values.size, goal)


def _median(name: str, scores: Iterable[CaseScore], measure: Measure, goal: str = "") -> Line:
    values = _values(scores, measure)
    return Line(name, _statistic(values, np.median), values.size, goal)


def _percentile(
    name: str, scores: Iterable[CaseScore], measure: Measure, percent: float, goal: str = ""
) -> Line:
    values = _values(scores, measure)
    return Line(name, _statistic(values, lambda v: float(np.percentile(v, percent))), values.size, goal)


def coverage(scores: Sequence[CaseScore]) -> Line:
    """Share of stated 90 % intervals that hold the true value."""
    inside = np.array([i.inside for s in scores for i in s.intervals], float)
    return Line("90 % intervals hold the truth", _statistic(inside, np.mean), inside.size, "0.85 to 0.95")


def _parameter_error(scores: Sequence[CaseScore]) -> Line:
    errors = np.array([i.relative_error for s in scores for i in s.intervals], float)
    return Line("relative parameter error, median", _statistic(errors, np.median), errors.size, "≤ 0.05")


Stated = list[tuple[float, bool]]  # probability of a first name, and whether naming it was right


def every_stated(scores: Sequence[CaseScore]) -> Stated:
    """Every first name that came with a probability: where nothing is to be named it is wrong."""
    return [
        (s.probability, s.name_right)
        for s in scores
        if s.probability is not None and s.name_right is not None
    ]


def where_asked(scores: Sequence[CaseScore]) -> Stated:
    """First names in cases that hide an effect of the catalogue which can be seen."""
    return [(s.probability, s.top1) for s in scores if s.probability is not None and s.top1 is not None]


def reliability(stated: Stated, bins: int = 10) -> list[tuple[float, float, int]]:
    """(mean stated probability, share right, count) per equal-width bin that holds a case."""
    if not stated:
        return []
    pairs = np.array(stated, float)
    which = np.minimum((pairs[:, 0] * bins).astype(int), bins - 1)
    return [
        (float(pairs[which == b, 0].mean()), float(pairs[which == b, 1].mean()), int((which == b).sum()))
        for b in range(bins)
        if (which == b).any()
    ]


def calibration_error(name: str, stated: Stated, goal: str = "") -> Line:
    """Expected calibration error: mean over names of |stated − observed| per bin (Naeini et al., AAAI 2015)."""
    found = reliability(stated)
    total = sum(n for _, _, n in found)
    value = sum(n * abs(p - right) for p, right, n in found) / total if total else None
    return Line(name, value, total, goal)


def confusion(scores: Sequence[CaseScore]) -> dict[str, dict[str, int]]:
    """True name (or kind of clean case) → what was answered first → count, for all cases."""
    counts: dict[str, dict[str, int]] = {}
    for s in scores:
        true = (
            " + ".join(s.truth_names)
            if s.group in ("single", "masked", "unknown")
            else f"[{s.group}] {s.variant}"
        )
        said = s.named[0] if s.named else f"[{s.answered}]"
        row = counts.setdefault(true, {})
        row[said] = row.get(said, 0) + 1
    return counts
