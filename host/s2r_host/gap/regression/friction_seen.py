"""Friction as a recording shows it before any effect is named, and how far rows near rest can be trusted."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import count_reversals
from s2r_host.gap.motion.command_steps import step_doubt
from s2r_host.gap.motion.model import FEW_JOINTS, RigidModel
from s2r_host.gap.motion.rest import rests_of, stillness
from s2r_host.gap.motion.session import Session
from s2r_host.gap.motion.time_spans import runs
from s2r_host.gap.regression.evidence import AR_ORDER
from s2r_host.gap.regression.rows import Block, compare

STICK_DOUBT = 0.5  # times the friction, for rows at rest
STICKS = 2.0  # times the friction in motion, from which on what holds at rest counts twice
REST_DOUBT = 3.0  # the same at rest for longer, where no second run shows what comes back there
PULLED, LEAST_RESTS = 1.5, 2  # times the friction in motion; rests of either kind
TRUSTED = 0.25  # squared weight from which on a row tells what is left over
ONE_WAY = 0.05  # spread of the direction of motion below which a joint goes one way only
SLOW_LOG_S = 0.01
BETWEEN_SHARE = 0.25


def nominal_friction_of(model: RigidModel, name: str, joint: int) -> float:
    """Dry or viscous friction the model gives a joint: N·m or N, or per unit of speed."""
    m = model.model
    return float(m.dof_frictionloss[joint] if name == "coulomb_friction" else m.dof_damping[joint])


def dry_level(s: Session, j: int) -> float:
    """Size of the friction step in a recording, by plain regression [N·m or N]."""
    return abs(float(_friction_fit(s, j)[0]))


def friction_levels(model: RigidModel, s: Session, j: int) -> tuple[float, float]:
    """Dry [N·m or N] and viscous [N·m·s/rad or N·s/m] friction of a recording, the model's own included."""
    fitted = _friction_fit(s, j)
    return abs(float(fitted[0])), max(0.0, float(fitted[1]) + float(model.model.dof_damping[j]))


def _friction_fit(s: Session, j: int) -> np.ndarray:
    key = ("friction", j, float(s.cut[j]), float(s.v_eps[j]), float(s.lead[j]))
    if key not in s.cache:
        r = compare(s.u[:, j], s, j, True) - compare(s.load[:, j], s, j, False)
        columns = [s.sign(j), s.v[:, j], np.ones(len(s.t))]
        if s.driven(j):
            columns += [s.a[:, j], s.load[:, j]]
        X = np.stack([compare(c, s, j, True) for c in columns], axis=1)
        if np.std(X[:, 0]) < ONE_WAY:  # dry friction and a constant are one thing then
            X[:, 0] = 0.0
        s.cache[key] = np.linalg.lstsq(X, r, rcond=None)[0]
    return s.cache[key]


def trust(model: RigidModel, block: Block, floor: float, *, guessed: bool = False) -> np.ndarray:
    """Weight of the rows of a block, shape (rows,), in (0, 1].

    At rest dry friction balances whatever is there, up to its break-away level: such rows say little. Where the floor
    is ``guessed`` without a second run, those of a longer rest and the next, into which whitening mixes them, say less.
    """
    s, j = block.session, block.joint
    still = compare(stillness(s, j), s, j, True)[block.picks]
    at_rest, moving = stiction(s, j)
    holds = np.full(len(still), STICK_DOUBT * max(at_rest, moving))
    there_and_back = count_reversals(s, j) >= 2
    if there_and_back and not guessed and len(model.joints) <= FEW_JOINTS:
        # Where a joint sticks by far more than it slides with, the sign of a speed that is noise is wrong by all of it.
        holds += STICK_DOUBT * max(0.0, at_rest - STICKS * moving)
    # One stroke does not tell friction from what else it pulls at, and what a latch holds at rest is looked for.
    # What comes back in a second run of a free swing is that friction held it again.
    rests = (guessed or not s.driven(j)) and there_and_back
    if rests:
        at_rest_for_long = (rests_of(s, j) & ~pulled_rests(s, j))[block.picks]
        holds[at_rest_for_long] = max(REST_DOUBT * moving, holds[0])
        still[at_rest_for_long] = 1.0
    doubt = holds * np.clip(np.abs(still), 0.0, 1.0) / max(floor, 1e-12)  # filters ring beside a rest
    open_to = np.clip(compare(_between_rows(model, s, j), s, j, True), 0.0, None)
    between = np.maximum(open_to, step_doubt(s, j, model.joints[j]))[block.picks] / max(floor, 1e-12)
    weight = 1.0 / np.sqrt(1.0 + doubt**2 + between**2)
    if not rests:
        return weight
    if guessed and len(model.joints) <= FEW_JOINTS:
        weight /= np.sqrt(_rows_alike(weight**2 < TRUSTED))
    spread = weight.copy()
    for k in range(1, AR_ORDER + 1):
        spread[k:] = np.minimum(spread[k:], weight[:-k])
    return spread


