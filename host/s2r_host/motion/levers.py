"""Finding what may be a lever: long thin straight pieces that stand out from the body of a faucet-like object."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from s2r_host.errors import SceneError
from s2r_host.motion.scene import Scene
from s2r_host.motion.standing import (
    COLUMN_RADIUS_M,
    DECK_BAND_M,
    LEAST_POINTS,
    THIN_DECK_M,
    Standing,
    lying,
    pieces,
    standing_on,
)

# Pieces whose ends are further from the body's axis, and one of them this low, turn about an axis of their own.
ROOTED_M, FOOT_M = 0.05, 0.04
BELOW_M, BESIDE_M = (0.004, 0.05), 0.02  # where the foot is looked for that a lever's root stands on
OWN_M, FOOT_POINTS = 0.002, 40  # this near to a point of the piece is the piece; so many others make a foot
STANDS_M = 0.006  # what is seen this low over the deck stands on it
RISE_M = 0.01  # by which a lever's tip is higher than its middle, where that tells as much as a foot
UPRIGHT, ON_DECK_M = 0.8, 0.02  # sine of a line that stands upright; this low it stands on the deck
LEAST_LENGTH_M = 0.035
# What sticks out of the column by less than that, but by so much and no further away from it, is a short lever.
LEAST_STUB_M, AT_COLUMN_M = 0.015, 0.010
MOST_WIDTH_M = 0.06
USUAL_WIDTH_M = 0.025  # of a lever as a camera sees it
STRAIGHT = 0.1  # spread across over spread along of what is taken for straight
LINES, LINE_TRIES, LINE_RADIUS_M = 3, 200, 0.016
# Heights over the table between which a lever may lie on a plate, lower than anything else stands. Edges of the plate
# and feet of what stands on it are seen there as well, in pieces of 390 points at most (of 160 drawn faucets).
LYING_M, LYING_POINTS = (0.015, 0.030), 400


@dataclass(frozen=True, eq=False)
class LeverCandidate:
    """A piece that may turn, base frame.

    Attributes:
        p: Its points [m], (n, 3).
        p_root, p_tip: Ends of its line, the root nearer to the body [m], (3,).
        width_m: Across the line.
        bend: Share of its spread that a straight line does not explain; spouts are bent, levers are not.
        towards_user: Cosine between its level direction and the way to the arm; spouts point there.
        outward: Level unit vector from the body's axis to its tip, (3,).
        above_deck_m: How high its lowest point is over the deck.
        radial: How much of its level direction leads straight away from the body's axis, 0 to 1.
        rooted: It stands on a foot of its own, away from the body.
        p_body: Where the body's upright axis stands [m], (2,).
    """

    p: np.ndarray
    p_root: np.ndarray
    p_tip: np.ndarray
    width_m: float
    bend: float
    towards_user: float
    outward: np.ndarray
    above_deck_m: float
    radial: float
    rooted: bool
    p_body: np.ndarray

    def turned_round(self) -> LeverCandidate:
        """The same piece with its root where its tip is believed to be."""
        return replace(
            self,
            p_root=self.p_tip,
            p_tip=self.p_root,
            outward=-self.outward,
            towards_user=-self.towards_user,
        )

    @property
    def direction(self) -> np.ndarray:
        """Unit vector from root to tip, (3,)."""
        along = self.p_tip - self.p_root
        return along / np.linalg.norm(along)

    @property
    def doubt(self) -> float:
        """Small for what looks like a lever: straight, not pointing to the user, not going down as spouts do.

        What stands upright on the deck is a side of the deck's block.
        """
        up = float(self.direction[2])
        block = 1.0 if abs(up) > UPRIGHT and self.above_deck_m < ON_DECK_M else 0.0
        return 3.0 * self.bend + 0.5 * max(0.0, self.towards_user) + 2.0 * max(0.0, -up) + block


def find_levers(scene: Scene) -> list[LeverCandidate]:
    """Candidates, the likeliest first.

    Raises:
        SceneError: Nothing thin stands out from the object.
    """
    standing = standing_on(scene)
    if standing is None:
        raise SceneError("no lever in view: nothing stands up from the object's deck")
    found = [candidate for piece in standing.apart for candidate in _candidates(piece, standing)]
    low = [_candidate(piece, standing) for piece in _lying(scene, standing)]
    found += [candidate for candidate in low if candidate is not None]
    if not found:
        x, y = standing.p_body
        raise SceneError(
            f"no lever in view: no straight piece of at least {1e2 * LEAST_LENGTH_M:.0f} cm stands out from the body "
            f"at ({x:.2f}, {y:.2f}) m"
        )
    return sorted(found, key=lambda c: c.doubt)


def levers_in(scene: Scene) -> list[LeverCandidate]:
    """Candidates, the likeliest first; maybe none."""
    try:
        return find_levers(scene)
    except SceneError:
        return []


def _lying(scene: Scene, standing: Standing) -> list[np.ndarray]:
    """Connected pieces (n, 3) that lie on a thin plate beside the body and have nothing on them."""
    if standing.deck_m > THIN_DECK_M:
        return []
    p = scene.p_base
    beside = np.linalg.norm(p[:, :2] - standing.p_body, axis=1) > COLUMN_RADIUS_M
    return lying(p[beside], LYING_M, LYING_POINTS)


def _candidates(piece: np.ndarray, standing: Standing) -> list[LeverCandidate]:
    """The straight parts of a piece (n, 3); without any, all of it if it sticks out of the column."""
    straight = [_candidate(part, standing) for part in _straight(piece)]
    found = [candidate for candidate in straight if candidate is not None]
    stub = None if found else _stub(piece, standing)
    return found if stub is None else [stub]


def _straight(p: np.ndarray) -> list[np.ndarray]:
    """A piece (n, 3) as it is if it is straight, else its straight parts: a lever above a spout looks like one."""
    spread = np.linalg.eigvalsh(np.cov((p - p.mean(axis=0)).T))
    if spread[1] < STRAIGHT * spread[2] and spread[1] < (MOST_WIDTH_M / 3.46) ** 2:
        return [p]
    rng, left, parts = np.random.default_rng(0), p, []
    while len(left) >= LEAST_POINTS and len(parts) < LINES:
        a, b = (left[rng.integers(len(left), size=LINE_TRIES)] for _ in range(2))
        d = b - a
        length = np.linalg.norm(d, axis=1)
        a, d = a[length > LEAST_LENGTH_M], d[length > LEAST_LENGTH_M] / length[length > LEAST_LENGTH_M, None]
        if not len(a):
            break
        some = left[:: max(1, len(left) // 400)]
        off = np.linalg.norm(np.cross(some[None] - a[:, None], d[:, None]), axis=2)
        best = int((off < LINE_RADIUS_M).sum(axis=1).argmax())
        near = np.linalg.norm(np.cross(left - a[best], d[best]), axis=1) < LINE_RADIUS_M
        parts += pieces(left[near])[:1]
        left = left[~near]
    return parts


def _candidate(p: np.ndarray, standing: Standing) -> LeverCandidate | None:
    axis, deck_m = standing.p_body, standing.deck_m
    centre = p.mean(axis=0)
    spread, vectors = np.linalg.eigh(np.cov((p - centre).T))
    along = vectors[:, 2]
    t = (p - centre) @ along
    low, high = np.percentile(t, [2, 98])
    width = 3.46 * float(np.sqrt(max(spread[1], 0.0)))
    if high - low < LEAST_LENGTH_M or width > MOST_WIDTH_M:
        return None
    ends = [centre + low * along, centre + high * along]
    ends.sort(key=lambda end: float(np.linalg.norm(end[:2] - axis)) + 0.3 * float(end[2]))
    own = _on_own_foot(ends, standing)
    if own and _apart_m(ends, axis) > ROOTED_M:
        ends.sort(key=lambda end: -_foot(end, p, standing.above) - float(centre[2] - end[2]) / RISE_M)
    elif own:
        ends.sort(key=lambda end: float(end[2]))
    root, tip = ends
    level = (tip - root)[:2]
    length = float(np.linalg.norm(level))
    to_arm = -tip[:2] / np.linalg.norm(tip[:2])
    out = root[:2] - axis
    return LeverCandidate(
        p=p,
        p_root=root,
        p_tip=tip,
        width_m=width,
        bend=float(spread[1] / spread[2]),
        towards_user=float(level @ to_arm / max(length, 1e-6)) if length > 0.3 * (high - low) else 0.0,
        outward=_level(tip - root if own else tip - np.append(axis, 0.0)),
        above_deck_m=float(p[:, 2].min()) - deck_m,
        radial=abs(float(level @ out)) / max(1e-9, length * float(np.linalg.norm(out))),
        rooted=own,
        p_body=axis,
    )


def on_body(
    piece: np.ndarray, root_m: float, p_tip: np.ndarray, width_m: float, standing: Standing
) -> LeverCandidate:
    """A piece (n, 3) taken for a lever that leads straight from the body's axis, at a height, to its tip (3,)."""
    outward = _level(p_tip - np.append(standing.p_body, 0.0))
    return LeverCandidate(
        p=piece,
        p_root=np.append(standing.p_body, root_m),
        p_tip=p_tip,
        width_m=width_m,
        bend=0.0,
        towards_user=float(-outward[0]),
        outward=outward,
        above_deck_m=float(piece[:, 2].min()) - standing.deck_m,
        radial=1.0,
        rooted=False,
        p_body=standing.p_body,
    )


