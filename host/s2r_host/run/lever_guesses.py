"""What may turn, and along which line: a belief over the pieces of a view, from how they look and from past pushes.

A guess is a piece and a line. Its weight is the chance that the piece is the lever, times the chance that a lever
that looks like this moves along that line, times how likely each push so far would have ended as it did.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from s2r_host.errors import SceneError
from s2r_host.motion.knob_proposals import knob_proposals
from s2r_host.motion.knobs import LOW_BAND_M, Knob, find_knobs, knob_deck
from s2r_host.motion.lever_axes import UP, LeverAxis, aside_m, level_axis, upright_axis, with_room_first
from s2r_host.motion.lever_proposals import LeverPushSettings, lever_proposals
from s2r_host.motion.levers import (
    COLUMN_RADIUS_M,
    DECK_BAND_M,
    LeverCandidate,
    column,
    deck_height,
    find_levers,
    pieces,
)
from s2r_host.motion.push_proposals import PushProposal
from s2r_host.motion.scene import Scene
from s2r_host.perception.affordance import Affordance
from s2r_host.perception.knob_outline import KnobOutline
from s2r_host.perception.network_pushes import NetworkPushSettings, proposals_of

# Logits fitted on drawn faucets that nothing is reported of: `python tests/bench/bench_lever_guesses.py --fit`.
IS_LEVER = (-0.58, -0.07, 1.14, -0.87, 2.34, -4.36, -3.73, -0.73, -0.55, 0.97)  # of `lever_features`
SWINGS = (-3.48, 5.51, 1.45, -3.18, -0.50, 2.77)  # of `swing_features`
# The same without what the network believes. In some views that is nonsense, which pushes that fail soon tell.
IS_LEVER_BY_SHAPE = (-0.31, 0.28, 0.0, -1.38, 0.0, -4.47, -3.48, -1.00, -0.63, 1.16)
SWINGS_BY_SHAPE = (-3.85, 6.19, 0.0, -3.29, -0.30, 2.80)
MISLED = 0.5  # chance of that
# Ends of two pieces this near are one place; so much lower, and at an angle of that cosine, the spout goes on there.
MEET_M, LOWER_M, BENT = 0.03, 0.01, 0.95
BESIDE_M = 0.025  # by which a line passes the body's axis if the lever is at the side of the body
# A piece that only the network sees; such pieces were on the part in a quarter of the views.
SEEN_BY_NETWORK = 0.25
BELIEVED = 0.4  # belief that a point belongs to the part, from which on it is taken for a piece of it
# Such a piece mostly is the lever on top of the body, half hidden by the spout: it turns about the body's axis. The
# network's line of its motion is off by 30 degrees and more there.
ON_BODY, LEAST_REACH_M, FAR_END = 0.75, 0.035, 90.0  # chance; radius of its far end; percentile of its points
USUAL_WIDTH_M = 0.025  # of a lever as a camera sees it
LEAST_POINTS = 100
KNOB_DEPTH_M = 0.014  # least way of the fingertip: the spoke of a knob is short
# Odds of a knob whose spokes colours tell: what has them is there to be turned. With two it may be a piece of a bar.
OUTLINED, OUTLINED_BAR = 50.0, 3.0
# A hub on the deck without anything that leads away from it: its lever points at the camera. Odds; widest and highest
# that a hub is; how far from the body and from what other levers turn about; how far out and
# up from its top the lever is felt for.
HUB, HUB_WIDTH_M, HUB_HEIGHT_M, HUB_APART_M = 0.7, 0.055, 0.06, 0.05
OUT_M, RISE_M = 0.06, 0.02
OWN = 0.5  # share of a piece's points that are a knob's, from which on it is no lever of its own
UNDECIDED = 0.5  # belief of a network that says nothing
KNOB = 1.5  # odds of a knob with spokes that the network fully believes in, against one it does not at all

# How often the end that was taken for the tip is the one that the piece turns about, in views of drawn faucets that
# nothing is reported of: where the piece leads down, where a piece on a foot of its own is level, and else.
LEADS_DOWN_M, LEVEL_M = -0.015, 0.005
WRONG_END_DOWN, WRONG_END_LEVEL, WRONG_END = 0.75, 0.25, 0.03

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


@dataclass(frozen=True, eq=False)
class GuessSettings:
    """Geometry of the pushes on levers, and on what only the network sees."""

    lever_push: LeverPushSettings = field(default_factory=LeverPushSettings)
    network_push: NetworkPushSettings = field(default_factory=NetworkPushSettings)


def lever_guesses(
    scene: Scene,
    found: Affordance,
    settings: GuessSettings,
    tried: Sequence[Tried] = (),
    outlined: Sequence[KnobOutline] = (),
) -> list[Guess]:
    """All guesses about a view, the likeliest first.

    Args:
        scene: Observed points.
        found: The push network's verdict on the same view.
        settings: Geometry of the pushes.
        tried: Pushes that told nothing, in this view or in earlier ones.
        outlined: Knobs whose outline is known, as they stand in this view.
    """
    try:
        levers = find_levers(scene)
    except SceneError:
        levers = []
    guesses = [
        guess for k in range(len(levers)) for guess in _about_lever(levers, k, found, settings.lever_push)
    ]
    knobs = [knob for knob in find_knobs(scene) if not any(one.covers(knob.p).any() for one in outlined)]
    guesses += [_about_knob(knob, found, settings.lever_push) for knob in knobs]
    shown = [guess for one in outlined if (guess := _about_outlined(one, scene, found)) is not None]
    known = [*(one.p for one in levers), *(one.p for one in knobs), *(one.p for one in shown)]
    guesses = [g for g in guesses if not any(one.covers(g.p).mean() > OWN for one in outlined)] + shown
    guesses += _about_the_rest(scene, known, found, settings)
    taken = [*(one.p_root for one in levers if one.rooted), *(one.spokes[0].p_root for one in knobs)]
    guesses += _about_hubs(scene, [*taken, *(one.p_axis for one in outlined)], found, settings.lever_push)
    weights = [
        chance * _evidence(guess, guesses, tried)
        for chance, guess in zip(_chances(guesses), guesses, strict=True)
    ]
    return [
        replace(guesses[k], weight=weights[k], proposals=_untried(guesses[k], tried))
        for k in np.argsort(weights, kind="stable")[::-1]
    ]


def _chances(guesses: Sequence[Guess]) -> np.ndarray:
    """How likely each guess is before any push (n,): with the network's beliefs, or without where they are nonsense."""
    weights = np.array([(guess.weight, guess.by_shape) for guess in guesses]).reshape(-1, 2)
    shares = weights / np.maximum(weights.sum(axis=0), 1e-12)
    return np.asarray(shares @ (1.0 - MISLED, MISLED))


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


