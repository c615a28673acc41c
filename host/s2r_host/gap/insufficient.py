"""When the data cannot tell: no effort channel, or a motion that shows nothing."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import count_reversals
from s2r_host.gap.model import RigidModel
from s2r_host.gap.problem import Problem
from s2r_host.gap.session import Session


def no_effort(model: RigidModel, fit: list[Session]) -> str | None:
    """A sentence when no joint has an effort channel."""
    if any(s.has_u.any() for s in fit):
        return None
    return (
        "cannot tell: no recording has an effort column (tau.<joint>), and feedback hides a mismatch from the "
        f"position; record effort for {', '.join(model.joints)}"
    )


def poor_excitation(model: RigidModel, fit: list[Session], problem: Problem) -> str | None:
    """A sentence when 'nothing missing' would only mean 'nothing was tried'."""
    for j in problem.joints:
        span = max(float(np.ptp(s.q[:, j])) for s in fit)
        lsb = max(float(s.q_lsb[j]) for s in fit)
        reversals = sum(count_reversals(s, j) for s in fit)
        name = model.joints[j]
        if span < max(30.0 * lsb, 0.02 if model.unit(name) == "rad" else 0.002):
            return f"cannot tell: joint '{name}' moves {span:.4g} {model.unit(name)} only; move it through its range"
        if reversals < 2:
            return f"cannot tell: joint '{name}' reverses {reversals} time(s); move it both ways at several speeds"
        top = max(float(np.percentile(np.abs(s.v[:, j]), 99)) for s in fit)
        if top < 10.0 * max(float(s.v_eps[j]) for s in fit):
            return f"cannot tell: joint '{name}' never moves faster than its velocity noise ({top:.3g}); move it faster"
    return None
