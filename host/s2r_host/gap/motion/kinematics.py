"""Position against speed: two sensors of one joint that must agree, whatever the plant does.

A position read behind a compliant gear, a sensor that freezes, a current that leaks into it: none of these needs the
plant's equation to be seen, the recorded speed contradicts the recorded position. What a speed filter does to an honest
speed (lag, wrong scale) is taken out first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from s2r_host.gap.motion.filters import zero_phase
from s2r_host.gap.motion.law import LawFinding
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session, resolution
from s2r_host.gap.motion.ties import parting
from s2r_host.gap.motion.time_spans import time_spans
from s2r_host.gap.recordings.frozen import frozen, late_rows

SLOWEST_S = 0.011  # slower logs cannot integrate their speed
DRIFT_HZ, NOISE_HZ = 0.5, 10.0
WALK_S = 0.3  # time over which the noise of a speed adds up under the drift filter
PEAK = 5.0  # largest disagreement, in noise levels, beside which a position that stands still is no accident
CLEAR = 2.0  # disagreement in noise levels that is no accident; clean recordings reach 0.5
INTEGRATION = 1e-4  # of the motion: what a simulator's steps leave between both where speeds jump
# Noise levels below which even what follows the effort is only what steps and filters leave of a quiet recording;
# springs and leaks that were there had 0.4 and more.
FAINT = 0.2
NAMED_SHARE = 0.8  # part of the disagreement that a name has to explain; noise follows nothing (0.2)
FOREIGN = 3.0  # a current that leaks into the sensor may not leave so many times less
SIGN_SHARE = 0.25  # further part that play has to explain beyond a spring
# While the gap is crossed the motor is anywhere between its flanks: rows around a change of the load's sign.
CROSSING_S = (0.05, 0.1)
SETTLED_SHARE, SETTLED_LEAST = (
    0.95,
    0.6,
)  # of the disagreement explained elsewhere; of the rows that are elsewhere
BOTH_FLANKS = 0.1  # of the time on the lesser one, or the width stays open
MARGIN_S = 0.2
SPRING_DAMPING = 0.05
SPRING_ERROR = 0.02  # of a stiffness, beyond noise: what the load behind the gear is known to
PLAY_HZ, PLAY_DAMPING = 20.0, 0.4
Z90 = 1.645


@dataclass(frozen=True)
class Contradiction:
    """Position and speed of one joint disagree.

    Attributes:
        joint: Joint index.
        size: Disagreement (rms) and ``noise``, what the sensors explain of it, in the joint's unit.
        finding: A transmission that explains it, or None.
        intervals: Where it stands out in the first fit recording [s].
        words: What kind of disagreement it is.
    """

    joint: int
    size: float
    noise: float
    finding: LawFinding | None
    intervals: list[list[float]]
    words: str


def contradiction(model: RigidModel, fit: list[Session], joint: int) -> Contradiction | None:
    """Does the recorded speed of a joint contradict its recorded position in every fit recording?"""
    name = model.joints[joint]
    tracks = [x for s in fit if (x := _track(model, s, joint)) is not None]
    if all(s.rec.as_read.dt > SLOWEST_S for s in fit):
        return _stuck(model, fit, joint)
    if not tracks or len(tracks) < len(fit):
        return None
    left = [_without_filter(x) for x in tracks]
    size = float(np.sqrt(np.mean(np.concatenate(left) ** 2)))
    noise = max(x.noise for x in tracks)
    unit = model.unit(name)
    # Short stops vanish in the mean and stand out alone.
    stands_out = size > noise or min(float(np.max(np.abs(x))) for x in left) > PEAK * noise
    if stands_out and all(stops := [frozen(s.rec, name) for s in fit]):
        return Contradiction(joint, size, noise, None, stops[0], _stops(name, len(stops[0])))
    if size < FAINT * noise or (
        size < CLEAR * noise and _follows_something(tracks, fit[0].rec.dt) < NAMED_SHARE
    ):
        return None
    finding = _transmission(model, fit, tracks, joint)
    return Contradiction(
        joint, size, noise, finding, _above(tracks[0].t + fit[0].rec.start_s, left[0], max(3.0 * noise, size)),
        f"position and speed of '{name}' contradict each other by {size:.2g} {unit} (noise {noise:.2g} {unit})",
    )  # fmt: skip


def parted_ties(model: RigidModel, fit: list[Session]) -> list[Contradiction]:
    """Ties of the model that the recorded positions of both joints contradict in every fit recording."""
    found = []
    for tie in model.ties:
        seen = [p for s in fit if (p := parting(tie, s.rec, model.joints)) is not None]
        if not seen or len(seen) < len(fit) or any(p.size < p.noise for p in seen):
            continue
        follower, leader = (model.joints[j] for j in (tie.follower, tie.leader))
        words = (
            f"the model ties '{follower}' to '{leader}', and their positions part by {seen[0].size:.2g} "
            f"{model.unit(follower)}: something slips or gives between them"
        )
        found.append(Contradiction(tie.leader, seen[0].size, seen[0].noise, None, seen[0].intervals, words))
    return found


def _stops(name: str, count: int) -> str:
    return f"the position of '{name}' stands still {count} times while its speed does not"


def _stuck(model: RigidModel, fit: list[Session], joint: int) -> Contradiction | None:
    """Does the position of a joint stand still at single rows of every slow fit recording while its speed does not?"""
    name = model.joints[joint]
    late = [late_rows(s.rec.as_read, name) for s in fit]
    if any(x is None for x in late):
        return None
    first = late[0]
    assert first is not None
    return Contradiction(
        joint, first.size, first.noise, None, first.intervals, _stops(name, len(first.intervals))
    )


@dataclass(frozen=True)
class _Track:
    """Disagreement of one recording on an even grid, drift and noise filtered off; regressors filtered alike.

    Attributes:
        t: Time [s], shape (time,).
        gap: Position minus integrated speed, shape (time,).
        honest: What scale, lag and filter of the speed would make, shape (time, 3).
        windup: Effort behind the gear and its sign, shape (time, 2).
        settled: Rows at which that effort has not just changed its sign, shape (time,).
        lesser: Share of the time in which it has the rarer sign.
        leak: Recorded effort and its square, shape (time, 2), or None without an effort.
        noise: What the sensors explain of ``gap``.
    """

    t: np.ndarray
    gap: np.ndarray
    honest: np.ndarray
    windup: np.ndarray
    settled: np.ndarray
    lesser: float
    leak: np.ndarray | None
    noise: float


def _track(model: RigidModel, s: Session, joint: int) -> _Track | None:
    name = model.joints[joint]
    q, dq = s.rec.get("q", name), s.rec.get("dq", name)
    if q is None or dq is None or s.rec.as_read.dt > SLOWEST_S or len(q) < 500:
        return None
    dt = s.rec.dt
    grid = np.arange(0.0, float(s.rec.t[-1]), dt)
    margin = max(3, int(MARGIN_S / dt))

    def band(x: np.ndarray) -> np.ndarray:
        low = zero_phase(x, (NOISE_HZ,), dt) if NOISE_HZ * dt < 0.45 else x
        return (low - zero_phase(low, (DRIFT_HZ,), dt))[margin:-margin]

    def even(x: np.ndarray) -> np.ndarray:
        return np.interp(grid, s.rec.t, x)

    way = CubicSpline(s.rec.t, dq).antiderivative()(s.rec.t)
    steps = np.concatenate([[0.0], np.cumsum(0.5 * (dq[1:] + dq[:-1]) * np.diff(s.rec.t))])
    rough = float(np.std(band(even(way - steps))))  # what the rule of integration is worth
    white = float(np.median(np.abs(np.diff(dq, 2)))) * 1.48 / np.sqrt(6.0)
    step = INTEGRATION * float(np.std(q))
    noise = float(np.sqrt((0.4 * resolution(q)) ** 2 + (white**2 * dt * WALK_S) + rough**2 + step**2))
    v = zero_phase(even(dq), (min(NOISE_HZ, 0.4 / dt),), dt)
    honest = np.stack([band(even(q)), band(v), band(np.gradient(v, dt))], axis=1)
    link = np.interp(grid, s.t, transmitted(model, s, joint))
    turn = np.tanh(link / (0.05 * float(np.std(link)) + 1e-12))
    leak = None
    if s.has_u[joint]:
        u = np.interp(grid, s.t, s.u[:, joint])
        leak = np.stack([band(u), band(u**2)], axis=1)
    windup = np.stack([band(link), band(turn)], axis=1)
    settled = load_keeps_sign(link, dt)[margin:-margin]
    lesser = min(float(np.mean(link > 0)), float(np.mean(link < 0)))
    return _Track(grid[margin:-margin], band(even(q - way)), honest, windup, settled, lesser, leak, noise)


def transmitted(model: RigidModel, s: Session, joint: int) -> np.ndarray:
    """Effort behind the gear: what the model needs less the motor's share [N·m or N], shape (time,)."""
    link = s.load[:, joint] - float(model.model.dof_armature[joint]) * s.a[:, joint]
    return link - float(model.model.dof_damping[joint]) * s.v[:, joint]


