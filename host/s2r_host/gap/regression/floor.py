"""The noise floor: half the difference of two runs of one motion, or what a rich generic fit leaves over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import detrend

from s2r_host.gap.effects.base import count_reversals
from s2r_host.gap.effects.gravity_tilt import tilted_loads
from s2r_host.gap.motion.known_noise import known_noise, motion_noise
from s2r_host.gap.motion.model import FEW_JOINTS, RigidModel
from s2r_host.gap.motion.rest import rests_of
from s2r_host.gap.motion.session import Session, wrench_parts
from s2r_host.gap.motion.states import stop_operator
from s2r_host.gap.motion.time_spans import runs
from s2r_host.gap.regression.friction_seen import TRUSTED, between_level, trust
from s2r_host.gap.regression.nuisance import body_parameters
from s2r_host.gap.regression.rows import Block, compare, picks_of, residual
from s2r_host.gap.regression.second_run import find_partner, led_by_hand

GENERIC_FOLDS = 8
GENERIC_BINS, COARSE_BINS = 40, (6, 12)
RIDGES = (1e-4, 1e-2, 1e-1)
LEAST_ROWS = 4 * GENERIC_FOLDS  # fewer hold nothing to predict from
STROKE_PARTS, FINE_PARTS = 6, 16
KNOWN_TIMES = 4.5  # the channels' own noise that a bounded floor may be
DECLARED_TIMES = 2.0  # the accuracy its side files declare
CLEARINGS = 3
LOOP_SHARES = (0.003, 0.01, 0.03, 0.1, 0.3)


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise samples per joint, one array per recording or block.

    Attributes:
        size: How large it is [N·m or N].
        course: The same with the spectrum that it has.
        source: "repeat" of half the difference of two runs; "estimated" of what generic corrections leave over.
    """

    size: dict[int, list[np.ndarray]]
    course: dict[int, list[np.ndarray]]
    source: str


def noise_samples(
    model: RigidModel, joints: list[int], fit: list[Session], repeats: list[Session],
    blocks: list[Block], raw: list[np.ndarray],
) -> Noise:  # fmt: skip
    """Half the difference of two runs, or what generic corrections leave over; the less of both where hands led."""
    noise: dict[int, list[np.ndarray]] = {j: [] for j in joints}
    for twin in repeats:
        partner = find_partner(twin, fit)
        if partner is None:
            continue
        n = min(len(twin.t), len(partner.t))
        for j in joints:
            picks = picks_of(partner, j)
            picks = picks[picks < n - 3]
            if twin.has_u[j] and partner.has_u[j]:
                difference = residual(model, partner, j)[:n] - residual(model, twin, j)[:n]
                noise[j].append(difference[picks] / np.sqrt(2.0))
    source = "repeat" if all(noise[j] for j in joints) and joints else "estimated"
    course = {j: list(noise[j]) for j in joints}
    led = any(led_by_hand(twin, find_partner(twin, fit)) for twin in repeats)
    for j in joints:
        if noise[j] and not led:
            continue
        own = [(b, values) for b, values in zip(blocks, raw, strict=True) if b.joint == j]
        left = [generic_leftovers(model, b.session, j, values, b.picks) for b, values in own]
        if not noise[j]:
            noise[j], course[j] = [least for least, _ in left], [richest for _, richest in left]
        elif left:  # what the two ways differ by is in half their difference as well
            share = min(1.0, rms([least for least, _ in left]) / max(rms(noise[j]), 1e-30))
            noise[j] = [share * x for x in noise[j]]
    for j in joints:
        noise[j] = at_least_declared(model.joints[j], noise[j], fit)
    return Noise(noise, course, source)


def floor_level(
    model: RigidModel,
    sessions: list[Session],
    blocks: list[Block],
    noise: list[np.ndarray],
    j: int,
    *,
    guessed: bool,
    bounded: bool,
) -> float:
    """The noise floor of a joint, rms [N·m or N].

    Args:
        model: The nominal model.
        sessions: All recordings.
        blocks: All blocks.
        noise: Noise samples of the joint; where they are ``guessed`` one array per block of the joint.
        j: The joint.
        guessed: They are what a generic correction leaves over; rows in which the joint may stick do not count.
        bounded: An effect that the correction does not follow is in there, too; the channels' own noise is a bound.
    """
    between = between_level(model, sessions, j)
    level = float(np.hypot(rms(noise), between))
    if guessed:
        level = _of_moving_rows(model, sessions, blocks, noise, j, level=level, bounded=bounded)
    # The steps of a coarse encoder come back in a second run, and a correction takes part of them away.
    seen = np.mean([motion_noise(model, s, j, sure=True) ** 2 for s in sessions if s.has_u[j]])
    return max(level, float(np.sqrt(seen)))


