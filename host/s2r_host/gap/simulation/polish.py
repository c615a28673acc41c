"""Coefficients refitted on where the motion ends up, and the friction change of a new session read from its start.

The regression on efforts weighs every instant alike; an open-loop simulation adds up what is left over, so that a
hundredth of a newton, always the same, becomes millimetres. For one joint that nothing pulls back, the position error
of the simulation is to first order the leftover effort passed through the joint's own admittance 1 / (M s^2 + b s)
(Ljung, System Identification (1999), section 3.2: prediction over a long horizon is a filter on the equation error).
The named structure stays; its numbers are fitted once more in that measure.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from s2r_host.gap.motion.rest import stillness
from s2r_host.gap.motion.session import Session, nominal_friction
from s2r_host.gap.regression.friction_seen import friction_levels
from s2r_host.gap.regression.nuisance import COMPARISON
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.rows import HOLDOUT_SHARE, compare
from s2r_host.gap.regression.solution import Solution, Term
from s2r_host.gap.search.search import Search

WINDOW_S = 8.0
EFFECTIVE_S = 0.5  # integrated errors are smooth: one independent sample in this time
PULL_SHARE = 0.05
STEPS = 5
CLOSE = 0.1  # error of the simulated motion, in spans of it, up to which its derivative is worth something
CHANGE_PRIOR = 0.1
FRICTION_EFFECTS = (
    "coulomb_friction",
    "viscous_friction",
    "stribeck",
    "presliding",
    "asymmetric_friction",
    "load_dependent_friction",
)
FRICTION_BASE = ("frictionloss", "damping")


def drifts_freely(problem: Problem) -> bool:
    """Is this one joint whose position nothing in the model pulls back?"""
    if len(problem.ctx.model.joints) != 1 or problem.joints != [0]:
        return False
    for s in problem.ctx.sessions:
        X = np.stack([np.ones(len(s.t)), s.q[:, 0], s.v[:, 0], s.a[:, 0]], axis=1)
        pull = float(np.linalg.lstsq(X, s.load[:, 0], rcond=None)[0][1])
        if abs(pull) * float(np.ptp(s.q[:, 0])) > PULL_SHARE * float(np.std(s.u[:, 0])):
            return False
    return True


def polish(
    problem: Problem, search: Search, solution: Solution, hold: list[Session],
    miss: Callable[[Solution, Session, int, int], np.ndarray],
) -> Solution:  # fmt: skip
    """The solution with its linear coefficients refitted on the simulated motion of the fit rows.

    Gauss-Newton with the admittance as derivative; a step that does not help is halved, and the last one undone. A
    simulation that misses the motion by a tenth of its span is left alone.

    Args:
        problem: One joint that drifts freely, see :func:`drifts_freely`.
        search: Source of the columns.
        solution: What was found from efforts; its terms and shapes stay.
        hold: Held-out sessions; without any, the last part of each fit session is held out.
        miss: Simulated minus measured position of a solution over samples of a session [rad or m], shape (time,).
    """
    stretches = [x for s in problem.ctx.sessions for x in _stretches(s, hold)]
    if not stretches:
        return solution
    free = np.array([p.name not in COMPARISON for p in problem.base] + [True] * sum(map(len, solution.theta)))
    prior = np.concatenate([problem.prior, *[search.matrix(t)[3] for t in solution.terms]])[free]
    A = []
    for s, rows in stretches:
        X, _ = design(problem, search, solution.terms, s)
        A.append(integrated(X[rows], problem, s, rows)[:, free])
    A = np.concatenate(A)

    def missed(x: Solution) -> np.ndarray:
        return np.nan_to_num(np.concatenate([miss(x, s, r.start, r.stop) for s, r in stretches]), nan=10.0)

    best, e = solution, missed(solution)
    if float(np.sqrt(np.mean(e**2))) > CLOSE * max(float(np.ptp(s.q[:, 0])) for s, _ in stretches):
        return solution  # a derivative says nothing so far away
    gain = 1.0
    for _ in range(STEPS):
        scale = float(np.mean(e**2)) * EFFECTIVE_S / problem.ctx.sessions[0].dt
        start = np.concatenate([best.base, *best.theta])[free]
        pull = np.where(
            np.arange(len(free))[free] < len(problem.base), -start, 0.0
        )  # priors of base are at nominal
        H = A.T @ A / scale + np.diag(prior**-2.0)
        step = np.zeros(len(free))
        step[free] = gain * np.linalg.solve(H, A.T @ e / scale + pull * prior**-2.0)
        trial = _moved(best, step)
        e_trial = missed(trial)
        if np.mean(e_trial**2) < np.mean(e**2):
            best, e, gain = trial, e_trial, 1.0
        else:
            gain *= 0.5
    return best


def _stretches(s: Session, hold: list[Session]) -> list[tuple[Session, slice]]:
    """Windows of the fit rows of a session; none where little more than its margins was recorded."""
    stop = len(s.t) if hold else int((1.0 - HOLDOUT_SHARE) * len(s.t))
    margin, n = max(2, int(0.1 / s.dt)), max(int(WINDOW_S / s.dt), 50)
    windows = [slice(k, min(k + n, stop - margin)) for k in range(margin, max(stop - n // 2, margin + 1), n)]
    return [(s, one) for one in windows if one.stop - one.start > margin]


def _moved(solution: Solution, step: np.ndarray) -> Solution:
    edges = np.cumsum([len(solution.base), *[len(x) for x in solution.theta]])
    parts = [step[a:b] for a, b in pairwise(edges)]
    thetas = [x + d for x, d in zip(solution.theta, parts, strict=True)]
    return replace(solution, base=solution.base + step[: edges[0]], theta=thetas)


def design(problem: Problem, search: Search, terms: list[Term], s: Session) -> tuple[np.ndarray, np.ndarray]:
    """Columns of base parameters and terms, shape (time, k), and effort beyond the nominal model, shape (time,)."""
    y = s.u[:, 0] - s.load[:, 0] - nominal_friction(problem.ctx.model, s)[:, 0]
    columns = [p.column(s)[:, 0] for p in problem.base]
    for term in terms:
        found = search.effects[term.effect].columns(problem.ctx, s, term.joint, dict(term.shape))
        columns += [_on_first(x) for x in found.linear]
        if found.fixed is not None:
            y = y - _on_first(found.fixed)
    return (np.stack(columns, axis=1) if columns else np.zeros((len(y), 0))), y


def _on_first(x: np.ndarray) -> np.ndarray:
    return x if x.ndim == 1 else x[:, 0]


def integrated(x: np.ndarray, problem: Problem, s: Session, rows: slice) -> np.ndarray:
    """Motion that efforts cause on this joint [rad or m], along the first axis; none where it rests.

    At rest dry friction takes whatever is left over: it moves nothing, and does not add up.
    """
    x = x * (1.0 - stillness(s, 0)[rows, None])
    inertia, drag = float(np.mean(s.mass[:, 0])), _drag(problem, s)
    keep = np.exp(-drag / inertia * s.dt)
    speed = lfilter([(1.0 - keep) / drag], [1.0, -keep], x, axis=0)
    return np.cumsum(speed, axis=0) * s.dt


def _drag(problem: Problem, s: Session) -> float:
    """Viscous friction [N·m·s/rad or N·s/m]; never so little that the motion outlives the record."""
    return max(
        friction_levels(problem.ctx.model, s, 0)[1], float(np.mean(s.mass[:, 0])) / (10.0 * float(s.t[-1]))
    )


def friction(problem: Problem, search: Search, solution: Solution, s: Session, joint: int) -> np.ndarray:
    """All friction of the solution on one joint as required effort, shape (time,)."""
    m = problem.ctx.model.model
    total = nominal_friction(problem.ctx.model, s)[:, joint] + float(m.dof_damping[joint]) * s.v[:, joint]
    for p, x in zip(problem.base, solution.base, strict=True):
        if p.name in FRICTION_BASE and p.place == problem.ctx.model.joints[joint]:
            total = total + x * p.column(s)[:, joint]
    for term, theta in zip(solution.terms, solution.theta, strict=True):
        if term.effect in FRICTION_EFFECTS and term.joint == joint:
            found = search.effects[term.effect].columns(problem.ctx, s, joint, dict(term.shape))
            total = total + sum((c * x for c, x in zip(found.linear, theta, strict=True)), np.zeros(len(s.t)))
            total = total if found.fixed is None else total + found.fixed
    return total


def friction_change(
    problem: Problem, search: Search, solution: Solution, s: Session, joint: int, seconds: float
) -> float:
    """Common relative change of all friction that the efforts of a session's first seconds ask for.

    Args:
        problem: The regression.
        search: Source of the columns.
        solution: What the twin is made from.
        s: The new session.
        joint: Whose friction.
        seconds: How much of the session may be looked at.
    """
    early = s.t < seconds
    own = compare(friction(problem, search, solution, s, joint)[early], s, joint, True)
    left = compare(leftover_effort(problem, search, solution, s, joint)[early], s, joint, True)
    moving = 1.0 - stillness(s, joint)[early]  # at rest dry friction takes whatever is left over
    own, left = own * moving, left * moving
    doubt = float(np.mean(left**2)) * EFFECTIVE_S / s.dt / CHANGE_PRIOR**2
    return float(own @ left) / max(float(own @ own) + doubt, 1e-30)


def leftover_effort(
    problem: Problem, search: Search, solution: Solution, s: Session, joint: int
) -> np.ndarray:
    """Effort of one joint that the solution does not explain, unfiltered, shape (time,)."""
    y = s.u[:, joint] - s.load[:, joint] - nominal_friction(problem.ctx.model, s)[:, joint]
    for p, x in zip(problem.base, solution.base, strict=True):
        y = y - x * p.column(s)[:, joint]
    for term, theta in zip(solution.terms, solution.theta, strict=True):
        found = search.effects[term.effect].columns(problem.ctx, s, term.joint, dict(term.shape))
        parts = [(c, float(x)) for c, x in zip(found.linear, theta, strict=True)]
        parts += [] if found.fixed is None else [(found.fixed, 1.0)]
        for column, x in parts:
            if column.ndim == 2:
                y = y - x * column[:, joint]
            elif term.joint == joint:
                y = y - x * column
    return y
