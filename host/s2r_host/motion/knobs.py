"""Finding what may be a knob with spokes: a compact piece on the deck that stands apart from the faucet's body.

Cross and star knobs turn about an upright axis through their middle; a fingertip turns them by the side of a spoke.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from s2r_host.motion.levers import LeverCandidate
from s2r_host.motion.scene import Scene
from s2r_host.motion.standing import Standing, deck_height, lying, standing_on

LEAST_KNOB_POINTS = 100
LOW_BAND_M = 0.005  # above the deck: knobs may be as low as 15 mm
RADIUS_M = (0.02, 0.065)
COMPACT = 0.55  # width over length of its outline from above
MOST_HEIGHT_M = 0.09  # of its top over the deck
LYING_M = 0.035  # so low are the tops of flat knobs on a thin plate, which pass for a deck themselves
TOP = 98.0  # percentile of its heights
RIM_M = 0.014  # below the top, where its outline is looked at
BINS, SMOOTH = 36, 1.0  # of the outline's radius over the angle
SPOKE = 0.8  # of the largest radius, from which on a peak of the outline is a spoke
ROUND = 0.88  # smallest over largest radius of an outline without spokes
APART_BINS = 4  # two spokes are further apart
OUTER = 0.55  # of a spoke's length, from which on its width is measured
WIDTH_M = (0.008, 0.03)


@dataclass(frozen=True, eq=False)
class Knob:
    """A piece that may turn about an upright axis through its middle, base frame.

    Attributes:
        p: Its points [m], (n, 3).
        spokes: From the axis to their tips, the longest first; at least one.
    """

    p: np.ndarray
    spokes: tuple[LeverCandidate, ...]

    @property
    def p_axis(self) -> np.ndarray:
        """The point of its axis at the height of its spokes [m], (3,)."""
        return self.spokes[0].p_root

    @property
    def reach_m(self) -> float:
        """From its axis to the tip of its longest spoke [m]."""
        return max(float(np.linalg.norm(spoke.p_tip - self.p_axis)) for spoke in self.spokes)


def knob_deck(p: np.ndarray) -> float:
    """Height of what knobs stand on [m], however thin; of points (n, 3)."""
    return deck_height(p, 0.0)


def beside_body(scene: Scene) -> Standing | None:
    """What stands on the deck, however low; None where little does."""
    return standing_on(scene, 0.0, LOW_BAND_M)


def find_knobs(scene: Scene) -> list[Knob]:
    """What may be a knob, the one with most points first; maybe none."""
    standing = beside_body(scene)
    return [] if standing is None else _knobs(standing.apart, standing.deck_m)


def find_lying_knobs(scene: Scene) -> list[Knob]:
    """What may be a flat knob on a plate as thin as the table, the one with most points first; maybe none.

    Feet and edges of other things may be among them: it takes their colours to tell.
    """
    p = scene.p_base
    if knob_deck(p) > LYING_M:
        return []
    return _knobs(lying(p, (LOW_BAND_M, LYING_M), LEAST_KNOB_POINTS), 0.0)


def _knobs(found: Sequence[np.ndarray], deck_m: float) -> list[Knob]:
    """Those of some pieces (n, 3) that have spokes."""
    return [Knob(p, spokes) for p in found if len(p) >= LEAST_KNOB_POINTS and (spokes := _spokes(p, deck_m))]


def _spokes(p: np.ndarray, deck_m: float) -> tuple[LeverCandidate, ...]:
    """Spokes of a piece (n, 3), the longest first; none where it is no knob."""
    top_m, rim = float(np.percentile(p[:, 2], TOP)), rim_of(p)
    if top_m - deck_m > MOST_HEIGHT_M or len(rim) < LEAST_KNOB_POINTS:
        return ()
    axes = np.linalg.eigh(np.cov(rim[:, :2].T))[1]
    low, high = np.percentile(rim[:, :2] @ axes, [1.0, 99.0], axis=0)
    width, length = sorted((high - low).tolist())
    if not 2.0 * RADIUS_M[0] < length < 2.0 * RADIUS_M[1] or width < COMPACT * length:
        return ()
    centre = axes @ (0.5 * (low + high))
    offset = rim[:, :2] - centre
    radius = np.linalg.norm(offset, axis=1)
    outline = _outline(np.arctan2(offset[:, 1], offset[:, 0]), radius)
    if outline.min() > ROUND * outline.max():
        return ()
    height_m = float(np.median(rim[:, 2]))
    found = []
    for k in _peaks(outline):
        angle = 2.0 * np.pi * (k + 0.5) / BINS - np.pi
        found.append(spoke_to(rim, centre, angle, float(outline[k]), height_m, float(p[:, 2].min()) - deck_m))
    return tuple(found)


def _outline(angle: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Radius of the outline over the angle [m], (BINS,)."""
    bins = np.minimum(((angle + np.pi) / (2.0 * np.pi) * BINS).astype(int), BINS - 1)
    outline = np.array(
        [np.percentile(radius[bins == k], 95.0) if (bins == k).sum() >= 3 else 0.0 for k in range(BINS)]
    )
    return ndimage.gaussian_filter1d(outline, SMOOTH, mode="wrap")


def _peaks(outline: np.ndarray) -> list[int]:
    """Bins of the spokes' tips, the longest first, apart from each other."""
    chosen: list[int] = []
    for k in np.argsort(-outline, kind="stable"):
        if outline[k] < SPOKE * outline.max():
            break
        peak = outline[k] >= max(outline[k - 1], outline[(k + 1) % BINS])
        apart = all(min(abs(k - c), BINS - abs(k - c)) > APART_BINS for c in chosen)
        if peak and apart:
            chosen.append(int(k))
    return chosen


def rim_of(p: np.ndarray) -> np.ndarray:
    """Those of points (n, 3) of a knob or bar that are near its top."""
    return p[p[:, 2] > np.percentile(p[:, 2], TOP) - RIM_M]


def spoke_to(
    rim: np.ndarray, centre: np.ndarray, angle: float, radius: float, height_m: float, above_deck_m: float
) -> LeverCandidate:
    """A lever from the axis of a knob or bar to the tip of a spoke.

    Args:
        rim: Points near its top [m], (n, 3).
        centre: Where its upright axis stands [m], (2,).
        angle: Of the spoke, counter-clockwise from x [rad].
        radius: From the axis to the spoke's tip [m].
        height_m: Of the spoke.
        above_deck_m: How high the lowest point of the piece is over the deck.
    """
    out, aside = (
        np.array([np.cos(angle), np.sin(angle)]),
        np.array([-np.sin(angle), np.cos(angle)]),
    )
    offset = rim[:, :2] - centre
    outer = (offset @ out > OUTER * radius) & (np.abs(offset @ aside) < WIDTH_M[1])
    across = offset[outer] @ aside
    width = 3.46 * float(across.std()) if outer.sum() > 5 else WIDTH_M[0]
    tip = centre + radius * out + (float(np.median(across)) if outer.sum() > 5 else 0.0) * aside
    return LeverCandidate(
        p=rim[outer] if outer.any() else rim,
        p_root=np.append(centre, height_m),
        p_tip=np.append(tip, height_m),
        width_m=float(np.clip(width, *WIDTH_M)),
        bend=0.0,
        towards_user=0.0,
        outward=np.append(out, 0.0),
        above_deck_m=above_deck_m,
        radial=0.0,
        rooted=True,
        p_body=centre,
    )
