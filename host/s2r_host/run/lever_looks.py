"""How a straight piece of a faucet looks: whether it is the lever, which way it goes, and about which of its ends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_host.motion.lever_axes import aside_m, level_axis, upright_axis
from s2r_host.motion.levers import LeverCandidate

# Logits fitted on drawn faucets that nothing is reported of: `python tests/bench/bench_lever_guesses.py --fit`.
IS_LEVER = (-0.58, -0.07, 1.14, -0.87, 2.34, -4.36, -3.73, -0.73, -0.55, 0.97)  # of `lever_features`
SWINGS = (-3.48, 5.51, 1.45, -3.18, -0.50, 2.77)  # of `swing_features`
# The same without what the network believes.
IS_LEVER_BY_SHAPE = (-0.31, 0.28, 0.0, -1.38, 0.0, -4.47, -3.48, -1.00, -0.63, 1.16)
SWINGS_BY_SHAPE = (-3.85, 6.19, 0.0, -3.29, -0.30, 2.80)
# Ends of two pieces this near are one place; so much lower, and at an angle of that cosine, the spout goes on there.
MEET_M, LOWER_M, BENT = 0.03, 0.01, 0.95
BESIDE_M = 0.025  # by which a line passes the body's axis if the lever is at the side of the body
# How often the end that was taken for the tip is the one that the piece turns about, in views of drawn faucets that
# nothing is reported of: where the piece leads down, where a piece on a foot of its own is level, and else.
LEADS_DOWN_M, LEVEL_M = -0.015, 0.005
WRONG_END_DOWN, WRONG_END_LEVEL, WRONG_END = 0.75, 0.25, 0.03


def odds_of(levers: Sequence[LeverCandidate], k: int, beliefs: Sequence[float]) -> np.ndarray:
    """Odds that the k-th of some straight pieces is the lever: with the network's belief in each, and without, (2,)."""
    looks = lever_features(levers, k, beliefs)
    return np.exp([np.dot(IS_LEVER, looks), np.dot(IS_LEVER_BY_SHAPE, looks)])


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
