"""How a straight piece of a faucet looks: whether it is the lever, which way it goes, and about which of its ends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_host.motion.lever_axes import aside_m, level_axis, upright_axis
from s2r_host.motion.levers import LeverCandidate

# Logits fitted on drawn faucets that nothing is reported of: `python tests/bench/bench_lever_guesses.py --fit`.
IS_LEVER = (-0.66, -0.01, 1.17, -0.95, 2.16, -4.39, -4.03, -0.39, -1.30, 1.15)  # of `lever_features`
SWINGS = (-3.21, 5.27, 1.40, -3.31, -0.60, 2.80)  # of `swing_features`
# The same without what the network believes.
IS_LEVER_BY_SHAPE = (-0.32, 0.28, 0.0, -1.42, 0.0, -4.40, -3.84, -0.49, -1.34, 1.41)
SWINGS_BY_SHAPE = (-3.44, 5.89, 0.0, -3.58, -0.45, 2.79)
# Ends of two pieces this near are one place; so much lower, and at an angle of that cosine, the spout goes on there.
MEET_M, LOWER_M, BENT = 0.03, 0.01, 0.95
BESIDE_M = 0.025  # by which a line passes the body's axis if the lever is at the side of the body
# Of two handles that look alike: difference of the sines of their rise, ratio of their lengths.
ALIKE_RISE, ALIKE_LENGTH = 0.2, 1.6
# How often the end that was taken for the tip is the one that the piece turns about, in views of drawn faucets that
# nothing is reported of: where the piece leads down, where a piece on a foot of its own is level, and else.
LEADS_DOWN_M, LEVEL_M = -0.015, 0.005
WRONG_END_DOWN, WRONG_END_LEVEL, WRONG_END = 0.75, 0.25, 0.03


def odds_of(levers: Sequence[LeverCandidate], beliefs: Sequence[float]) -> np.ndarray:
    """Odds that each of some straight pieces is the lever: with the network's belief in each, and without, (n, 2).

    Of two handles that look alike one is as likely as the other, whatever else speaks for one of them in the view.
    """
    looks = np.array([lever_features(levers, k, beliefs) for k in range(len(levers))]).reshape(
        -1, len(IS_LEVER)
    )
    odds = np.exp(looks @ np.array([IS_LEVER, IS_LEVER_BY_SHAPE]).T)
    alike = np.array([[_alike(a, b) for b in levers] for a in levers], float).reshape(len(odds), len(odds))
    return np.asarray(alike @ odds / alike.sum(axis=1, keepdims=True))


def _alike(a: LeverCandidate, b: LeverCandidate) -> bool:
    """Whether two pieces are the handles of a pair: each on a foot of its own, rising alike, about as long."""
    if a is b:
        return True
    length_m = [float(np.linalg.norm(one.p_tip - one.p_root)) for one in (a, b)]
    rise = abs(float(a.direction[2] - b.direction[2]))
    return a.rooted and b.rooted and rise < ALIKE_RISE and max(length_m) < ALIKE_LENGTH * min(length_m)


def swinging(lever: LeverCandidate, believed: np.ndarray) -> np.ndarray:
    """Chance that it swings: with the line of motion that the network believes in, (3,), and without, (2,)."""
    looks = swing_features(lever, believed)
    return np.asarray(1.0 / (1.0 + np.exp([-np.dot(SWINGS, looks), -np.dot(SWINGS_BY_SHAPE, looks)])))


def lever_features(levers: Sequence[LeverCandidate], k: int, beliefs: Sequence[float]) -> tuple[float, ...]:
    """What tells whether the k-th of some straight pieces is the lever; ``beliefs``: the network's in each.

    One; its doubt; the belief; either over that of the best other piece; whether there is no other; whether another
    one leads down from where it ends, as a spout's does; whether it begins where another ends; whether it hangs on
    the body while another has a foot of its own, as the spout between two handles does; the sine of its rise.
    """
    lever, others = levers[k], [*levers[:k], *levers[k + 1 :]]
    over = lever.doubt - min((other.doubt for other in others), default=lever.doubt)
    belief = beliefs[k]
    more = belief - max((*beliefs[:k], *beliefs[k + 1 :]), default=belief)
    leads_down = any(_bends_down(lever, other) for other in others)
    follows = any(_meet(lever.p_root, other.p_tip) for other in others)
    hangs = not lever.rooted and any(other.rooted for other in others)
    flags = (float(flag) for flag in (not others, leads_down, follows, hangs))
    return 1.0, lever.doubt, belief, over, more, *flags, float(lever.direction[2])


def _bends_down(lever: LeverCandidate, other: LeverCandidate) -> bool:
    """Whether another piece goes on from the tip of one, downwards and at an angle."""
    meets = _meet(lever.p_tip, other.p_root) or _meet(lever.p_tip, other.p_tip)
    lower = bool(other.p[:, 2].mean() < lever.p_tip[2] - LOWER_M)
    return meets and lower and abs(float(lever.direction @ other.direction)) < BENT


def _meet(p: np.ndarray, q: np.ndarray) -> bool:
    return bool(np.linalg.norm(p - q) < MEET_M)


def swing_features(lever: LeverCandidate, believed: np.ndarray) -> tuple[float, ...]:
    """What tells whether a lever swings beside the body; ``believed``: the network's line of motion, (3,).

    One; its steepness; how much more the network's line is that of a swing; how straight it leads away from the body;
    whether it has a foot of its own; whether its line passes beside the body's axis.
    """
    about_level, about_upright = level_axis(lever).way(lever.p_tip), upright_axis(lever).way(lever.p_tip)
    margin = abs(float(believed @ about_level)) - abs(float(believed @ about_upright))
    beside = not lever.rooted and aside_m(lever) > BESIDE_M
    return 1.0, abs(float(lever.direction[2])), margin, lever.radial, float(lever.rooted), float(beside)


def wrong_end(lever: LeverCandidate) -> float:
    """Chance that the piece turns about the end that was taken for its tip."""
    rise_m = float(lever.p_tip[2] - lever.p_root[2])
    if not lever.rooted:
        return WRONG_END_DOWN if rise_m < LEADS_DOWN_M else WRONG_END
    return WRONG_END_LEVEL if rise_m < LEVEL_M else WRONG_END
