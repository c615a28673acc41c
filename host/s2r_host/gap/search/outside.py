"""Simple causes outside the catalogue that several of its effects together imitate.

Cross-talk of two channels, drag of a fluid, an inertia that changes with the pose. Where one of them explains as much
as everything named on a joint does, the names are an imitation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from s2r_host.gap.motion.session import Session
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Solution
from s2r_host.gap.search.beside_numbers import beside_numbers
from s2r_host.gap.search.search import Search

USUAL_SHARE, MOST_SHARE = 0.3, 1.0  # of the other joint's effort
POSE_ORDERS = (
    1,
    2,
    3,
    4,
)  # times a turn: a crank or a folding arm once or twice, linkages and cams more often
NO_MORE = 1.5  # times the power that the terms leave
CLEARLY_LESS = 0.8  # the same of a cause that is not likely
LEAST_TAKEN = 0.5  # of what the numbers leave over without it


Sessions = dict[int, Session]


class Cause(NamedTuple):
    """What acts on a joint, linear in whitened columns of shape (rows, coefficients).

    The first ``ordinary`` of them are no news: the cause has to explain what they leave over.
    """

    columns: np.ndarray
    likely: Callable[[np.ndarray], bool]  # whether coefficients are what one expects
    possible: Callable[[np.ndarray], bool]  # whether they can be at all
    words: Callable[[np.ndarray], str]
    ordinary: int = 0


def outside(problem: Problem, search: Search, solution: Solution, *, strained: bool) -> str | None:
    """A sentence naming the cause outside the catalogue that explains as much as the terms on a joint, or None.

    What is not likely (a share of another effort as large as it is; drag or a changing inertia in the place of a single
    name that leaves nothing over) has to explain clearly more.

    ``strained``: the terms leave something over, or ask for numbers far from nominal ones, so that even a single one
    may be an imitation.
    """
    by_numbers = search.finish([], [], []).unexplained
    for joint in sorted({t.joint for t in solution.terms if t.joint >= 0}):
        imitated = strained or sum(t.joint == joint for t in solution.terms) > 1
        for cause in _causes(problem, joint, imitated=imitated):
            left, x = beside_numbers(problem, search, cause.columns)
            if not cause.possible(x):
                continue
            without = by_numbers
            if cause.ordinary:
                without, _ = beside_numbers(problem, search, cause.columns[:, : cause.ordinary])
            if _explains(problem, joint, left, solution.unexplained, without, likely=cause.likely(x)):
                return cause.words(x)
    return None


def _causes(problem: Problem, joint: int, *, imitated: bool) -> Iterator[Cause]:
    sessions = {b.session.index: b.session for b in problem.blocks if b.joint == joint}
    for other in problem.joints:
        if other != joint and all(s.has_u[other] for s in sessions.values()):
            yield _cross_talk(problem, sessions, joint, other)
    yield _drag(problem, sessions, joint, imitated=imitated)
    if problem.ctx.accelerates(joint) and problem.ctx.model.unit(problem.ctx.model.joints[joint]) == "rad":
        for order in POSE_ORDERS:
            yield _pose_inertia(problem, sessions, joint, order, imitated=imitated)


def _cross_talk(problem: Problem, sessions: Sessions, joint: int, other: int) -> Cause:
    here, there = (problem.ctx.model.joints[j] for j in (joint, other))
    return Cause(
        _whitened(problem, joint, {k: [s.u[:, other]] for k, s in sessions.items()}),
        likely=lambda x: abs(x[0]) < USUAL_SHARE,
        possible=lambda x: abs(x[0]) < MOST_SHARE,
        words=lambda x: (
            f"{x[0]:.1%} of the effort of '{there}' in that of '{here}' explain as much: cross-talk of two "
            "channels"
        ),
    )


def _drag(problem: Problem, sessions: Sessions, joint: int, *, imitated: bool) -> Cause:
    model = problem.ctx.model
    name = model.joints[joint]
    speeds = {k: s.v[:, joint] for k, s in sessions.items()}
    return Cause(
        _whitened(problem, joint, {k: [v * np.abs(v)] for k, v in speeds.items()}),
        likely=lambda x: imitated,
        possible=lambda x: x[0] > 0.0,
        words=lambda x: (
            f"{x[0]:.3g} {model.effort_unit(name)}·s²/{model.unit(name)}² times the square of the speed of "
            f"'{name}' explain as much: drag of a fluid"
        ),
    )


def _pose_inertia(problem: Problem, sessions: Sessions, joint: int, order: int, *, imitated: bool) -> Cause:
    """J(q) a + J'(q) v²/2 with J(q) = b + c cos nq + d sin nq on top of what the model has (Lagrange)."""
    name = problem.ctx.model.joints[joint]

    def of_pose(x: np.ndarray, q: np.ndarray) -> np.ndarray:
        return x[0] + x[1] * np.cos(order * q) + x[2] * np.sin(order * q)

    def efforts(s: Session) -> list[np.ndarray]:
        q, v, a = s.q[:, joint], s.v[:, joint], s.a[:, joint]
        c, d, half = np.cos(order * q), np.sin(order * q), 0.5 * order * v**2
        return [a, c * a - half * d, d * a + half * c]

    def words(x: np.ndarray) -> str:
        added = np.concatenate([of_pose(x, s.q[:, joint]) for s in sessions.values()])
        return (
            f"{added.min():.3g} to {added.max():.3g} kg·m² more at '{name}', by where it is, explain as much: an "
            "inertia that changes with the pose"
        )

    return Cause(
        _whitened(problem, joint, {k: efforts(s) for k, s in sessions.items()}),
        likely=lambda x: imitated,
        possible=lambda x: all(
            np.all(s.mass[:, joint] + of_pose(x, s.q[:, joint]) > 0.0) for s in sessions.values()
        ),
        words=words,
        ordinary=1,
    )


def _whitened(problem: Problem, joint: int, efforts: dict[int, list[np.ndarray]]) -> np.ndarray:
    """Columns of efforts on a joint, given per recording on its time steps."""
    count = len(next(iter(efforts.values())))
    return np.stack(
        [problem.whiten({k: e[i] for k, e in efforts.items()}, joint) for i in range(count)], axis=1
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
