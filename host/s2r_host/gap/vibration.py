"""A force that swings on at one frequency whatever the joint does: a vibration, which is no effect of the catalogue.

Lags and springs along a lively motion imitate a line far above it: two of them together explain most of it. So, where
the explanation chosen still leaves something, one sine per recording, all of one frequency, is held against it.
"""

from __future__ import annotations

import numpy as np

from s2r_host.gap.problem import Problem
from s2r_host.gap.regression import TEMPER
from s2r_host.gap.rows import Block
from s2r_host.gap.search import Search
from s2r_host.gap.solution import Solution

LEAST_HZ, PER_RECORD = 0.5, 4.0  # lowest frequency, steps of the first grid per line width
BETTER = 0.5  # power the sine may leave, in that of the explanation, in every recording
STEADY = 1.5  # ratio of its amplitudes between recordings: what swings by itself swings alike
MOTION_SHARE = 0.08  # of the joint's speed within two line widths: there the motion itself has its line
ROUNDS = 3


def vibration(problem: Problem, search: Search, solution: Solution) -> tuple[int, float, float] | None:
    """Joint, frequency [Hz] and amplitude [N·m or N] of a steady line that explains more than a solution does.

    Amplitude and phase are free in each recording; numbers of the model may move a little beside it.
    """
    for j in problem.joints:
        blocks = [b for b in problem.blocks if b.joint == j and len(b.picks) > 1]
        if not blocks:
            continue
        f = _strongest(blocks, problem.raw)
        if any(_moves_at(b, f) for b in blocks):
            continue
        left, amplitudes = _beside_numbers(problem, search, blocks, f)
        powers = [
            (float(np.mean(left[b.rows] ** 2)), float(np.mean(solution.prediction[b.rows] ** 2)))
            for b in blocks
        ]
        steady = max(amplitudes) < STEADY * min(amplitudes)
        if steady and all(own < BETTER * theirs for own, theirs in powers):
            return j, f, float(np.mean(amplitudes))
    return None


def _beside_numbers(
    problem: Problem, search: Search, blocks: list[Block], f: float
) -> tuple[np.ndarray, list[float]]:
    """What a sine per recording leaves over beside small changes of the numbers, shape (rows,), and its amplitudes."""
    columns = [problem.B]
    for b in blocks:
        phase = 2.0 * np.pi * f * b.session.t
        columns += [
            problem.whiten({b.session.index: x}, b.joint)[:, None] for x in (np.sin(phase), np.cos(phase))
        ]
    X = np.concatenate(columns, axis=1)
    trust = np.concatenate([TEMPER / problem.prior**2, np.zeros(2 * len(blocks))])
    c = np.linalg.solve(X.T @ X + np.diag(trust), X.T @ problem.y)
    swing = c[problem.B.shape[1] :].reshape(-1, 2)
    return search.unwhitened(problem.y - X @ c), [float(np.hypot(*x)) for x in swing]


def _strongest(blocks: list[Block], rows: np.ndarray) -> float:
    """Frequency whose sine takes most of all blocks together [Hz]."""
    span = max(float(_times(b)[-1] - _times(b)[0]) for b in blocks)
    top = min(float(b.session.cut[b.joint]) for b in blocks)
    step = 1.0 / (PER_RECORD * span)
    grid = np.arange(LEAST_HZ, max(top, LEAST_HZ + step), step)
    best = LEAST_HZ
    for _ in range(ROUNDS):
        taken = [sum(float(np.sum(_line(b, rows[b.rows], f) ** 2)) for b in blocks) for f in grid]
        best = float(grid[int(np.argmax(taken))])
        step *= 0.2
        grid = best + step * np.arange(-5, 6)
    return best


def _line(b: Block, own: np.ndarray, f: float) -> np.ndarray:
    """The sine of one frequency nearest to rows of a block."""
    phase = 2.0 * np.pi * f * _times(b)
    X = np.stack([np.sin(phase), np.cos(phase)], axis=1)
    return X @ np.linalg.lstsq(X, own, rcond=None)[0]


def _times(b: Block) -> np.ndarray:
    return b.session.t[b.picks]


def _moves_at(b: Block, f: float) -> bool:
    """Does the joint's own motion have a good part of its speed at this frequency?"""
    t, v = _times(b), b.session.v[b.picks, b.joint]
    width = 1.0 / float(t[-1] - t[0])
    taken = np.zeros_like(v)
    for near in f + width * np.arange(-2, 3):
        taken += _line(b, v - v.mean() - taken, float(near))
    return float(np.sum(taken**2)) > MOTION_SHARE * float(np.sum((v - v.mean()) ** 2))