def belief_about(found: Affordance, p: np.ndarray) -> tuple[float, np.ndarray]:
    """Mean belief that points (n, 3) belong to what moves, and the line along which they would, (3,)."""
    index = cKDTree(found.cloud.points).query(p)[1]
    part, line = found.part[index], found.line[index]
    return float(part.mean()), np.linalg.eigh(np.einsum("n,ni,nj->ij", part, line, line))[1][:, -1]


def _about_lever(
    levers: Sequence[LeverCandidate], k: int, found: Affordance, settings: LeverPushSettings
) -> Iterator[Guess]:
    """A straight piece may turn about an upright axis, or swing beside the body; about either end."""
    lever = levers[k]
    beliefs = [belief_about(found, other.p)[0] for other in levers]
    believed = belief_about(found, lever.p)[1]
    looks, swing = lever_features(levers, k, beliefs), swing_features(lever, believed)
    odds = np.exp([np.dot(IS_LEVER, looks), np.dot(IS_LEVER_BY_SHAPE, looks)])
    swings = 1.0 / (1.0 + np.exp([-np.dot(SWINGS, swing), -np.dot(SWINGS_BY_SHAPE, swing)]))
    wrong = wrong_end(lever)
    for one, share in ((lever, 1.0 - wrong), (lever.turned_round(), wrong)):
        for axis, chance in ((upright_axis(one), 1.0 - swings), (level_axis(one), swings)):
            pushes = lever_proposals(one, with_room_first(axis, one), settings)
            weight, by_shape = (float(one) for one in odds * share * chance)
            yield Guess(lever.p, axis.way(one.p_tip), weight, by_shape, pushes, one.p_tip, one.p_root)


