"""A force that swings on at one frequency whatever the joint does: a vibration, which is no effect of the catalogue.

Lags and springs along a lively motion imitate a line far above it: two of them together explain most of it. So, where
the explanation chosen still leaves something, one sine per recording, all of one frequency, is held against it. It may
begin after the recording does, and end before it: what shakes a joint is switched on and off.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import zoom_fft

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import COMPARE_CUT_HZ, Session, lowpass, nominal_friction
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.rows import ROWS_PER_CUT, Block
from s2r_host.gap.regression.solution import Solution
from s2r_host.gap.search.beside_numbers import beside_numbers
from s2r_host.gap.search.search import Search

LEAST_HZ, PER_RECORD = 0.5, 4.0  # lowest frequency, steps of the first grid per line width
BETTER = 0.5  # power the sine may leave, in that of the explanation, in every recording
STEADY = 1.5  # ratio of its amplitudes between recordings: what swings by itself swings alike
# The same two where the sine is so many noise floors high: no lag has a line as strong in each of two recordings.
SAME, AS_WELL, LOUD = 1.15, 0.95, 4.0
MOTION_SHARE = 0.15  # of the speed asked for within a line width: there the motion itself has its line
LEAST = 0.25  # of the noise floor
MOST, LOUD_SHARE = 0.6, 0.03  # of the power left over; of the effort: a line outside the band that matters
EDGE_S, LEAST_ROWS, ALIKE_HZ = 0.5, 120, 0.1
ON, PERIODS = 0.5, 2.0  # of its usual size: where it is on; periods over which its size is read
ROUNDS = 3
ALIKE_POWER = 1e-6  # share by which a transform may err: the best frequencies are weighed one by one


def vibration(problem: Problem, search: Search, solution: Solution) -> tuple[int, float, float] | None:
    """Joint, frequency [Hz] and amplitude [N·m or N] of a steady line that explains more than a solution does.

    Amplitude and phase are free in each recording; numbers of the model may move a little beside it. Of several joints
    that swing it is the one that does so by the most noise floors.
    """
    found: list[tuple[int, float, float]] = []
    for j in problem.joints:
        blocks = [b for b in problem.blocks if b.joint == j and len(b.picks) > 1]
        if not blocks:
            continue
        f = _strongest(blocks, problem.raw, min(float(b.session.cut[j]) for b in blocks))
        if any(_moves_at(b, f, problem.ctx.model.joints[j]) for b in blocks):
            continue
        left, amplitudes = _beside_lines(problem, search, blocks, f)
        powers = [
            (float(np.mean(left[b.rows] ** 2)), float(np.mean(solution.unexplained[b.rows] ** 2)))
            for b in blocks
        ]
        ratio, weakest = max(amplitudes) / max(min(amplitudes), 1e-30), min(amplitudes) / problem.floor[j]
        swings = ratio < STEADY and weakest > LEAST and all(own < BETTER * theirs for own, theirs in powers)
        same = len(blocks) > 1 and ratio < SAME and weakest > LOUD
        if swings or (same and all(own < AS_WELL * theirs for own, theirs in powers)):
            found.append((j, f, float(np.mean(amplitudes))))
    return _loudest_joint(problem, found)


def unheard_line(problem: Problem) -> tuple[int, float, float] | None:
    """Joint, frequency [Hz] and amplitude [N·m or N] of a steady line outside the band of comparison, too.

    A line is what a guessed floor takes for noise, and the band ends where noise begins: so all of it is looked at,
    beside a rigid body with friction whose numbers are free. Of several joints it is the one of the most noise floors.
    """
    found: list[tuple[int, float, float]] = []
    for j in problem.joints:
        seen = [_loudest(problem.ctx.model, s, j) for s in problem.ctx.sessions if s.has_u[j]]
        lines = [x for x in seen if x is not None]
        if not lines or len(lines) < len(seen):
            continue
        f, amplitudes = lines[0][0], [a for _, a in lines]
        near = all(abs(other - f) < ALIKE_HZ for other, _ in lines)
        if near and max(amplitudes) < STEADY * min(amplitudes):
            found.append((j, f, float(np.mean(amplitudes))))
    return _loudest_joint(problem, found)


def _loudest_joint(
    problem: Problem, found: list[tuple[int, float, float]]
) -> tuple[int, float, float] | None:
    """The one of most noise floors, which compare N·m and N; a neighbour trembles along."""
    return max(found, key=lambda line: line[2] / problem.floor[line[0]], default=None)


def _loudest(model: RigidModel, s: Session, j: int) -> tuple[float, float] | None:
    """Frequency and amplitude of a line that is most of what a rigid body leaves over, and none of the motion's."""
    top = min(COMPARE_CUT_HZ, s.rec.band_hz)
    margin = int(EDGE_S / s.dt)
    rows = np.arange(margin, len(s.t) - margin, max(1, int(1.0 / (ROWS_PER_CUT * top * s.dt))))
    if len(rows) < LEAST_ROWS:
        return None
    u = s.u[:, j]
    columns = [
        np.ones(len(u)),
        s.sign(j),
        s.v[:, j],
        s.a[:, j],
        s.load[:, j],
        np.gradient(s.load[:, j], s.dt),
    ]
    X = np.stack([lowpass(x, top, s.dt)[rows] for x in columns], axis=1)
    y = lowpass(u - s.load[:, j] - nominal_friction(model, s)[:, j], top, s.dt)[rows]
    left = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    block = Block(s, j, slice(0, len(rows)), rows, np.zeros(len(rows), dtype=bool))
    f = _strongest([block], left, top)
    line = _line(block, left, f)
    amplitude = float(np.sqrt(2.0 * np.mean(line**2)))
    alone = float(np.mean((left - line) ** 2)) < (1.0 - MOST) * float(np.mean(left**2))
    loud = amplitude > LOUD_SHARE * float(np.std(u))
    return (f, amplitude) if alone and loud and not _moves_at(block, f, model.joints[j]) else None