def load_keeps_sign(link: np.ndarray, dt: float) -> np.ndarray:
    """Rows at which the load has not just changed its sign nor is about to, shape (time,)."""
    before, after = (int(np.ceil(x / dt)) for x in CROSSING_S)
    settled = np.ones(len(link), dtype=bool)
    for change in np.flatnonzero(np.diff(np.sign(link)) != 0):
        settled[max(0, change - before) : change + after + 1] = False
    return settled


def _without_filter(x: _Track) -> np.ndarray:
    """The disagreement without what a scale, a lag or a filter of the speed would make."""
    return x.gap - x.honest @ np.linalg.lstsq(x.honest, x.gap, rcond=None)[0]


def _above(t: np.ndarray, x: np.ndarray, limit: float) -> list[list[float]]:
    return [[round(a, 3), round(b, 3)] for a, b in time_spans(t[np.abs(x) > limit])][:200]


def _follows_something(tracks: list[_Track], dt: float) -> float:
    """Largest share of the disagreement that goes with the transmitted effort or with the current, however small."""
    y = np.concatenate([x.gap for x in tracks])
    effective = max(len(y) * 2.0 * NOISE_HZ * dt, 8.0)
    shares = [_regress(np.concatenate([x.windup for x in tracks]), y, effective).share]
    leaks = [x.leak for x in tracks if x.leak is not None]
    if len(leaks) == len(tracks):
        shares.append(_regress(np.concatenate(leaks), y, effective).share)
    return max(shares)