def _about_knob(knob: Knob, found: Affordance, settings: LeverPushSettings) -> Guess:
    """A knob is turned by any of its spokes, first by the ones that stand out most; its axis is known."""
    belief, _ = belief_about(found, knob.p)
    exact = replace(settings, depth_m=(KNOB_DEPTH_M, settings.depth_m[1]))
    spokes = [(spoke, LeverAxis(spoke.p_root, UP)) for spoke in knob.spokes]
    pushes = chain.from_iterable(lever_proposals(spoke, axis, exact) for spoke, axis in spokes)
    first, axis = spokes[0]
    line, weight, by_shape = axis.way(first.p_tip), KNOB * belief, KNOB * UNDECIDED
    return Guess(knob.p, line, weight, by_shape, pushes, p_axis=first.p_root, turns=True)


def _about_outlined(outline: KnobOutline, scene: Scene, found: Affordance) -> Guess | None:
    """A knob whose outline is known; None where the view shows nothing of it."""
    p = scene.p_base[outline.covers(scene.p_base)]
    if len(p) < LEAST_POINTS:
        return None
    belief, _ = belief_about(found, p)
    odds = OUTLINED if outline.spokes > 2 else OUTLINED_BAR
    angle = outline.angle
    line = np.array([-np.sin(angle), np.cos(angle), 0.0])
    weight, by_shape = odds * (UNDECIDED + belief), odds * 2.0 * UNDECIDED
    return Guess(p, line, weight, by_shape, knob_proposals(outline), p_axis=outline.p_axis, turns=True)


def _about_hubs(
    scene: Scene, taken: Sequence[np.ndarray], found: Affordance, settings: LeverPushSettings
) -> Iterator[Guess]:
    """Hubs that stand apart on the deck, of what points at the camera: no straight piece leads away from them.

    Args:
        scene: Observed points.
        taken: What known levers and knobs turn about [m], (3,) each.
        found: The network's verdict.
        settings: Geometry of the pushes.
    """
    deck_m = knob_deck(scene.p_base)
    above = scene.p_base[scene.p_base[:, 2] > deck_m + LOW_BAND_M]
    if len(above) < LEAST_POINTS:
        return
    p_body = column(above, deck_m, scene.p_camera)
    for piece in pieces(above[np.linalg.norm(above[:, :2] - p_body, axis=1) > COLUMN_RADIUS_M]):
        size, middle = np.ptp(piece, axis=0), piece.mean(axis=0)
        apart_m = min(float(np.linalg.norm((middle - one)[:2])) for one in [np.append(p_body, 0.0), *taken])
        low = piece[:, 2].min() < deck_m + DECK_BAND_M and size[2] < HUB_HEIGHT_M
        if not low or max(size[:2]) > HUB_WIDTH_M or apart_m < HUB_APART_M:
            continue
        outward = (scene.p_camera - middle) * (1.0, 1.0, 0.0)
        outward /= np.linalg.norm(outward)
        p_root = np.append(middle[:2], piece[:, 2].max())
        p_tip = p_root + OUT_M * outward + RISE_M * UP
        lever = LeverCandidate(
            piece, p_root, p_tip, USUAL_WIDTH_M, 0.0, 0.0, outward, 0.0, 1.0, rooted=True, p_body=p_body
        )
        axis = with_room_first(LeverAxis(p_root, UP), lever)
        belief, _ = belief_about(found, piece)
        pushes = lever_proposals(lever, axis, settings)
        line = axis.way(p_tip)
        yield Guess(piece, line, HUB * belief, HUB * UNDECIDED, pushes, p_tip, p_root)


def wrong_end(lever: LeverCandidate) -> float:
    """Chance that the piece turns about the end that was taken for its tip."""
    rise_m = float(lever.p_tip[2] - lever.p_root[2])
    if not lever.rooted:
        return WRONG_END_DOWN if rise_m < LEADS_DOWN_M else WRONG_END
    return WRONG_END_LEVEL if rise_m < LEVEL_M else WRONG_END


