"""Does an explanation agree with itself? What imitates an effect rarely has the ratio of its parts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from s2r_host.gap.effects.base import Context, Shape
from s2r_host.gap.motion.session import Session
from s2r_host.gap.regression.evidence import Marginal
from s2r_host.gap.regression.nuisance import COMPARISON
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Solution, Term
from s2r_host.gap.search.search import Search

ColumnOf = Callable[[Context, Session, int, Shape, np.ndarray], np.ndarray | None]

WRONG_SHARE, CLEAR = 0.35, 1.2  # of a part; deviations, by noise three times as strong as seen
BLIND = 10.0  # deviations of this size tell nothing: weight on a joint that no gravity pulls
FAR = 5.0  # deviations of a number of the model; right names ask for 4.0 at most in the tuning sets
MAY_MOVE = (*COMPARISON, "effort_offset")


def disagreement(problem: Problem, search: Search, solution: Solution) -> str | None:
    """A sentence when a chosen effect has a part of another size than the whole says, or brings what it has not."""
    fit = ~problem.held
    base = search.marginal(solution.terms, fit, solution.noise)
    for term, theta in zip(solution.terms, solution.theta, strict=True):
        effect = search.effects[term.effect]
        for column_of, words in (
            (effect.part, f"{effect.part_is} would have to be {{:.2f}} times what the rest of {term.effect} says"),
            (effect.foreign, f"beside {term.effect}, {effect.foreign_is} would have to be {{:.2f}} times as large"),
        ):  # fmt: skip
            off, deviation = _excess(problem, base, term, theta, column_of, solution.noise)
            if abs(off) > WRONG_SHARE and CLEAR * deviation < abs(off) and deviation < BLIND:
                size = 1.0 + off if column_of == effect.part else off
                return f"{words.format(size)} (one deviation {deviation:.2f})"
    return None


def _excess(
    problem: Problem, base: Marginal, term: Term, theta: np.ndarray, column_of: ColumnOf, noise: float
) -> tuple[float, float]:
    """What a column asks for on top of the whole explanation, in its own size, and one deviation.

    Of several columns, fitted together, the one that stands out most.
    """
    fit, shape = ~problem.held, dict(term.shape)
    rows: dict[int, np.ndarray] = {}
    for s in {b.session.index: b.session for b in problem.blocks}.values():
        column = column_of(problem.ctx, s, term.joint, shape, theta)
        if column is None:
            return 0.0, 0.0
        rows[s.index] = column if column.ndim > 1 else column[:, None]
    count = next(iter(rows.values())).shape[1]
    parts = [{k: x[:, i] for k, x in rows.items()} for i in range(count)]
    whitened = np.stack([problem.whiten(part, term.joint, part)[fit] for part in parts], axis=1)
    w = base.weigh(whitened, np.zeros(count, dtype=bool), None)
    ridge = 1e-9 * np.trace(w.S) / count + 1e-30
    deviation = np.sqrt(noise * np.diag(np.linalg.inv(w.S + ridge * np.eye(count))))
    most = int(np.argmax(np.abs(w.theta) / deviation))
    return float(w.theta[most]), float(deviation[most])


def stretched(problem: Problem, solution: Solution) -> str | None:
    """A sentence when the named effects hold only with a number of the model so far off that it would be news."""
    far = [
        (abs(x) / d, p)
        for p, x, d in zip(problem.base, solution.base, problem.prior, strict=True)
        if p.name not in MAY_MOVE
    ]
    if not far:
        return None
    most, number = max(far, key=lambda x: x[0])
    if most < FAR:
        return None
    return f"{number.name} of {number.place} would have to be off by {most:.1f} times what nominal values usually are"