def _rows_alike(stuck: np.ndarray) -> np.ndarray:
    """Rows of the stretch that a row is in where ``stuck``, else one: what friction holds at rest is one number."""
    rows = np.ones(len(stuck))
    for start, end in runs(stuck):
        rows[start:end] = end - start
    return rows


def between_level(model: RigidModel, sessions: list[Session], j: int) -> float:
    """What logs rebuilt between their rows leave open half of the time [N·m or N]; 0 for fast logs."""
    doubts = [d for s in sessions if (d := s.rec.effort_doubt.get(model.joints[j])) is not None]
    return float(np.median(np.concatenate(doubts))) if doubts else 0.0


def _between_rows(model: RigidModel, s: Session, j: int) -> np.ndarray:
    """What a slow log cannot say about the effort between its rows [N·m or N], shape (time,).

    Linear interpolation errs by an eighth of the second difference; motion rebuilt from such rows errs alike. Zero
    for logs fast enough for the loops they record.
    """
    doubt = s.rec.effort_doubt.get(model.joints[j])
    if doubt is not None:
        return np.interp(s.t, s.rec.t, doubt)
    raw = s.rec.get("tau", model.joints[j])
    if s.rec.dt < SLOW_LOG_S or raw is None or len(raw) < 3:
        return np.zeros(len(s.t))
    bend = np.abs(np.diff(raw, 2))
    bend = (
        np.pad(np.maximum(bend[1:], bend[:-1]), (2, 1), mode="edge")
        if len(bend) > 1
        else np.full(len(raw), bend[0])
    )
    return np.interp(s.t, s.rec.t, BETWEEN_SHARE * bend)


def pulled_rests(s: Session, j: int) -> np.ndarray:
    """Rests at one end of the way at which friction cannot be what holds, shape (time,).

    Friction holds either way. Rests that hold more than friction in motion does, all of them one way and further out
    than the others, which hold less, are held by something that acts there: a stop, a latch, a spring.
    """
    pulled = np.zeros(len(s.t), dtype=bool)
    rests = runs(rests_of(s, j))
    r = s.u[:, j] - s.load[:, j]
    place, holds = (np.array([np.mean(x[start:end]) for start, end in rests]) for x in (s.q[:, j], r))
    beyond = np.abs(holds) > PULLED * dry_level(s, j)
    out, within = place[beyond], place[~beyond]
    if min(len(out), len(within)) < LEAST_RESTS or len(np.unique(np.sign(holds[beyond]))) > 1:
        return pulled
    if out.min() > within.max() or out.max() < within.min():
        for start, end in rests[beyond]:
            pulled[start:end] = True
    return pulled


def stiction(s: Session, j: int) -> tuple[float, float]:
    """Effort that friction was seen to hold at rest (95th percentile), and dry friction in motion [N·m or N]."""
    moving = dry_level(s, j)
    r = compare(s.u[:, j], s, j, True) - compare(s.load[:, j], s, j, False)
    rest = (compare(stillness(s, j), s, j, True) > 0.9) & ~pulled_rests(s, j)
    return (float(np.percentile(np.abs(r[rest]), 95)) if rest.sum() > 20 else 0.0), moving
