"""Cross-talk between two efforts: a share of one joint's effort in what is recorded of another's.

No effect of the catalogue, and along a lively motion several of them imitate it. One number does as well as they do.
"""

from __future__ import annotations

import numpy as np

from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Solution
from s2r_host.gap.search.beside_numbers import beside_numbers
from s2r_host.gap.search.search import Search

MOST_SHARE = 0.3  # of the other joint's effort
AS_WELL = 1.0  # power the share may leave, in that of the explanation, in every recording
LEAST_TAKEN = 0.5  # of what the numbers leave over without it


def cross_talk(problem: Problem, search: Search, solution: Solution) -> tuple[int, int, float] | None:
    """The joint, the other one, and the share of its effort that explains as much as the terms on the joint do."""
    efforts = [s.has_u for s in problem.ctx.sessions]
    without = search.finish([], [], []).prediction
    for joint in sorted({t.joint for t in solution.terms if t.joint >= 0}):
        blocks = [b for b in problem.blocks if b.joint == joint and len(b.picks) > 1]
        for other in problem.joints:
            if other == joint or not all(has[other] for has in efforts):
                continue
            column = problem.whiten({b.session.index: b.session.u[:, other] for b in blocks}, joint)
            left, share = beside_numbers(problem, search, [column])
            powers = [
                [float(np.mean(x[b.rows] ** 2)) for x in (left, solution.prediction, without)] for b in blocks
            ]
            as_well = all(own < AS_WELL * theirs for own, theirs, _ in powers)
            taken = all(own < LEAST_TAKEN * bare for own, _, bare in powers)
            if as_well and taken and abs(float(share[0])) < MOST_SHARE:
                return joint, other, float(share[0])
    return None