def _about_the_rest(
    scene: Scene, known: Sequence[np.ndarray], found: Affordance, settings: GuessSettings
) -> Iterator[Guess]:
    """Pieces that do not look like levers or knobs, but that the network believes to move."""
    p = scene.p_base
    rest = found.part[cKDTree(found.cloud.points).query(p)[1]] >= BELIEVED
    for piece in known:
        rest &= cKDTree(piece).query(p)[0] > 0.0
    pushes = list(proposals_of(found, settings.network_push))
    deck_m = deck_height(p)
    above = p[p[:, 2] > deck_m + DECK_BAND_M]
    p_body = column(above, deck_m, scene.p_camera) if len(above) else None
    for piece in pieces(p[rest], LEAST_POINTS):
        belief, _ = belief_about(found, piece)
        weight = SEEN_BY_NETWORK * belief
        on_body = (
            None
            if p_body is None
            else _about_body(piece, p_body, deck_m, ON_BODY * weight, settings.lever_push)
        )
        if on_body is not None:
            yield on_body
            weight *= 1.0 - ON_BODY
        near = cKDTree(piece)
        own = [push for push in pushes if near.query(push.p_contact)[0] < ABOUT_M]
        if own:
            yield Guess(piece, own[0].direction, weight, 0.0, iter(own))


def _about_body(
    piece: np.ndarray, p_body: np.ndarray, deck_m: float, weight: float, settings: LeverPushSettings
) -> Guess | None:
    """A piece that turns about the body's upright axis; None where it lies too near to that."""
    away = np.linalg.norm(piece[:, :2] - p_body, axis=1)
    p_tip = np.median(piece[away >= np.percentile(away, FAR_END)], axis=0)
    reach_m = float(np.linalg.norm(p_tip[:2] - p_body))
    if reach_m < LEAST_REACH_M:
        return None
    p_root = np.append(p_body, np.median(piece[away <= np.median(away), 2]))
    outward = np.append((p_tip[:2] - p_body) / reach_m, 0.0)
    lever = LeverCandidate(
        p=piece,
        p_root=p_root,
        p_tip=p_tip,
        width_m=USUAL_WIDTH_M,
        bend=0.0,
        towards_user=float(-outward[0]),
        outward=outward,
        above_deck_m=float(piece[:, 2].min()) - deck_m,
        radial=1.0,
        rooted=False,
        p_body=p_body,
    )
    axis = LeverAxis(p_root, UP)
    proposals = lever_proposals(lever, with_room_first(axis, lever), settings)
    return Guess(piece, axis.way(p_tip), weight, 0.0, proposals, p_tip, p_root)


def _evidence(guess: Guess, guesses: Sequence[Guess], tried: Sequence[Tried]) -> float:
    """How likely all pushes so far end as they did if the guess is right, against if it is wrong."""
    factor = 1.0
    held_ways: list[np.ndarray] = []
    for push in tried:
        gap = {id(one.p): float(np.linalg.norm(one.p - push.p_contact, axis=1).min()) for one in guesses}
        about = gap[id(guess.p)] < ABOUT_M and gap[id(guess.p)] <= min(gap.values()) + ALIKE_M
        along = guess.turns or abs(float(guess.line @ push.direction)) > SAME_WAY
        if about and push.moved:
            factor *= SEEN_MOVED if push.sure else MOVED
        elif about and along and guess.at_free_end(push.p_contact):
            if push.held_out:
                held_ways.append(guess.way(push))
            else:
                factor *= MISSED
    if held_ways:
        both = any(way @ held_ways[0] < 0.0 for way in held_ways)
        factor *= HELD_OUT_TWICE if both else HELD_OUT
    return factor


def _untried(guess: Guess, tried: Sequence[Tried]) -> Iterator[PushProposal]:
    """Without what was tried in vain: the same place the same way, or a way in which the piece held out.

    Where it gave way last it is pushed on first: what several pushes moved adds up. A knob is pushed the way it held
    out, too, once nothing else is left: a fingertip that jams beside one spoke may turn it by another.
    """
    near = cKDTree(guess.p)
    about = [
        one for one in tried if near.query(one.p_contact)[0] < ABOUT_M and guess.at_free_end(one.p_contact)
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
