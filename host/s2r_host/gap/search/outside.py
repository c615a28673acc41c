"""Simple causes outside the catalogue that several of its effects together imitate: cross-talk, drag.

Each is one number. Where it explains as much as everything named on a joint does, the names are an imitation.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Solution
from s2r_host.gap.search.beside_numbers import beside_numbers
from s2r_host.gap.search.search import Search

USUAL_SHARE, MOST_SHARE = 0.3, 1.0  # of the other joint's effort
NO_MORE = 1.5  # times the power that the terms leave
CLEARLY_LESS = 0.8  # the same of a cause that is not likely
LEAST_TAKEN = 0.5  # of what the numbers leave over without it


class Cause(NamedTuple):
    """A whitened column, between what its size is likely and may be at all, and a sentence with the size left open."""

    column: np.ndarray
    likely: tuple[float, float]
    possible: tuple[float, float]
    words: str


def outside(problem: Problem, search: Search, solution: Solution, *, strained: bool) -> str | None:
    """A sentence naming the cause outside the catalogue that explains as much as the terms on a joint, or None.

    What is not likely (a share of another effort as large as it is; drag in the place of a single name that leaves
    nothing over) has to explain clearly more.

    ``strained``: the terms leave something over, or ask for numbers far from nominal ones, so that even a single one
    may be an imitation.
    """
    without = search.finish([], [], []).unexplained
    for joint in sorted({t.joint for t in solution.terms if t.joint >= 0}):
        for cause in _causes(problem, solution, joint, strained=strained):
            left, size = beside_numbers(problem, search, [cause.column])
            x = float(size[0])
            likely, possible = (low < x < high for low, high in (cause.likely, cause.possible))
            if possible and _explains(problem, joint, left, solution.unexplained, without, likely=likely):
                return cause.words.format(x)
    return None


def _causes(problem: Problem, solution: Solution, joint: int, *, strained: bool) -> Iterator[Cause]:
    model, blocks = problem.ctx.model, [b for b in problem.blocks if b.joint == joint]
    name = model.joints[joint]
    for other in problem.joints:
        if other != joint and all(b.session.has_u[other] for b in blocks):
            efforts = {b.session.index: b.session.u[:, other] for b in blocks}
            yield Cause(
                problem.whiten(efforts, joint),
                (-USUAL_SHARE, USUAL_SHARE),
                (-MOST_SHARE, MOST_SHARE),
                f"{{:.1%}} of the effort of '{model.joints[other]}' in that of '{name}' explain as much: cross-talk of "
                "two channels",
            )
    likely = strained or sum(t.joint == joint for t in solution.terms) > 1
    speeds = {b.session.index: b.session.v[:, joint] for b in blocks}
    unit, effort = model.unit(name), model.effort_unit(name)
    yield Cause(
        problem.whiten({k: v * np.abs(v) for k, v in speeds.items()}, joint),
        (0.0, np.inf if likely else 0.0),
        (0.0, np.inf),
        f"{{:.3g}} {effort}·s²/{unit}² times the square of the speed of '{name}' explain as much: drag of a fluid",
    )


def _explains(
    problem: Problem, joint: int, left: np.ndarray, by_terms: np.ndarray, without: np.ndarray, *, likely: bool
) -> bool:
    """Does a cause leave no more than the terms on a joint do, and a good part less than none, in every recording?

    Below a measured floor all is noise. A guessed one may be too high, and what the terms leave tells better. What is
    not ``likely`` leaves clearly less.
    """
    measured = problem.floor_source == "repeat"
    blocks = [b for b in problem.blocks if b.joint == joint and len(b.picks) > 1]
    for b in blocks:
        every = np.ones_like(b.held)
        own, theirs, bare = (problem.rms(x, b, every) ** 2 for x in (left, by_terms, without))
        enough = max(theirs, problem.floor[joint] ** 2) if measured else NO_MORE * theirs
        if not likely:
            enough = CLEARLY_LESS * theirs
        if own > enough or own > LEAST_TAKEN * bare:
            return False
    return bool(blocks)
