"""Residuals on the work grid, cleaned of what is smooth in motion, for the seeds of position-bound effects."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.rows import residual


def fill_residuals(problem: Problem) -> None:
    """Store the residual of every joint and session in the context, rigid and friction shapes regressed out."""
    ctx = problem.ctx
    for s in ctx.sessions:
        for j in problem.joints:
            if not s.has_u[j]:
                continue
            r = residual(ctx.model, s, j)
            X = np.stack(
                [np.ones(len(s.t)), s.sign(j), s.v[:, j], s.a[:, j], s.load[:, j], s.q[:, j]], axis=1
            )
            beta, *_ = np.linalg.lstsq(X, r, rcond=None)
            ctx.residual[(s.index, j)] = r - X @ beta
