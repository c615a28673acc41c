"""The fit of the generic local correction of what has no name: a ridge over position, direction and speed."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.rows import compare
from s2r_host.gap.simulation.generic import GENERIC, features
from s2r_host.gap.simulation.replay import Live


def fit_generic(problem: Problem) -> list[Live]:
    """Fit the correction on the fit rows; one term per joint that has an effort."""
    return [_fit_joint(problem, j) for j in problem.joints]


def _fit_joint(problem: Problem, j: int) -> Live:
    low, high = problem.ctx.span(j)
    v_eps = max(float(s.v_eps[j]) for s in problem.ctx.sessions)
    shape = {"low": low, "high": high, "v_eps": v_eps, "top": problem.ctx.top_speed(j) + 1e-12}
    X, y = [], []
    for block in problem.blocks:
        if block.joint != j:
            continue
        s = block.session
        F = compare(features(s.q[:, j], s.v[:, j], shape), s, j, True)[block.picks]
        X.append(F[~block.held])
        y.append(problem.raw[block.rows][~block.held])
    F, r = np.concatenate(X), np.concatenate(y)
    best, best_error = np.zeros(F.shape[1]), np.inf
    folds = np.arange(len(F)) * 5 // max(len(F), 1)
    for ridge in (1e-4, 1e-3, 1e-2, 1e-1):
        error = 0.0
        for k in range(5):
            beta = _ridge(F[folds != k], r[folds != k], ridge)
            error += float(np.sum((r[folds == k] - F[folds == k] @ beta) ** 2))
        if error < best_error:
            best, best_error = _ridge(F, r, ridge), error
    return Live(GENERIC.name, j, shape, best)


def _ridge(F: np.ndarray, r: np.ndarray, ridge: float) -> np.ndarray:
    return np.linalg.solve(F.T @ F + ridge * len(F) * np.eye(F.shape[1]), F.T @ r)
