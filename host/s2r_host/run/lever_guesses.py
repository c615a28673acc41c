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

from s2r_host.motion.bars import as_bar
from s2r_host.motion.facing import find_facing
from s2r_host.motion.hubs import find_hubs
from s2r_host.motion.knob_proposals import KnobPushSettings, knob_proposals
from s2r_host.motion.knobs import Knob, find_knobs
from s2r_host.motion.lever_axes import UP, LeverAxis, level_axis, upright_axis, with_room_first
from s2r_host.motion.lever_proposals import LeverPushSettings, lever_proposals
from s2r_host.motion.levers import USUAL_WIDTH_M, LeverCandidate, levers_in, on_body
from s2r_host.motion.scene import Scene
from s2r_host.motion.standing import Standing, pieces, standing_on
from s2r_host.perception.affordance import Affordance
from s2r_host.perception.knob_outline import KnobOutline
from s2r_host.perception.network_pushes import NetworkPushSettings, proposals_of
from s2r_host.run.guess import ABOUT_M, Guess, Tried, evidence, untried
from s2r_host.run.lever_looks import odds_of, swinging, wrong_end

MISLED = 0.5  # chance that the network's beliefs are nonsense in a view, which pushes that fail soon tell
# A piece that only the network sees; such pieces were on the part in a quarter of the views.
SEEN_BY_NETWORK = 0.25
BELIEVED = 0.4  # belief that a point belongs to the part, from which on it is taken for a piece of it
# Such a piece mostly is the lever on top of the body, half hidden by the spout: it turns about the body's axis. The
# network's line of its motion is off by 30 degrees and more there.
ON_BODY, LEAST_REACH_M, FAR_END = 0.75, 0.035, 90.0  # chance; radius of its far end; percentile of its points
LEAST_POINTS = 100
KNOB_DEPTH_M = 0.014  # least way of the fingertip: the spoke of a knob is short
# Odds of a knob whose spokes colours tell: what has them is there to be turned. With two it may be a piece of a bar,
# unless its hub stands out beside them.
OUTLINED, OUTLINED_BAR = 50.0, 3.0
BAR = 0.6  # chance that a level piece as long as a bar on a hub is one
HUB = 0.7  # odds of a bare hub on the deck: its lever points at the camera
FACING = (
    3.0  # odds of what hangs before the body, in line with the camera: the end of its lever, or of its spout
)
FELT_FOR = 7  # points along that lever, a centimetre apart
OWN = 0.5  # share of a piece's points that are a knob's, from which on it is no lever of its own
UNDECIDED = 0.5  # belief of a network that says nothing
KNOB = 1.5  # odds of a knob with spokes that the network fully believes in, against one it does not at all


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
    levers = levers_in(scene)
    beliefs = [belief_about(found, lever.p) for lever in levers]
    guesses = [
        guess
        for lever, odds, (_, line) in zip(
            levers, odds_of(levers, [one for one, _ in beliefs]), beliefs, strict=True
        )
        for guess in _about_lever(lever, odds, line, settings.lever_push)
    ]
    knobs = [knob for knob in find_knobs(scene) if not any(one.covers(knob.p).any() for one in outlined)]
    guesses += [_about_knob(knob, found, settings.lever_push) for knob in knobs]
    pushes = KnobPushSettings(tip=settings.lever_push.tip)
    shown = [guess for one in outlined if (guess := _about_outlined(one, scene, found, pushes)) is not None]
    facing = find_facing(scene, [one.p for one in levers])
    guesses += [_about_facing(lever, found, settings.lever_push) for lever in facing]
    known = [one.p for one in (*levers, *facing, *knobs, *shown)]
    guesses = [g for g in guesses if not any(one.covers(g.p).mean() > OWN for one in outlined)] + shown
    guesses += _about_the_rest(scene, known, found, settings)
    taken = [*(one.p_root for one in levers if one.rooted), *(one.p_axis for one in knobs)]
    hubs = find_hubs(scene, [*taken, *(one.p_axis for one in outlined)])
    guesses += [_about_hub(hub, found, settings.lever_push) for hub in hubs]
    weights = _chances(guesses) * evidence(guesses, tried)
    return [
        replace(guesses[k], weight=weights[k], proposals=untried(guesses[k], tried))
        for k in np.argsort(weights, kind="stable")[::-1]
    ]


def _chances(guesses: Sequence[Guess]) -> np.ndarray:
    """How likely each guess is before any push (n,): with the network's beliefs, or without where they are nonsense."""
    weights = np.array([(guess.weight, guess.by_shape) for guess in guesses]).reshape(-1, 2)
    shares = weights / np.maximum(weights.sum(axis=0), 1e-12)
    return np.asarray(shares @ (1.0 - MISLED, MISLED))


def belief_about(found: Affordance, p: np.ndarray) -> tuple[float, np.ndarray]:
    """Mean belief that points (n, 3) belong to what moves, and the line along which they would, (3,)."""
    index = cKDTree(found.cloud.points).query(p)[1]
    part, line = found.part[index], found.line[index]
    return float(part.mean()), np.linalg.eigh(np.einsum("n,ni,nj->ij", part, line, line))[1][:, -1]