def _beside_lines(
    problem: Problem, search: Search, blocks: list[Block], f: float
) -> tuple[np.ndarray, list[float]]:
    """What a sine per recording leaves over beside small changes of the numbers, shape (rows,), and its amplitudes."""
    columns = []
    for b in blocks:
        phase, on = 2.0 * np.pi * f * b.session.t, _on(b, problem.raw[b.rows], f)
        columns += [
            problem.whiten({b.session.index: on * x}, b.joint) for x in (np.sin(phase), np.cos(phase))
        ]
    left, swings = beside_numbers(problem, search, np.stack(columns, axis=1))
    return left, [float(np.hypot(*x)) for x in swings.reshape(-1, 2)]


def _on(b: Block, own: np.ndarray, f: float) -> np.ndarray:
    """Where a line in the rows of a block is on, from its first to its last time, 0 or 1, shape (time,)."""
    t = _times(b)
    turned = own * np.exp(-2.0j * np.pi * f * t)
    width = min(max(3, round(PERIODS / f / float(np.median(np.diff(t))))), len(t))
    size = np.abs(np.convolve(turned, np.ones(width) / width, mode="same"))
    there = t[size >= ON * np.median(size)]
    return ((b.session.t >= there[0]) & (b.session.t <= there[-1])).astype(float)


def _strongest(blocks: list[Block], rows: np.ndarray, top: float) -> float:
    """Frequency up to ``top`` whose sine takes most of all blocks together [Hz]."""
    span = max(float(_times(b)[-1] - _times(b)[0]) for b in blocks)
    step = 1.0 / (PER_RECORD * span)
    grid = np.arange(LEAST_HZ, max(top, LEAST_HZ + step), step)
    power = np.sum([_taken(b, rows[b.rows], grid[0], step, len(grid)) for b in blocks], axis=0)
    grid, best = grid[power >= (1.0 - ALIKE_POWER) * power.max()], LEAST_HZ
    for _ in range(ROUNDS):
        taken = [sum(float(np.sum(_line(b, rows[b.rows], f) ** 2)) for b in blocks) for f in grid]
        best = float(grid[int(np.argmax(taken))])
        step *= 0.2
        grid = best + step * np.arange(-5, 6)
    return best


def _taken(b: Block, own: np.ndarray, first: float, step: float, count: int) -> np.ndarray:
    """Squared effort that the nearest sine takes at ``count`` frequencies from ``first`` on, shape (count,).

    As ``_line`` finds it, but by one chirp transform: frequencies grow with the length of a recording as its rows do.
    """
    n, dt = len(own), float(b.session.dt * (b.picks[1] - b.picks[0]))
    turned = zoom_fft(own, [2.0 * dt * first, 2.0 * dt * (first + count * step)], count)
    theta = 2.0 * np.pi * dt * (first + step * np.arange(count))
    twice = np.sin(n * theta) / np.sin(theta) * np.exp(-1.0j * (n - 1) * theta)  # sum of exp(-2i theta k)
    cc, ss, sc = 0.5 * (n + twice.real), 0.5 * (n - twice.real), -0.5 * twice.imag
    c, s = turned.real, -turned.imag
    return (ss * c**2 - 2.0 * sc * s * c + cc * s**2) / (cc * ss - sc**2)


def _line(b: Block, own: np.ndarray, f: float) -> np.ndarray:
    """The sine of one frequency nearest to rows of a block."""
    phase = 2.0 * np.pi * f * _times(b)
    X = np.stack([np.sin(phase), np.cos(phase)], axis=1)
    return X @ np.linalg.lstsq(X, own, rcond=None)[0]


def _times(b: Block) -> np.ndarray:
    return b.session.t[b.picks]


def _moves_at(b: Block, f: float, name: str) -> bool:
    """Does the motion have a good part of its speed at this frequency?

    The motion asked for, where it is recorded: what swings by itself moves the joint as well.
    """
    t, v = _times(b), _asked_speed(b.session, b.joint, name)[b.picks]
    width = 1.0 / float(t[-1] - t[0])
    taken = np.zeros_like(v)
    for near in f + width * np.arange(-1, 2):
        taken += _line(b, v - v.mean() - taken, float(near))
    return float(np.sum(taken**2)) > MOTION_SHARE * float(np.sum((v - v.mean()) ** 2))


def _asked_speed(s: Session, joint: int, name: str) -> np.ndarray:
    """Speed of the commanded motion where the record has one, else of the joint [rad/s or m/s], shape (time,)."""
    speed = s.channel("dq_cmd", name)
    if speed is None:
        position = s.channel("q_cmd", name)
        speed = s.v[:, joint] if position is None else np.gradient(position, s.dt)
    return speed