def _of_moving_rows(
    model: RigidModel, sessions: list[Session], blocks: list[Block], noise: list[np.ndarray], j: int, *,
    level: float, bounded: bool,
) -> float:  # fmt: skip
    """A guessed floor read from the rows in which the joint does not stick, and bounded by what the channels show."""
    between = between_level(model, sessions, j)
    known = max((known_noise(model, s, j) for s in sessions if s.has_u[j]), default=0.0) if bounded else 0.0
    if known > 0.0:
        declared = max(s.rec.effort_sigma.get(model.joints[j], 0.0) for s in sessions)
        level = min(level, float(np.hypot(max(KNOWN_TIMES * known, DECLARED_TIMES * declared), between)))
    samples = np.concatenate(noise)
    # Under a lower floor more rows are seen to stick.
    for _ in range(CLEARINGS if len(model.joints) <= FEW_JOINTS else 1):
        weights = np.concatenate([trust(model, b, level, guessed=True) for b in blocks if b.joint == j])
        clear = weights**2 >= TRUSTED
        if len(samples) != len(clear) or clear.sum() < LEAST_ROWS:
            break
        lower = float(np.hypot(rms([samples[clear]]), between))
        if lower >= level:
            break
        level = lower
    return level


def without_rests(blocks: list[Block], noise: list[np.ndarray]) -> list[np.ndarray]:
    """Guessed noise, one array per block of a joint, without what friction held in longer rests, a line in each.

    That is no noise, and has the frequencies of the motion: it would pass for noise of those.
    """
    found = []
    for b, x in zip(blocks, noise, strict=True):
        left = x.copy()
        for start, end in runs(rests_of(b.session, b.joint)[b.picks]):
            left[start:end] = detrend(x[start:end])
        found.append(left)
    return found


def rms(samples: list[np.ndarray]) -> float:
    """Root mean square of all samples."""
    return float(np.sqrt(np.mean(np.concatenate(samples) ** 2)))


def at_least_declared(joint: str, noise: list[np.ndarray], fit: list[Session]) -> list[np.ndarray]:
    """The noise samples, made larger where the recordings declare a less accurate effort than they show."""
    squares = [s.rec.effort_sigma.get(joint, 0.0) ** 2 for s in fit]
    declared = float(np.sqrt(np.average(squares, weights=[len(s.t) for s in fit]))) if fit else 0.0
    seen = rms(noise) if noise else 0.0
    return [x * (declared / seen) for x in noise] if 0.0 < seen < declared else noise


