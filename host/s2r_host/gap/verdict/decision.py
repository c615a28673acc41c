"""A verdict with everything behind it, and what an explanation leaves over."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from s2r_host.gap.motion.kinematics import Contradiction
from s2r_host.gap.motion.law import LawFinding
from s2r_host.gap.motion.session import Session
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Solution
from s2r_host.gap.regression.strokes import left_over, together
from s2r_host.gap.search.break_away import BreakAway
from s2r_host.gap.search.bursts import Bursts
from s2r_host.gap.search.search import Search
from s2r_host.gap.verdict.naming import Named

LEFTOVER_LIMIT = 1.45
EXPLAINED_CLOSE, EXPLAINED_SLOPE, EXPLAINED_FAR = 0.6, 0.25, 0.88
EXPLAINED_GUESSED = 0.5
SLOW_S, SLOW_DOUBT = 0.011, 1.3


@dataclass
class Decision:
    """Verdict with everything behind it."""

    verdict: str
    solution: Solution
    effects: list[Named] = field(default_factory=list)
    parameters_off: list[dict] = field(default_factory=list)
    rejected: list[dict] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    leftover: float = 0.0
    explained: float = 0.0
    law: list[LawFinding] = field(default_factory=list)
    contradictions: list[Contradiction] = field(default_factory=list)
    touched: Bursts | BreakAway | Lasting | None = None


@dataclass(frozen=True)
class Lasting:
    """A force of one joint that is told from noise by what it is, and at no time more than at another.

    Attributes:
        joint: Joint index.
        intervals: From the first to the last stamp of a recording [s].
        words: What kind of force it is.
    """

    joint: int
    intervals: list[list[float]]
    words: str

    @classmethod
    def along(cls, s: Session, joint: int, words: str) -> Lasting:
        """A force that is there throughout a recording."""
        return cls(joint, [[round(float(s.rec.start_s + t), 3) for t in (s.t[0], s.t[-1])]], words)


def too_much_left(problem: Problem, search: Search, decision: Decision) -> bool:
    """Does the best explanation leave so much that its name would be a guess?

    So it does where the leftover stands above the floor, or comes back in the second run and hence is no noise.
    """
    above = decision.leftover > LEFTOVER_LIMIT * doubt(problem)
    if not above and not search.comes_back(decision.solution.terms):
        return False
    least = explained_least_of(problem, search, decision.solution, decision.leftover)
    return decision.explained < (least if above else min(least, EXPLAINED_CLOSE))


def doubt(problem: Problem) -> float:
    """How far the floor may be too low; what happens between the rows of a slow log differs from run to run."""
    slow = any(s.rec.as_read.dt > SLOW_S for s in problem.ctx.sessions)
    return problem.floor_doubt * (SLOW_DOUBT if slow else 1.0)


def explained_least_of(problem: Problem, search: Search, solution: Solution, left: float) -> float:
    """Below this share the answer is 'unknown'.

    The share asked for rises with what is left over; it is lower when the floor is a guess or an effect is chaotic.
    """
    bar = EXPLAINED_GUESSED
    if problem.floor_source == "repeat":
        beyond = left / problem.floor_doubt - LEFTOVER_LIMIT
        bar = float(np.clip(EXPLAINED_CLOSE + EXPLAINED_SLOPE * beyond, EXPLAINED_CLOSE, EXPLAINED_FAR))
    # Several effects together imitate almost anything; what completed an arm's description was not searched for.
    bar = 1.0 - (1.0 - bar) / max(len(solution.terms) - search.completed, 1)
    return min([bar, *(search.effects[t.effect].explained_least for t in solution.terms)])


def leftover(problem: Problem, rows: np.ndarray, *, held: bool = True) -> float:
    """Largest ratio of a block's leftover rms to its floor; of the rows held out when there are any and it is asked."""
    worst = 0.0
    for blocks in together(problem):
        left = left_over(problem, rows, blocks, held=True) if held else None
        left = left_over(problem, rows, blocks, held=False) if left is None else left
        worst = max(worst, left or 0.0)
    return worst


def explained(problem: Problem, search: Search, solution: Solution) -> float:
    """Share of the gap above the floor that the solution removes on held-out rows.

    The gap is what small changes of base parameters leave over: a wrong mass is no merit of an effect.
    """
    return _removed(problem, search.finish([], [], []).unexplained, solution.unexplained)


def explained_by_numbers(problem: Problem, solution: Solution) -> float:
    """The same of effects that are no more than numbers of the model: they are not weighed against its moving a little.

    Their gap is what the model as it stands leaves over.
    """
    return _removed(problem, problem.raw, solution.unexplained)


def _removed(problem: Problem, was: np.ndarray, now: np.ndarray) -> float:
    """Share by which what is left above the floor falls from some leftover rows to others."""
    before = after = 0.0
    for blocks in together(problem):
        held = any(b.held.any() for b in blocks)
        first, second = (left_over(problem, x, blocks, held=held) or 0.0 for x in (was, now))
        count = len(blocks)
        before += count * max(0.0, first**2 - 1.0)
        after += count * max(0.0, second**2 - 1.0)
    return 1.0 - after / before if before > 0 else 0.0
