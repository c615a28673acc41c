"""Rows of the regression: one joint in one recording, filtered to the band in which efforts are compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from s2r_host.gap.effects.base import count_reversals
from s2r_host.gap.motion.known_noise import motion_density
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.rest import stillness
from s2r_host.gap.motion.session import Session, lowpass, nominal_friction

HOLDOUT_SHARE = 0.3
MOVES = 0.5  # stillness below which a joint moves
STROKE_PARTS = 10
LEAST_CUT_HZ = 2.5
ROWS_PER_CUT = 2.4  # rows per period of the cut
KEPT_SHARE = 0.7  # of a recording, after the margins at its ends
LEAST_ROWS = 32  # a recording with fewer holds nothing to learn from and to predict
COMPANY_ROWS = (
    12  # the same beside other recordings of the motion, which check it: touches of a part are short
)
SLOPE_CUT_HZ = 50.0
SIGNAL_TO_NOISE = 20.0
SIGNAL_TO_GUESS = 3.0  # against a leftover, which is noise and model error together


@dataclass
class Block:
    """Rows of one joint in one recording."""

    session: Session
    joint: int
    rows: slice
    picks: np.ndarray
    held: np.ndarray


def compare(x: np.ndarray, s: Session, joint: int, nonlinear: bool) -> np.ndarray:
    """Bring a signal to the comparison band; what was not made from filtered motion passes both filters."""
    return lowpass(
        x, float(s.cut[joint]), s.dt, before_hz=float(s.motion_cut[joint]) if nonlinear else np.inf
    )


def residual(model: RigidModel, s: Session, joint: int) -> np.ndarray:
    """Filtered effort minus what the nominal model needs, shape (time,).

    An effort that a controller of known rate holds for its period acts half a period late on average.
    """
    rate = s.rec.controller.rate_hz
    late = 0.5 / rate if rate else 0.0
    rigid = compare(s.load[:, joint], s, joint, False)
    friction = compare(nominal_friction(model, s)[:, joint], s, joint, True)
    return compare(s.u[:, joint] - late * effort_slope(s, joint), s, joint, True) - rigid - friction


def effort_slope(s: Session, joint: int) -> np.ndarray:
    """Change of the recorded effort per second, shape (time,)."""
    return np.gradient(lowpass(s.u[:, joint], min(SLOPE_CUT_HZ, s.rec.band_hz), s.dt), s.dt)


def make_blocks(
    model: RigidModel, sessions: list[Session], hold: list[Session], joints: list[int]
) -> tuple[list[Block], list[np.ndarray]]:
    """Blocks of all joints and recordings, and their residual efforts; without ``hold`` 30 % of each are held.

    Recordings too short for the band in which efforts are compared are left out, those in company later.
    """
    blocks: list[Block] = []
    raw: list[np.ndarray] = []
    start, least = 0, least_rows(sessions)
    for s in sessions:
        for j in joints:
            if not s.has_u[j]:
                continue
            picks = picks_of(s, j)
            if len(picks) < least:
                continue
            rows = slice(start, start + len(picks))
            start += len(picks)
            held = np.full(len(picks), s in hold)
            if not hold:
                held = held_inside(s, picks, alone=len(sessions) == 1)
            blocks.append(Block(s, j, rows, picks, held))
            raw.append(residual(model, s, j)[picks])
    return blocks, raw


def held_inside(s: Session, picks: np.ndarray, *, alone: bool) -> np.ndarray:
    """Which rows of a recording are held out where no other recording is: its end, shape (rows,).

    A stroke, in which no joint turns round, brakes at its end and goes slowly nowhere else: with that held out nothing
    that depends on speed could be learnt. Of several strokes, which check each other, it is three of ten stretches of
    each. What one stroke ``alone`` says of places it has not seen only its end can try. A rest before or after all
    motion is no part of it: where nothing moves, nothing can be predicted.
    """
    if alone or any(count_reversals(s, j) for j in range(s.q.shape[1])):
        moving = np.flatnonzero(
            (np.stack([stillness(s, j) for j in range(s.q.shape[1])]) < MOVES).any(axis=0)
        )
        first, last = (moving[0], moving[-1] + 1) if moving.size else (0, len(s.t))
        return picks >= first + (1.0 - HOLDOUT_SHARE) * (last - first)
    return (np.arange(len(picks)) * STROKE_PARTS // len(picks)) % 3 == 1


def band(
    model: RigidModel,
    j: int,
    fit: list[Session],
    blocks: list[Block],
    noise: list[np.ndarray],
    *,
    guessed: bool,
) -> float:
    """Highest frequency at which the effort still stands well above the noise [Hz].

    Beyond it a regressor is made of noise, and whatever filters that noise would look like physics: the
    direct method of closed-loop identification is biased there (Janot et al., IDIM-IV, 2014). Feedback puts the noise
    of a speed into the effort, so that a correction that holds both takes it for physics, too: noise that is guessed so
    is at least what the channels of the motion show.
    """
    least = SIGNAL_TO_GUESS if guessed else SIGNAL_TO_NOISE
    efforts: list[np.ndarray] = []
    block = max((b for b in blocks if b.joint == j), key=lambda b: len(b.picks))
    s = block.session
    rate = 1.0 / (s.dt * float(block.picks[1] - block.picks[0]))
    length = min(256, len(block.picks) // 3)
    f = np.zeros(0)
    for b in blocks:
        if (
            b.joint == j and b.session in fit and len(b.picks) >= length
        ):  # shorter ones have other frequencies
            f, p = welch(compare(b.session.u[:, j], b.session, j, True)[b.picks], rate, nperseg=length)
            efforts.append(p)
    powers = [welch(x, rate, nperseg=min(length, len(x)))[1] for x in noise]
    powers = [p for p in powers if len(p) == len(f)]
    if not efforts or not powers:
        return float(s.cut[j])
    power_u, power_n = np.mean(efforts, axis=0), np.maximum(np.mean(powers, axis=0), 1e-30)
    if guessed:  # what the channels show is no guess
        shown = np.mean([motion_density(model, x, j, f) for x in fit if x.has_u[j]], axis=0)
        power_n = np.maximum(power_n, shown * SIGNAL_TO_NOISE / SIGNAL_TO_GUESS)
    strong = np.flatnonzero((power_u / power_n > least) & (f <= s.cut[j]))
    highest = float(f[strong[-1]]) if strong.size else 0.0
    return float(np.clip(1.5 * highest, LEAST_CUT_HZ, s.cut[j]))


def least_rows(sessions: list[Session]) -> int:
    """Rows below which a recording among these is left out."""
    return LEAST_ROWS if len(sessions) == 1 else COMPANY_ROWS


def least_cut(s: Session) -> float:
    """Cut below which a recording would hold too few rows [Hz]."""
    return LEAST_ROWS / (ROWS_PER_CUT * KEPT_SHARE * max(float(s.t[-1] - s.t[0]), s.dt))


def picks_of(s: Session, joint: int) -> np.ndarray:
    """Which steps of the work grid become rows, shape (rows,)."""
    step = max(1, int(1.0 / (ROWS_PER_CUT * float(s.cut[joint]) * s.dt)))
    # Filters ring at the ends of a record for about a period of their cut.
    margin = max(3, min(int(max(0.15, 1.5 / float(s.cut[joint])) / s.dt), len(s.t) // 8))
    return np.arange(margin, len(s.t) - margin, step)
