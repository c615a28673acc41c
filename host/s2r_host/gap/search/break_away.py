"""Friction that a joint has to overcome before it moves, and that is less as soon as it does (Stribeck 1902).

Where that is so only at speeds at which a joint stays for milliseconds, no regression on speed shows it: rows at rest
say little there, since friction at rest is whatever balances the rest. But the effort that it takes to leave a rest,
against that for sliding on right after, at the same place and with the same load, is the difference of the two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from s2r_host.gap.motion.rest import stands
from s2r_host.gap.motion.session import Session
from s2r_host.gap.regression.problem import Problem

SMOOTH_S = 0.01
# The effort of a start is held against that of as many windows of its length, a little after it.
BEFORE_S, WAIT_S, WINDOWS = 0.1, 0.08, 2
LEAST_ROWS = 5  # of such a window: a slow log misses the peak
# Steps of the encoder, and spreads of the position at rest, from which on the rest was left.
LEFT_STEPS, LEFT_SPREADS = 2.0, 5.0
# Least number of starts, and of the travel between their places: one place that holds a joint is a detent.
EVENTS, APART = 2, 0.02
# Of the dry friction in motion: the excess, at least and at most, and what the model's damping takes at a slow start.
LEAST_SHARE, MOST_SHARE, DRAG_SHARE = 0.1, 3.0, 0.1
# Least excess: of what smoothing leaves of the noise, of its own standard error, of the noise floor.
NOISES, DEVIATIONS, FLOORS = 2.5, 6.0, 1.5
ALIKE = 0.45  # spread of the excess over its median
SLOWER = 0.5  # times the slowest sliding seen after a start: there the excess is gone


@dataclass(frozen=True)
class BreakAway:
    """Dry friction at rest that is above that in motion.

    Attributes:
        joint: Joint index.
        excess: By how much, and ``deviation``, one standard error of that [N·m or N].
        intervals: When it was overcome, in stamps of the recordings [s].
        speed: Speed from which on nothing of it is left [rad/s or m/s].
        words: For the evidence of the answer.
    """

    joint: int
    excess: float
    deviation: float
    intervals: list[list[float]]
    speed: float
    words: str


@dataclass(frozen=True)
class _Start:
    """A rest that was left.

    Attributes:
        t: Stamp [s], and ``q``, where it was [rad or m].
        fell: By how much the effort fell [N·m or N].
        dry: What friction took then, and ``drag``, what the model's damping did [N·m or N].
        speed: Of sliding then [rad/s or m/s].
    """

    t: float
    q: float
    fell: float
    dry: float
    drag: float
    speed: float


def break_away(problem: Problem, joint: int) -> BreakAway | None:
    """The excess of a joint's friction at rest, where several starts at several places agree on it."""
    blocks = [*problem.blocks, *(problem.twin.problem.blocks if problem.twin is not None else [])]
    sessions = list({b.session.index: b.session for b in blocks if b.joint == joint}.values())
    sessions = [s for s in sessions if s.driven(joint)]
    damping = float(problem.ctx.model.model.dof_damping[joint])
    starts = [start for s in sessions for start in _starts(s, joint, damping)]
    slow = [x for x in starts if x.drag < DRAG_SHARE * x.dry]
    noise = max((_noise(_friction(s, joint), s.dt) for s in sessions), default=0.0)
    return _agreed(problem, joint, starts, noise) or _agreed(problem, joint, slow, noise)


def _agreed(problem: Problem, joint: int, starts: list[_Start], noise: float) -> BreakAway | None:
    """The excess that some starts agree on, None where they do not."""
    low, high = problem.ctx.span(joint)
    if len(starts) < EVENTS or np.ptp([x.q for x in starts]) < APART * (high - low):
        return None
    fell = np.array([x.fell for x in starts])
    # A joint without any of its model's damping falls by that much.
    sure = fell - np.array([x.drag for x in starts])
    dry = float(np.median([x.dry for x in starts]))
    excess, spread = float(np.median(fell)), float(np.std(fell))
    deviation = float(np.hypot(spread, noise) / np.sqrt(len(fell)))
    least = max(NOISES * noise, DEVIATIONS * deviation, FLOORS * problem.floor[joint])
    told = least < excess < MOST_SHARE * dry and spread < ALIKE * excess
    if not told or float(np.median(sure)) < LEAST_SHARE * dry or float(sure.min()) < 0.0:
        return None
    name = problem.ctx.model.joints[joint]
    unit = problem.ctx.model.effort_unit(name)
    times = [[round(x.t - BEFORE_S, 3), round(x.t, 3)] for x in starts]
    return BreakAway(
        joint, excess, deviation, times, SLOWER * min(x.speed for x in starts),
        f"each of {len(starts)} starts from rest takes {excess:.3g} {unit} (one deviation {deviation:.2g}) more than "
        f"sliding on right after; dry friction in motion is {dry:.3g} {unit}",
    )  # fmt: skip


def _starts(s: Session, joint: int, damping: float) -> list[_Start]:
    q, v = s.q_raw[:, joint], s.v[:, joint]
    friction = uniform_filter1d(_friction(s, joint), max(1, round(SMOOTH_S / s.dt)), mode="nearest")
    before, wait = round(BEFORE_S / s.dt), round(WAIT_S / s.dt)
    if before < LEAST_ROWS:
        return []
    found = []
    for begin, end in stands(s, joint):
        inner = slice(begin + before // 2, end - before)
        if inner.stop - inner.start < before // 2:
            continue
        rest = float(np.median(q[inner]))
        reach = max(LEFT_STEPS * float(s.q_lsb[joint]), LEFT_SPREADS * float(np.std(q[inner])), 1e-9)
        left = np.flatnonzero(np.abs(q[inner.stop : end + 3 * before] - rest) > reach)
        if not len(left):
            continue
        row = inner.stop + int(left[0])
        after = slice(row + wait, row + wait + WINDOWS * before)
        way = float(np.sign(q[row] - rest))
        if after.stop > len(q) or np.any(way * v[after] <= 0.0):
            continue
        # Peaks of windows as long as that of the start: as noisy as that is.
        sliding = float((way * friction[after]).reshape(WINDOWS, before).max(axis=1).mean())
        peak = float((way * friction[row - before : row + 1]).max())
        level = float(np.median(way * friction[after]))
        stamp, speed = float(s.t[row]) + s.rec.start_s, float(np.median(np.abs(v[after])))
        found.append(_Start(stamp, rest, peak - sliding, level, damping * speed, speed))
    return found


def _friction(s: Session, joint: int) -> np.ndarray:
    """Effort that the nominal model without its dry friction does not take [N·m or N], (time,).

    Nothing is fitted: ramps of one speed do not tell dry friction from drag.
    """
    return s.u[:, joint] - s.load[:, joint]


def _noise(x: np.ndarray, dt: float) -> float:
    """What smoothing leaves of white noise, rms."""
    return float(np.std(np.diff(x))) / np.sqrt(2.0 * max(1, round(SMOOTH_S / dt)))