def _stub(p: np.ndarray, standing: Standing) -> LeverCandidate | None:
    """A piece (n, 3) that sticks out of the column a little: it leads straight away from the body's axis."""
    axis = standing.p_body
    offset = p[:, :2] - axis
    away_m = np.linalg.norm(offset, axis=1)
    level = offset.mean(axis=0)
    level /= max(float(np.linalg.norm(level)), 1e-9)
    t, aside = offset @ level, offset @ np.array([-level[1], level[0]])
    low, high = np.percentile(t, [2, 98])
    width = 3.46 * float(aside.std())
    if away_m.min() > COLUMN_RADIUS_M + AT_COLUMN_M or high - low < LEAST_STUB_M or width > MOST_WIDTH_M:
        return None
    rise, height = np.polyfit(t, p[:, 2], 1)
    root, tip = (np.append(axis + at * level, height + rise * at) for at in (0.0, high))
    to_arm = -tip[:2] / np.linalg.norm(tip[:2])
    return LeverCandidate(
        p=p,
        p_root=root,
        p_tip=tip,
        width_m=width,
        bend=float((width / high) ** 2),
        towards_user=float(level @ to_arm),
        outward=np.append(level, 0.0),
        above_deck_m=float(p[:, 2].min()) - standing.deck_m,
        radial=1.0,
        rooted=False,
        p_body=axis,
    )


