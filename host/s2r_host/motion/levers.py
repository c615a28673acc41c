"""Finding what may be a lever: long thin straight pieces that stand out from the body of a faucet-like object."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from s2r_host.errors import SceneError
from s2r_host.motion.scene import Scene

CELL_M = 0.006
DECK_BAND_M = 0.008
DECK_CELLS = 60  # of level surface that make a deck
DECK_SHARE = 0.6  # of the widest level surface, so that the top of a thick body is none
# No spout is as wide. Of 490 drawn decks 4 are told more than 15 mm wrong, with 8 cells 10.
DECK_WIDTH_CELLS = 6
DECK_LENGTH_M = 0.12  # no knob is as long
HIGHER_CELLS, NEAR_CELLS, STANDING_CELLS = 3, 3, 15  # what stands on a deck, so much higher and so near
THIN_DECK_M = 0.02
COLUMN_CELL_M = 0.008
COLUMN_BEHIND_M = 0.012  # the axis of a column lies so far behind the face that the camera sees
COLUMN_RADIUS_M = 0.042
# Pieces whose ends are further from the body's axis, and one of them this low, turn about an axis of their own.
ROOTED_M, FOOT_M = 0.05, 0.04
BELOW_M, BESIDE_M = (0.004, 0.05), 0.02  # where the foot is looked for that a lever's root stands on
OWN_M, FOOT_POINTS = 0.002, 40  # this near to a point of the piece is the piece; so many others make a foot
RISE_M = 0.01  # by which a lever's tip is higher than its middle, where that tells as much as a foot
UPRIGHT, ON_DECK_M = 0.8, 0.02  # sine of a line that stands upright; this low it stands on the deck
LEAST_POINTS = 60
LEAST_LENGTH_M = 0.035
# What sticks out of the column by less than that, but by so much and no further away from it, is a short lever.
LEAST_STUB_M, AT_COLUMN_M = 0.015, 0.010
MOST_WIDTH_M = 0.06
USUAL_WIDTH_M = 0.025  # of a lever as a camera sees it
STRAIGHT = 0.1  # spread across over spread along of what is taken for straight
LINES, LINE_TRIES, LINE_RADIUS_M = 3, 200, 0.016


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
    p = scene.p_base
    deck_m = deck_height(p)
    above = p[p[:, 2] > deck_m + DECK_BAND_M]
    if len(above) < LEAST_POINTS:
        raise SceneError("no lever in view: nothing stands up from the object's deck")
    axis = column(above, deck_m, scene.p_camera)
    outside = above[np.linalg.norm(above[:, :2] - axis, axis=1) > COLUMN_RADIUS_M]
    found = [candidate for piece in pieces(outside) for candidate in _candidates(piece, axis, deck_m, above)]
    if not found:
        raise SceneError(
            f"no lever in view: no straight piece of at least {1e2 * LEAST_LENGTH_M:.0f} cm stands out from the body "
            f"at ({axis[0]:.2f}, {axis[1]:.2f}) m"
        )
    return sorted(found, key=lambda c: c.doubt)


def _candidates(
    piece: np.ndarray, axis: np.ndarray, deck_m: float, above: np.ndarray
) -> list[LeverCandidate]:
    """The straight parts of a piece (n, 3); without any, all of it if it sticks out of the column."""
    straight = [_candidate(part, axis, deck_m, above) for part in _straight(piece)]
    found = [candidate for candidate in straight if candidate is not None]
    stub = None if found else _stub(piece, axis, deck_m)
    return found if stub is None else [stub]


def deck_height(p: np.ndarray, least_m: float = THIN_DECK_M) -> float:
    """Top of the plate or block the object stands on: the highest of the widest level surfaces, wider than a spout.

    Thin plates count as ``least_m`` high: of levers nothing is that low.
    """
    cells = np.floor(p / CELL_M).astype(int)
    low = cells.min(axis=0)
    cells = np.unique(cells - low, axis=0)
    top = np.full(cells[:, :2].max(axis=0) + 1, -1)
    np.maximum.at(top, tuple(cells[:, :2].T), cells[:, 2])
    wide = [_deck_cells(top, level) for level in range(int(top.max()) + 1)]
    enough = np.flatnonzero(np.array(wide) >= max(DECK_CELLS, DECK_SHARE * max(wide)))
    if len(enough):
        return max(least_m, float((low[2] + enough[-1] + 1) * CELL_M))
    return THIN_DECK_M


def _deck_cells(top: np.ndarray, level: int) -> int:
    """How many cells of a level may be a deck: not as narrow as a spout; long, or with something standing on it.

    Args:
        top: Highest occupied cell over each place (x, y); -1 where there is none.
        level: Of the deck's top.
    """
    labels = np.zeros(top.shape, np.int32)
    # What stands on a deck covers some of it.
    wide = np.asarray(
        ndimage.binary_opening(top >= max(0, level - 1), np.ones((DECK_WIDTH_CELLS,) * 2)), bool
    )
    ndimage.label(wide & (top >= 0) & (np.abs(top - level) <= 1), output=labels)
    higher, total = top > level + HIGHER_CELLS, 0
    for k in range(1, int(labels.max()) + 1):
        cells = np.argwhere(labels == k)
        if len(cells) < DECK_WIDTH_CELLS:
            continue
        spread = cells @ np.linalg.eigh(np.cov(cells.T))[1][:, 1]
        around = np.asarray(ndimage.binary_dilation(labels == k, iterations=NEAR_CELLS), bool)
        stands = int((around & higher).sum()) >= STANDING_CELLS
        total += len(cells) if stands or np.ptp(spread) * CELL_M > DECK_LENGTH_M else 0
    return total


def column(p: np.ndarray, deck_m: float, p_camera: np.ndarray) -> np.ndarray:
    """Where the body's upright axis stands (2,): where the surface rises highest from the deck without a break."""
    cells = np.floor(np.column_stack([p[:, :2] / COLUMN_CELL_M, (p[:, 2:] - deck_m) / CELL_M])).astype(int)
    low = cells[:, :2].min(axis=0)
    shape = (*(cells[:, :2].max(axis=0) - low + 1), int(cells[:, 2].max()) + 1)
    grid = np.zeros(shape, bool)
    grid[cells[:, 0] - low[0], cells[:, 1] - low[1], np.maximum(cells[:, 2], 0)] = True
    grid = np.asarray(ndimage.binary_dilation(grid, np.ones((3, 3, 1))), bool)
    grid[:, :, :2] = grid[:, :, :3].any(
        axis=2, keepdims=True
    )  # the lowest centimetre is cut off with the deck
    padded = np.pad(grid, ((0, 0), (0, 0), (3, 3)), mode="edge")
    grid = ndimage.binary_closing(padded, np.ones((1, 1, 5)))[:, :, 3:-3]
    rise = np.cumprod(grid, axis=2).sum(axis=2).astype(float)
    rise = ndimage.uniform_filter(rise, 3, mode="constant")
    labels = np.zeros(rise.shape, np.int32)
    ndimage.label(rise >= 0.75 * rise.max(), output=labels)
    best = np.argwhere(labels == labels.flat[int(rise.argmax())]).mean(axis=0)
    face = (low + best + 0.5) * COLUMN_CELL_M
    away = face - p_camera[:2]
    return face + COLUMN_BEHIND_M * away / np.linalg.norm(away)