def generic_leftovers(
    model: RigidModel, s: Session, j: int, values: np.ndarray, picks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What generic local corrections cannot predict on stretches they were not fitted to, shape (rows,) each.

    Of corrections with more and more columns the one that predicts best tells the size of the noise: where a motion
    passes a place once, many columns err by more there than the noise is. Never more than the residual itself: then
    nothing was predictable, and all of it counts as noise. The one with most columns tells its course: what fewer leave
    follows the place, slowly, as no noise does.
    They are fitted to the rows that move: what friction holds at rest follows neither place nor speed, and would bend
    them everywhere. On arms of more joints the floor is spared that, and short stretches: under a finer one each
    joint's friction takes on what the links leave over, and part of a load goes into friction that grows with it.
    """
    if len(picks) < LEAST_ROWS:
        return values - np.mean(values), values - np.mean(values)
    # A single stroke passes every place once: only short stretches leave their surroundings to learn from.
    parts = [1 if count_reversals(s, j) >= 2 else STROKE_PARTS]
    if s.q.shape[1] <= FEW_JOINTS:
        parts.append(FINE_PARTS)
    folds = [np.arange(len(picks)) * GENERIC_FOLDS * n // len(picks) % GENERIC_FOLDS for n in parts]
    moves = ~rests_of(s, j)[picks]
    if s.q.shape[1] > FEW_JOINTS or moves.sum() < LEAST_ROWS:
        moves[:] = True
    nothing = values - np.mean(values[moves])

    def left_by(X: np.ndarray, fold: np.ndarray) -> np.ndarray:
        found = [nothing, *(np.empty_like(values) for _ in RIDGES)]
        for k in range(GENERIC_FOLDS):
            train, rest = moves & (fold != k), fold == k
            X_train, X_rest = X[train], X[rest]
            # Of a second copy: numpy multiplies an array with itself by another routine, with other last digits.
            gram, seen = X_train.T @ X[train], X_train.T @ values[train]
            for ridge, left in zip(RIDGES, found[1:], strict=True):
                A = gram + ridge * max(train.sum(), 1) * np.eye(X.shape[1])
                left[rest] = values[rest] - X_rest @ np.linalg.solve(A, seen)
        return least_of(found)

    def least_of(found: list[np.ndarray]) -> np.ndarray:
        return min(found, key=lambda x: float(np.mean(x[moves] ** 2)))

    by_columns = [[left_by(X, fold) for fold in folds] for X in generic_bases(model, s, j, picks)]
    return least_of([left for by_fold in by_columns for left in by_fold]), by_columns[-1][0]


def generic_bases(model: RigidModel, s: Session, j: int, picks: np.ndarray) -> list[np.ndarray]:
    """Columns of generic corrections at the rows ``picks``, each (rows, k) and of unit size: one basis, then more.

    Shapes of the speed with load and acceleration; loops; forces by place and direction in few bins and in many.
    """
    finest = int(np.clip(len(picks) // 20, 12, GENERIC_BINS))
    rigid = _at_rows(rigid_columns(model, s, j), s, j, picks)
    looped = np.hstack([rigid, _at_rows(loops(s, j), s, j, picks)])
    fine = np.hstack([looped, _at_rows(by_place(s, j, finest), s, j, picks)])
    if s.q.shape[1] > FEW_JOINTS:
        return [fine]
    coarse = [np.hstack([looped, _at_rows(by_place(s, j, bins), s, j, picks)]) for bins in COARSE_BINS]
    return [rigid, looped, *coarse, fine]


def _at_rows(columns: list[np.ndarray], s: Session, j: int, picks: np.ndarray) -> np.ndarray:
    """Columns as efforts are compared, of unit size, shape (rows, k)."""
    if not columns:
        return np.zeros((len(picks), 0))
    X = np.stack([compare(c, s, j, True)[picks] for c in columns], axis=1)
    return X / (np.sqrt(np.mean(X**2, axis=0)) + 1e-12)


def rigid_columns(model: RigidModel, s: Session, j: int) -> list[np.ndarray]:
    """Speed shapes, acceleration, load and its derivatives, and what a wrench presses on the joint's bearing."""
    v, a = s.v[:, j], s.a[:, j]
    sign, top = s.sign(j), np.max(np.abs(v)) + 1e-12
    columns = [np.ones_like(v), v, np.abs(v), v * np.abs(v)]
    columns += [sign * np.exp(-((v / (share * top)) ** 2)) for share in (0.02, 0.1, 0.3)]
    # Late or lagging drives leave derivatives of the load. The effort itself is no column: with the load it spans
    # the residual exactly, and any floor would come out.
    if s.driven(j):
        late = np.gradient(s.load[:, j], s.dt)
        columns += [a, s.load[:, j], np.abs(s.load[:, j]) * sign, late, np.gradient(late, s.dt)]
    columns += [s.load[:, i] for i in range(s.q.shape[1]) if i != j]
    if 1 < s.q.shape[1] <= FEW_JOINTS:  # a heavier second link follows no shape of this joint's own motion
        numbers = [p for body in model.jointed_bodies() for p in body_parameters(model, body)]
        columns += [x for p in numbers if np.any(x := p.column(s)[:, j])]
    if s.q.shape[1] > FEW_JOINTS:  # no shape of one joint's place follows what the others do to its gravity
        columns += [load[:, j] for load in tilted_loads(model, s)]
    pressed = wrench_parts(model, s, j)
    if pressed is not None:
        columns += [pressed.across * sign, pressed.racking * sign]
    return columns


def by_place(s: Session, j: int, bins: int) -> list[np.ndarray]:
    """Force and friction by place: hats over the range, each alone and times the direction."""
    q, sign = s.q[:, j], s.sign(j)
    edges = np.linspace(q.min(), q.max() + 1e-12, bins)
    width = edges[1] - edges[0] + 1e-12
    hats = [np.maximum(0.0, 1.0 - np.abs(q - centre) / width) for centre in edges]
    return [column for hat in hats for column in (hat, hat * sign)]


def loops(s: Session, j: int) -> list[np.ndarray]:
    """Stop operators of several widths and their cubes: any loop at reversals, a dead zone included.

    Prandtl and Ishlinskii's superposition of them approximates rate-independent loops.
    """
    found = []
    for width in float(np.ptp(s.q[:, j])) * np.array(LOOP_SHARES):
        if width > 2.0 * s.q_lsb[j]:
            z = stop_operator(s, j, float(width))
            found += [z, z**3]
    return found


def rms_doubt(samples: list[np.ndarray]) -> float:
    """One and a half standard deviations of an rms of correlated samples, as a factor above one."""
    effective = 0.0
    for x in samples:
        rho = float(np.clip(np.mean(x[1:] * x[:-1]) / max(float(np.mean(x**2)), 1e-30), 0.0, 0.99))
        effective += len(x) * (1.0 - rho) / (1.0 + rho)
    return 1.0 + 1.5 / np.sqrt(2.0 * max(effective, 2.0))