def _on_own_foot(ends: list[np.ndarray], standing: Standing) -> bool:
    """Whether a piece stands on the deck beside the body: all of it, or an end from which it rises towards the body."""
    inner, outer = sorted(ends, key=lambda end: float(np.linalg.norm(end[:2] - standing.p_body)))
    low_m = standing.deck_m + FOOT_M
    if _apart_m(ends, standing.p_body) > ROOTED_M:
        return bool(min(inner[2], outer[2]) < low_m)
    if _apart_m([outer], standing.p_body) < ROOTED_M or outer[2] > min(low_m, inner[2]):
        return False
    beside = np.linalg.norm(standing.above[:, :2] - outer[:2], axis=1) < BESIDE_M
    return int((standing.above[beside, 2] < standing.deck_m + DECK_BAND_M + STANDS_M).sum()) >= FOOT_POINTS


def _apart_m(ends: list[np.ndarray], p_body: np.ndarray) -> float:
    """How far the nearer of some points is from the body's axis [m]."""
    return min(float(np.linalg.norm(end[:2] - p_body)) for end in ends)


def _foot(end: np.ndarray, piece: np.ndarray, above: np.ndarray) -> float:
    """How much of the object lies closely below an end of a piece, 0 to 1: a root has a foot, a tip hangs free."""
    below = end[2] - above[:, 2]
    beside = np.linalg.norm(above[:, :2] - end[:2], axis=1) < BESIDE_M
    foot = above[beside & (below > BELOW_M[0]) & (below < BELOW_M[1])]
    if not len(foot):
        return 0.0
    others = cKDTree(piece).query(foot)[0] > OWN_M
    return min(1.0, float(others.sum()) / FOOT_POINTS)


def _level(v: np.ndarray) -> np.ndarray:
    flat = np.array([v[0], v[1], 0.0])
    return flat / max(float(np.linalg.norm(flat)), 1e-9)