def _about_lever(
    lever: LeverCandidate, odds: np.ndarray, believed: np.ndarray, settings: LeverPushSettings
) -> Iterator[Guess]:
    """A straight piece may turn about an upright axis, or swing beside the body; about either end, or its middle.

    Args:
        lever: The piece.
        odds: That it is the lever: with the network's beliefs, and without, (2,).
        believed: The line of motion that the network believes in, (3,).
        settings: Geometry of the pushes.
    """
    wrong, swings = wrong_end(lever), swinging(lever, believed)
    bar = as_bar(lever)
    if bar is not None:
        weight, by_shape = (BAR * odds).tolist()
        yield _about_spokes(bar, weight, by_shape, settings)
        odds = (1.0 - BAR) * odds
    for one, share in ((lever, 1.0 - wrong), (lever.turned_round(), wrong)):
        for axis, chance in ((upright_axis(one), 1.0 - swings), (level_axis(one), swings)):
            pushes = lever_proposals(one, with_room_first(axis, one), settings)
            weight, by_shape = (odds * share * chance).tolist()
            yield Guess(lever.p, axis.way(one.p_tip), weight, by_shape, pushes, one.p_tip, one.p_root)


def _about_knob(knob: Knob, found: Affordance, settings: LeverPushSettings) -> Guess:
    """A knob that the network believes in, or not."""
    belief, _ = belief_about(found, knob.p)
    return _about_spokes(knob, KNOB * belief, KNOB * UNDECIDED, settings)


def _about_spokes(knob: Knob, weight: float, by_shape: float, settings: LeverPushSettings) -> Guess:
    """A knob is turned by any of its spokes, first by the ones that stand out most; its axis is known."""
    exact = replace(settings, depth_m=(KNOB_DEPTH_M, settings.depth_m[1]))
    spokes = [(spoke, LeverAxis(spoke.p_root, UP)) for spoke in knob.spokes]
    pushes = chain.from_iterable(lever_proposals(spoke, axis, exact) for spoke, axis in spokes)
    first, axis = spokes[0]
    line = axis.way(first.p_tip)
    return Guess(knob.p, line, weight, by_shape, pushes, p_axis=knob.p_axis, turns=True)


def _about_outlined(
    outline: KnobOutline, scene: Scene, found: Affordance, settings: KnobPushSettings
) -> Guess | None:
    """A knob whose outline is known; None where the view shows nothing of it."""
    p = scene.p_base[outline.covers(scene.p_base)]
    if len(p) < LEAST_POINTS:
        return None
    belief, _ = belief_about(found, p)
    odds = OUTLINED if outline.spokes > 2 or outline.bulges else OUTLINED_BAR
    angle = outline.angle
    line = np.array([-np.sin(angle), np.cos(angle), 0.0])
    weight, by_shape = odds * (UNDECIDED + belief), odds * 2.0 * UNDECIDED
    return Guess(
        p, line, weight, by_shape, knob_proposals(outline, settings), p_axis=outline.p_axis, turns=True
    )


def _about_hub(lever: LeverCandidate, found: Affordance, settings: LeverPushSettings) -> Guess:
    """A lever that points at the camera turns about its hub's upright axis; it is felt for where nothing is seen."""
    belief, _ = belief_about(found, lever.p)
    guess = _turning(lever, HUB * belief, HUB * UNDECIDED, settings)
    return replace(guess, p_felt_for=np.linspace(lever.p_root, lever.p_tip, FELT_FOR))


def _about_facing(lever: LeverCandidate, found: Affordance, settings: LeverPushSettings) -> Guess:
    """A lever that points at the camera turns about the body's upright axis."""
    belief, _ = belief_about(found, lever.p)
    return _turning(lever, FACING * belief, FACING * UNDECIDED, settings)


def _turning(lever: LeverCandidate, weight: float, by_shape: float, settings: LeverPushSettings) -> Guess:
    """What turns about the upright axis through its root."""
    axis = with_room_first(LeverAxis(lever.p_root, UP), lever)
    pushes = lever_proposals(lever, axis, settings)
    return Guess(lever.p, axis.way(lever.p_tip), weight, by_shape, pushes, lever.p_tip, lever.p_root)


def _about_the_rest(
    scene: Scene, known: Sequence[np.ndarray], found: Affordance, settings: GuessSettings
) -> Iterator[Guess]:
    """Pieces that do not look like levers or knobs, but that the network believes to move."""
    p = scene.p_base
    rest = found.part[cKDTree(found.cloud.points).query(p)[1]] >= BELIEVED
    for piece in known:
        rest &= cKDTree(piece).query(p)[0] > 0.0
    pushes = list(proposals_of(found, settings.network_push))
    standing = standing_on(scene)
    for piece in pieces(p[rest], LEAST_POINTS):
        belief, _ = belief_about(found, piece)
        weight = SEEN_BY_NETWORK * belief
        on_body = (
            None if standing is None else _about_body(piece, standing, ON_BODY * weight, settings.lever_push)
        )
        if on_body is not None:
            yield on_body
            weight *= 1.0 - ON_BODY
        near = cKDTree(piece)
        own = [push for push in pushes if near.query(push.p_contact)[0] < ABOUT_M]
        if own:
            yield Guess(piece, own[0].direction, weight, 0.0, iter(own))


def _about_body(
    piece: np.ndarray, standing: Standing, weight: float, settings: LeverPushSettings
) -> Guess | None:
    """A piece that turns about the body's upright axis; None where it lies too near to that."""
    p_body = standing.p_body
    away = np.linalg.norm(piece[:, :2] - p_body, axis=1)
    p_tip = np.median(piece[away >= np.percentile(away, FAR_END)], axis=0)
    if float(np.linalg.norm(p_tip[:2] - p_body)) < LEAST_REACH_M:
        return None
    root_m = float(np.median(piece[away <= np.median(away), 2]))
    lever = on_body(piece, root_m, p_tip, USUAL_WIDTH_M, standing)
    return _turning(lever, weight, 0.0, settings)
