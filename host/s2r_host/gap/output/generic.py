"""A generic local correction for what has no name: a ridge fit over position, direction and speed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from s2r_host.gap.effects.base import StepState
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.rows import compare

BINS = 14


def fit_generic(problem: Problem) -> Callable[[StepState], np.ndarray]:
    """Fit the correction on the fit rows; returns required effort per joint for a state of the simulation."""
    nv = len(problem.ctx.model.joints)
    made = {j: _fit_joint(problem, j) for j in problem.joints}

    def correction(state: StepState) -> np.ndarray:
        out = np.zeros(nv)
        for j, (beta, low, high, v_eps, top) in made.items():
            out[j] = float(features(state.q[j : j + 1], state.v[j : j + 1], low, high, v_eps, top)[0] @ beta)
        return out

    return correction


def features(q: np.ndarray, v: np.ndarray, low: float, high: float, v_eps: float, top: float) -> np.ndarray:
    """Hats over position, per direction; speed shapes; shape (time, k)."""
    sign = np.tanh(v / v_eps)
    width = (high - low) / (BINS - 1) + 1e-12
    centres = np.linspace(low, high, BINS)
    hats = np.maximum(0.0, 1.0 - np.abs(np.clip(q, low, high)[:, None] - centres) / width)
    speed = np.stack(
        [v / top, np.abs(v) / top, v * np.abs(v) / top**2, sign * np.exp(-((v / (0.1 * top)) ** 2))], axis=1
    )
    return np.concatenate([hats, hats * sign[:, None], hats * (v / top)[:, None], speed], axis=1)


def _fit_joint(problem: Problem, j: int) -> tuple[np.ndarray, float, float, float, float]:
    low, high = problem.ctx.span(j)
    top = problem.ctx.top_speed(j) + 1e-12
    v_eps = max(float(s.v_eps[j]) for s in problem.ctx.sessions)
    X, y = [], []
    for block in problem.blocks:
        if block.joint != j:
            continue
        s = block.session
        F = compare(features(s.q[:, j], s.v[:, j], low, high, v_eps, top), s, j, True)[block.picks]
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
    return best, low, high, v_eps, top


def _ridge(F: np.ndarray, r: np.ndarray, ridge: float) -> np.ndarray:
    return np.linalg.solve(F.T @ F + ridge * len(F) * np.eye(F.shape[1]), F.T @ r)
