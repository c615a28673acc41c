"""Forces that come a few times out of nothing: a push, a collision, a hand.

A guessed noise floor holds them, since no correction by position and speed predicts them. They are told from noise by
being silent most of the time: noise of sensors and drives is about as strong everywhere, and friction that is not known
to the last shows wherever the joint turns back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.gap.motion.command_steps import step_doubt
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.time_spans import time_spans
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.rows import Block

WINDOW_S = 0.2
LOUD = 5.0  # times what is usual in the recording
LONGEST_SHARE, LEAST_POWER = 0.3, 0.8  # of the time; of the power
SLOW = 0.1  # of the top speed
SLOW_SHARE = 0.5  # of the power, from which on it is the turning back that is loud
LEAST_EFFORT = 0.1  # of the effort (rms)
DECLARED = 2.0  # times the accuracy that a recording declares
LEAST_WINDOWS = 20
MERGE_S = 0.4
FAINT = 0.1  # of the strongest burst's power: numbers that give way to a push err a little elsewhere


@dataclass(frozen=True)
class Bursts:
    """An effort of one joint that is there for a small part of the time.

    Attributes:
        joint: Joint index.
        loud: Its rms then, and ``quiet`` otherwise [N·m or N].
        intervals: When it is there, in stamps of the recording [s].
        words: For the reasons of the answer.
    """

    joint: int
    loud: float
    quiet: float
    intervals: list[list[float]]
    words: str


def bursts(problem: Problem, rows: np.ndarray) -> Bursts | None:
    """The joint on which what is left over is loud for a small part of the time, None where it is not.

    Args:
        problem: Gives blocks and recordings.
        rows: What is left over, in effort units, shape (rows,).
    """
    found = [b for x in problem.blocks if (b := _in_block(problem.ctx.model, x, rows[x.rows])) is not None]
    return max(found, key=lambda b: b.loud / b.quiet) if found else None


def _in_block(model: RigidModel, block: Block, left: np.ndarray) -> Bursts | None:
    s, picks = block.session, block.picks
    left = np.where(step_doubt(s, block.joint, model.joints[block.joint])[picks] > 0.0, 0.0, left)
    per_window = max(2, round(WINDOW_S / (s.dt * float(picks[1] - picks[0]))))
    if len(left) < LEAST_WINDOWS * per_window:
        return None
    power = np.convolve(left**2, np.full(per_window, 1.0 / per_window), mode="same")
    loud = power > LOUD**2 * float(np.median(power))
    then = float(np.sum(left[loud] ** 2))
    if not loud.any() or loud.mean() > LONGEST_SHARE or then < LEAST_POWER * float(np.sum(left**2)):
        return None
    speed = np.abs(s.v[picks, block.joint])
    slow = speed < SLOW * float(np.percentile(speed, 99))
    level, quiet = (float(np.sqrt(np.mean(left[rows] ** 2))) for rows in (loud, ~loud))
    if float(np.sum(left[loud & slow] ** 2)) > SLOW_SHARE * then:
        return None
    declared = s.rec.effort_sigma.get(model.joints[block.joint], 0.0)
    if level < max(LEAST_EFFORT * float(np.std(s.u[:, block.joint])), DECLARED * declared):
        return None
    clear = loud & (power > FAINT * float(power.max()))
    spans = time_spans(s.t[picks][clear] + s.rec.start_s, MERGE_S)
    name = model.joints[block.joint]
    unit = model.effort_unit(name)
    return Bursts(
        block.joint, level, quiet, [[round(a, 3), round(b, 3)] for a, b in spans],
        f"now and then an effort of {level:.3g} {unit} acts on '{name}' that neither its motion nor its place explains "
        f"({quiet:.2g} {unit} is left over otherwise): something touches it",
    )  # fmt: skip
