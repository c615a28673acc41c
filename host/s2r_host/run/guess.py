"""A guess about what may turn, and what pushes tell of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from s2r_host.motion.lever_axes import UP
from s2r_host.motion.push_proposals import PushProposal

ABOUT_M = 0.04  # a push that touched this near to a piece was about it
ALIKE_M = 0.006  # and about another that is so little further away: pieces overlap
SAME_M = 0.025  # two pushes that touched closer than this touched the same place
SAME_WAY = 0.7  # cosine
# How likely a push ends like this, about a piece and along its line, if that piece and line are right.
HELD_OUT = 0.25  # it may have been at its stop
HELD_OUT_TWICE = 0.03  # both ways
MISSED = 0.5  # nothing in the way, and nothing moved
MOVED, SEEN_MOVED = 3.0, 10.0  # over what is to be expected of anything else; by depth alone, and by colours


@dataclass(frozen=True, eq=False)
class Tried:
    """A push that was carried out and told no joint.

    Attributes:
        p_contact: Where the tip touched [m], (3,).
        direction: Unit direction of the push, (3,).
        held_out: It was stopped by what it met.
        moved: It gave way, as far as the views tell that were taken before and after the push.
        sure: That is told by colours.
    """

    p_contact: np.ndarray
    direction: np.ndarray
    held_out: bool
    moved: bool
    sure: bool = False


@dataclass(frozen=True, eq=False)
class Guess:
    """A piece of a view that may turn, and how.

    Attributes:
        p: Its points [m], (n, 3).
        line: Unit direction along which, either way, it gives way, (3,).
        p_free, p_held: Its free end, which is pushed, and the one it turns about [m], (3,); None where unknown.
        p_axis: A point of the upright axis that a knob turns about [m], (3,); None where unknown.
        weight: Against other guesses; not normalised.
        by_shape: The same if the network's beliefs say nothing.
        proposals: Ways to push it, best first, without those that were tried.
        turns: It is a knob: ``line`` is one of the many along which it gives way.
        p_felt_for: Where it is felt for beyond what is seen of it [m], (m, 3); None where that is nowhere.
    """

    p: np.ndarray
    line: np.ndarray
    weight: float
    by_shape: float
    proposals: Iterator[PushProposal]
    p_free: np.ndarray | None = None
    p_held: np.ndarray | None = None
    p_axis: np.ndarray | None = None
    turns: bool = False
    p_felt_for: np.ndarray | None = None

    def gap_m(self, p: np.ndarray) -> float:
        """How far a point (3,) is from the piece, or from where it is felt for [m]."""
        own = self.p if self.p_felt_for is None else np.concatenate([self.p, self.p_felt_for])
        return float(np.linalg.norm(own - p, axis=1).min())

    def way(self, push: Tried | PushProposal) -> np.ndarray:
        """Which way a push goes: of a knob, which gives way all around, the axis in whose sense it turns, (3,)."""
        if self.p_axis is None:
            return push.direction
        turn = np.cross(push.p_contact - self.p_axis, push.direction)
        return np.asarray(np.sign(turn[2]) * UP)

    def at_free_end(self, p: np.ndarray) -> bool:
        """Whether a point (3,) is nearer to the free end than to the other."""
        if self.p_free is None or self.p_held is None:
            return True
        return bool(np.linalg.norm(p - self.p_free) <= np.linalg.norm(p - self.p_held))


def evidence(guesses: Sequence[Guess], tried: Sequence[Tried]) -> np.ndarray:
    """How likely all pushes so far end as they did if a guess is right, against if it is wrong, for each, (n,)."""
    factors = np.ones(len(guesses))
    if not len(guesses) or not tried:
        return factors
    gap_m = np.array([[guess.gap_m(push.p_contact) for guess in guesses] for push in tried])
    about = (gap_m < ABOUT_M) & (gap_m <= gap_m.min(axis=1, keepdims=True) + ALIKE_M)
    for k, guess in enumerate(guesses):
        factors[k] = _told(guess, [push for push, near in zip(tried, about[:, k], strict=True) if near])
    return factors


def _told(guess: Guess, about: Sequence[Tried]) -> float:
    """What the pushes that were about a guess tell of it."""
    factor = 1.0
    held_ways: list[np.ndarray] = []
    for push in about:
        along = guess.turns or abs(float(guess.line @ push.direction)) > SAME_WAY
        if push.moved:
            factor *= SEEN_MOVED if push.sure else MOVED
        elif along and guess.at_free_end(push.p_contact):
            if push.held_out:
                held_ways.append(guess.way(push))
            else:
                factor *= MISSED
    if held_ways:
        both = any(way @ held_ways[0] < 0.0 for way in held_ways)
        factor *= HELD_OUT_TWICE if both else HELD_OUT
    return factor


def untried(guess: Guess, tried: Sequence[Tried]) -> Iterator[PushProposal]:
    """Without what was tried in vain: the same place the same way, or a way in which the piece held out.

    Where it gave way last it is pushed on first: what several pushes moved adds up. A knob is pushed the way it held
    out, too, once nothing else is left: a fingertip that jams beside one spoke may turn it by another.
    """
    about = [
        one for one in tried if guess.gap_m(one.p_contact) < ABOUT_M and guess.at_free_end(one.p_contact)
    ]
    held = [guess.way(one) for one in about if one.held_out and not (guess.turns and one.moved)]
    gave_way = [guess.way(one) for one in about if one.moved and one.sure][-1:]
    other, later = [], []
    for push in guess.proposals:
        again = any(
            push.direction @ one.direction > SAME_WAY
            and np.linalg.norm(push.p_contact - one.p_contact) < SAME_M
            for one in tried
            if not one.moved
        )
        if again:
            continue
        way = guess.way(push)
        if any(way @ one >= SAME_WAY for one in held):
            later.append(push)
        elif any(way @ one < SAME_WAY for one in gave_way):
            other.append(push)
        else:
            yield push
    yield from other
    if guess.p_axis is not None:
        yield from later