def _transmission(
    model: RigidModel, fit: list[Session], tracks: list[_Track], joint: int
) -> LawFinding | None:
    """Spring or play between the two sensors: the windup follows the transmitted effort, or its sign."""
    y = np.concatenate([x.gap for x in tracks])
    W = np.concatenate([x.windup for x in tracks])
    effective = max(len(y) / (1.0 / (2.0 * NOISE_HZ * fit[0].rec.dt)), 8.0)
    spring, play = _regress(W[:, :1], y, effective), _regress(W, y, effective)
    leaks = [x.leak for x in tracks if x.leak is not None]
    best = max(spring.share, play.share)
    if best < NAMED_SHARE:
        return _crossed(model, fit, tracks, W, y, effective, joint)
    if len(leaks) == len(tracks):
        leaked = _regress(np.concatenate(leaks), y, effective)
        if 1.0 - best > FOREIGN * (1.0 - leaked.share):
            return None
    name = model.joints[joint]
    effort = f"{model.effort_unit(name)}/{model.unit(name)}"
    inertia = float(np.mean(np.concatenate([s.mass[:, joint] for s in fit])))
    motor = float(model.model.dof_armature[joint]) / inertia
    more = (play.share - spring.share) / max(1.0 - spring.share, 1e-12)
    odds = 0.5 * effective * float(np.log((1.0 - spring.share + 1e-9) / (1.0 - play.share + 1e-9)))
    if more > SIGN_SHARE and play.beta[1] < 0:
        return _play(model, fit, joint, play, odds, True)
    if spring.beta[0] >= 0:
        return None
    k = -1.0 / float(spring.beta[0])
    half = Z90 * float(np.hypot(float(spring.deviation[0]) * k**2, SPRING_ERROR * k))
    link = np.concatenate([s.load[:, joint] for s in fit])
    one_sided = min(float(np.mean(link > 0)), float(np.mean(link < 0))) < 0.01  # the gap is never crossed
    f = float(np.sqrt(k / max((1.0 - motor) * inertia, 1e-12))) / (2.0 * np.pi)
    table = {"stiffness": table_entry(k, half, effort)}
    shape = {"f": f, "zeta": SPRING_DAMPING, "motor": motor}
    odds = 0.7 if one_sided else 6.0
    return LawFinding("joint_elasticity", joint, odds, spring.share, table, shape, {"backlash": 0.0})


def _crossed(
    model: RigidModel, fit: list[Session], tracks: list[_Track], W: np.ndarray, y: np.ndarray, effective: float,
    joint: int,
) -> LawFinding | None:  # fmt: skip
    """Play that takes time to cross: the windup is that of two flanks except around changes of the load's sign."""
    settled = np.concatenate([x.settled for x in tracks])
    if settled.all() or np.mean(settled) < SETTLED_LEAST:
        return None
    play = _regress(W[settled], y[settled], effective)
    if play.share < SETTLED_SHARE or play.beta[1] >= 0:
        return None
    odds = -0.5 * effective * float(np.log(1.0 - play.share + 1e-9))
    return _play(model, fit, joint, play, odds, min(x.lesser for x in tracks) > BOTH_FLANKS)


def _play(
    model: RigidModel, fit: list[Session], joint: int, play: _Regression, odds: float, identifiable: bool
) -> LawFinding:
    name = model.joints[joint]
    inertia = float(np.mean(np.concatenate([s.mass[:, joint] for s in fit])))
    motor = float(model.model.dof_armature[joint]) / inertia
    width, half = float(-play.beta[1]), Z90 * float(play.deviation[1])
    table = {"half_width": table_entry(width, half, model.unit(name)) | {"identifiable": identifiable}}
    shape = {"w": width, "motor": motor, "f": PLAY_HZ, "zeta": PLAY_DAMPING}
    return LawFinding("backlash", joint, odds, play.share, table, shape, {"joint_elasticity": 0.0})


@dataclass(frozen=True)
class _Regression:
    beta: np.ndarray
    deviation: np.ndarray
    share: float


def _regress(X: np.ndarray, y: np.ndarray, effective: float) -> _Regression:
    beta = np.linalg.lstsq(X, y, rcond=None)[0]
    left = y - X @ beta
    variance = float(left @ left) / effective
    return _Regression(
        beta, np.sqrt(np.diag(np.linalg.pinv(X.T @ X)) * variance), 1.0 - float(left @ left) / float(y @ y)
    )


def table_entry(x: float, half: float, unit: str) -> dict:
    """A parameter as answered: its value with an even interval."""
    return {"value": x, "unit": unit, "interval90": [x - half, x + half], "identifiable": True}
