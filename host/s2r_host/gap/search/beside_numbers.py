"""Regressors that are no effect of the catalogue, held against the rows beside numbers that move a little."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.regression import TEMPER
from s2r_host.gap.search.search import Search


def beside_numbers(problem: Problem, search: Search, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What whitened columns (rows, columns) leave over beside the base parameters, (rows,), and their coefficients."""
    X = np.concatenate([problem.B, columns], axis=1)
    trust = np.concatenate([TEMPER / problem.prior**2, np.zeros(columns.shape[1])])
    c = np.linalg.solve(X.T @ X + np.diag(trust), X.T @ problem.y)
    return search.unwhitened(problem.y - X @ c), c[problem.B.shape[1] :]
