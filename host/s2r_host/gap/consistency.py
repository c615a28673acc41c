"""Does an explanation agree with itself? What imitates an effect rarely has the ratio of its parts."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.problem import Problem
from s2r_host.gap.search import Search
from s2r_host.gap.solution import Solution

WRONG_SHARE, CLEAR = 0.35, 1.2  # of a part; deviations, by noise three times as strong as seen
FAR = 5.0  # deviations of a number of the model; right names ask for 4.0 at most in the tuning sets
MAY_MOVE = ("timing", "edge", "effort_offset")  # of the comparison, not of the machine


def disagreement(problem: Problem, search: Search, solution: Solution) -> str | None:
    """A sentence when a part of a chosen effect is clearly not as large as the whole effect says."""
    fit = ~problem.held
    base = search.marginal(solution.terms, fit, solution.noise)
    for term, theta in zip(solution.terms, solution.theta, strict=True):
        effect, shape = search.effects[term.effect], dict(term.shape)
        parts: dict[int, np.ndarray] = {}
        for s in {b.session.index: b.session for b in problem.blocks}.values():
            part = effect.part(problem.ctx, s, term.joint, shape, theta)
            if part is not None:
                parts[s.index] = part
        if not parts:
            continue
        column = problem.whiten(parts, term.joint, parts)[fit][:, None]
        w = base.weigh(column, np.array([False]), None)
        deviation = float(np.sqrt(solution.noise / max(float(w.S[0, 0]), 1e-30)))
        off = float(w.theta[0])
        if abs(off) > WRONG_SHARE and abs(off) > CLEAR * deviation:
            return (
                f"the weight's part of {term.effect} would have to be {1.0 + off:.2f} times what its inertia's part "
                f"says (one deviation {deviation:.2f})"
            )
    return None


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