def pieces(p: np.ndarray, least: int = LEAST_POINTS) -> list[np.ndarray]:
    """Connected pieces of some points (n, 3) with at least so many of them, largest first."""
    if not len(p):
        return []
    cells = np.floor(p / CELL_M).astype(int)
    cells -= cells.min(axis=0)
    grid = np.zeros(cells.max(axis=0) + 1, bool)
    grid[tuple(cells.T)] = True
    labels = np.zeros(grid.shape, np.int32)
    ndimage.label(grid, structure=np.ones((3, 3, 3)), output=labels)
    of = labels[tuple(cells.T)]
    sizes = np.bincount(of)
    return [p[of == k] for k in np.argsort(-sizes) if sizes[k] >= least]


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


def _candidate(p: np.ndarray, axis: np.ndarray, deck_m: float, above: np.ndarray) -> LeverCandidate | None:
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
    apart_m = min(float(np.linalg.norm(end[:2] - axis)) for end in ends)
    own = apart_m > ROOTED_M and min(float(end[2]) for end in ends) < deck_m + FOOT_M
    if own:
        ends.sort(key=lambda end: -_standing(end, p, above) - float(centre[2] - end[2]) / RISE_M)
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


def _stub(p: np.ndarray, axis: np.ndarray, deck_m: float) -> LeverCandidate | None:
    """A piece (n, 3) that sticks out of the column a little: it leads straight away from the body's axis."""
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
        above_deck_m=float(p[:, 2].min()) - deck_m,
        radial=1.0,
        rooted=False,
        p_body=axis,
    )


def _standing(end: np.ndarray, piece: np.ndarray, above: np.ndarray) -> float:
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
