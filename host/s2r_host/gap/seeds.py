"""Residuals on the work grid, cleaned of what is smooth in motion, for the seeds of position-bound effects."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.model import RigidModel
from s2r_host.gap.problem import Problem
from s2r_host.gap.rows import compare, residual
from s2r_host.gap.session import Session


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


def sharpen_sign(problem_sessions: list[Session], model: RigidModel, joint: int) -> None:
    """Choose the speed below which the sign of motion is blurred, by how well a friction step fits.

    The edge of dry friction is sharper than the velocity noise when the noise is coloured; a wrong edge would be
    read as a Stribeck hump.
    """
    best, best_misfit = 1.0, np.inf
    sessions = [s for s in problem_sessions if s.has_u[joint]]
    if not sessions:
        return
    start = [float(s.v_eps[joint]) for s in sessions]
    for factor in (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0):
        misfit = 0.0
        for s, v_eps in zip(sessions, start, strict=True):
            s.v_eps[joint] = factor * v_eps
            r = compare(s.u[:, joint], s, joint, True) - compare(s.load[:, joint], s, joint, False)
            columns = [s.sign(joint), s.v[:, joint], s.a[:, joint], s.load[:, joint], np.ones(len(s.t))]
            X = np.stack([compare(c, s, joint, True) for c in columns], axis=1)
            left = r - X @ np.linalg.lstsq(X, r, rcond=None)[0]
            misfit += float(left @ left)
        if misfit < 0.98 * best_misfit:
            best, best_misfit = factor, misfit
    for s, v_eps in zip(sessions, start, strict=True):
        s.v_eps[joint] = best * v_eps
