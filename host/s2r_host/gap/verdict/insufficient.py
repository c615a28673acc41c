"""When the data cannot tell: no effort channel, or a motion that shows nothing."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import count_reversals
from s2r_host.gap.motion.known_noise import known_noise
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.rows import LEAST_ROWS, picks_of

ONE_WAY = 0.02
LEAST_MOVING_S = 0.3  # in all recordings: less is an arm that settles where its law begins to hold it
WIDE = 0.02  # of the spread of the effort: a guess of the floor from which on a second run is asked for
# The same, and times the noise that the channels show: a guess that says nothing about what is missing.
FAR_TOO_WIDE, UNHEARD = 0.05, 2.0


def no_effort(model: RigidModel, fit: list[Session]) -> str | None:
    """A sentence when no joint has an effort channel."""
    if any(s.has_u.any() for s in fit):
        return None
    return (
        "cannot tell: no recording has an effort column (tau.<joint>) with numbers in it, and feedback hides a "
        f"mismatch from the position; record effort for {', '.join(model.joints)}"
    )


def too_short(model: RigidModel, fit: list[Session]) -> str | None:
    """A sentence when no recording holds enough rows to learn from and to predict."""
    if any(len(picks_of(s, int(j))) >= LEAST_ROWS for s in fit for j in np.flatnonzero(s.has_u)):
        return None
    longest = max(float(s.t[-1] - s.t[0]) for s in fit)
    return (
        f"cannot tell: the longest recording lasts {longest:.2g} s, too short for the band in which efforts can be "
        f"compared; record {', '.join(model.joints)} for several seconds"
    )


def at_rest(model: RigidModel, fit: list[Session]) -> str | None:
    """A sentence when no joint with an effort changes its position at all."""
    with_effort = sorted({int(j) for s in fit for j in np.flatnonzero(s.has_u)})
    if any(_span(fit, j) > 0.0 for j in with_effort):
        return None
    return _still(model, fit, with_effort[0])


def no_motion(model: RigidModel, fit: list[Session], problem: Problem) -> str | None:
    """A sentence when no joint moves enough to show anything, whatever the residual looks like."""
    still = [j for j in problem.joints if _span(fit, j) < _least_span(model, fit, j)]
    if still and len(still) == len(problem.joints):
        return _still(model, fit, still[0])
    moving_s = {j: _moving_s(fit, j) for j in problem.joints}
    if any(x >= LEAST_MOVING_S for x in moving_s.values()):
        return None
    j = max(moving_s, key=moving_s.__getitem__)
    return (
        f"cannot tell: joint '{model.joints[j]}' moves for {moving_s[j]:.2g} s only, and none moves longer; move it "
        "through its range for several seconds"
    )


def poor_excitation(model: RigidModel, fit: list[Session], problem: Problem) -> str | None:
    """A sentence when 'nothing missing' would only mean 'nothing was tried'."""
    for j in problem.joints:
        name = model.joints[j]
        if _span(fit, j) < _least_span(model, fit, j):
            return _still(model, fit, j)
        reversals = sum(count_reversals(s, j) for s in fit)
        # Recordings of single strokes reverse between them: there and back in two files.
        ways = {float(np.sign(s.q[-1, j] - s.q[0, j])) for s in fit}
        if (reversals < 2 and not {-1.0, 1.0} <= ways) or _minor_share(fit, j) < ONE_WAY:
            return f"cannot tell: joint '{name}' moves one way only; move it both ways at several speeds"
        top = max(float(np.percentile(np.abs(s.v[:, j]), 99)) for s in fit)
        if top < 10.0 * max(float(s.v_eps[j]) for s in fit):
            return f"cannot tell: joint '{name}' never moves faster than its velocity noise ({top:.3g}); move it faster"
    return None


def wide_guess(problem: Problem) -> str | None:
    """A sentence when what is missing besides may pass for noise, whose floor had to be guessed wide."""
    if problem.floor_source == "repeat":
        return None
    shares = _floor_shares(problem)
    j = max(shares, key=lambda k: shares[k])
    return _guessed(problem, j, shares[j]) if shares[j] >= WIDE else None


def passes_for_noise(problem: Problem) -> str | None:
    """A sentence when 'nothing missing' would only mean that the floor had to be guessed far above all known noise.

    What a generic correction leaves over of a force that changes with time is as large as that force.
    """
    if problem.floor_source == "repeat":
        return None
    shares, model = _floor_shares(problem), problem.ctx.model
    for j in sorted(shares, key=lambda k: -shares[k]):
        name, sessions = model.joints[j], [s for s in problem.ctx.sessions if s.has_u[j]]
        heard = max(max(known_noise(model, s, j), s.rec.effort_sigma.get(name, 0.0)) for s in sessions)
        if shares[j] >= FAR_TOO_WIDE and problem.floor[j] > UNHEARD * heard > 0.0:
            guessed = _guessed(problem, j, shares[j])
            return f"cannot tell: {guessed}. The noise that is known of is {heard:.3g}"
    return None


def _floor_shares(problem: Problem) -> dict[int, float]:
    """The noise floor of each joint as a share of the spread of its effort."""
    shares = {}
    for j in problem.joints:
        effort = np.concatenate([s.u[:, j] for s in problem.ctx.sessions if s.has_u[j]])
        shares[j] = problem.floor[j] / max(float(np.std(effort)), 1e-12)
    return shares


def _guessed(problem: Problem, j: int, share: float) -> str:
    name = problem.ctx.model.joints[j]
    return (
        f"no second run: the noise floor is a guess, {problem.floor[j]:.3g} {problem.ctx.model.effort_unit(name)} on "
        f"'{name}' ({share:.0%} of its effort), and what is smaller passes for noise; record the same motion once "
        "more and give it with --repeat"
    )


def _still(model: RigidModel, fit: list[Session], j: int) -> str:
    name = model.joints[j]
    return f"cannot tell: joint '{name}' moves {_span(fit, j):.4g} {model.unit(name)} only; move it through its range"


def _span(fit: list[Session], j: int) -> float:
    return max(float(np.ptp(s.q[:, j])) for s in fit)


def _moving_s(fit: list[Session], j: int) -> float:
    return sum(float(np.sum(np.abs(s.v[:, j]) > 3.0 * s.v_eps[j]) * s.dt) for s in fit)


def _least_span(model: RigidModel, fit: list[Session], j: int) -> float:
    lsb = max(float(s.q_lsb[j]) for s in fit)
    return max(30.0 * lsb, 0.02 if model.unit(model.joints[j]) == "rad" else 0.002)


def _minor_share(fit: list[Session], j: int) -> float:
    """Way travelled in the rarer direction over the way in the other one."""
    up = sum(float(np.sum(np.clip(s.v[:, j], 0.0, None)[s.v[:, j] > 3 * s.v_eps[j]]) * s.dt) for s in fit)
    down = sum(float(np.sum(np.clip(-s.v[:, j], 0.0, None)[s.v[:, j] < -3 * s.v_eps[j]]) * s.dt) for s in fit)
    return min(up, down) / max(up, down, 1e-12)
