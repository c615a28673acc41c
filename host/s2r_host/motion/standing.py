"""What stands on the deck of a faucet-like object: how high the deck is, where the body stands, what is beside it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage

from s2r_host.motion.scene import Scene

LEAST_POINTS = 60
CELL_M = 0.006
DECK_BAND_M = 0.008  # above the deck, where levers begin
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


@dataclass(frozen=True, eq=False)
class Standing:
    """What stands on a deck, base frame.

    Attributes:
        deck_m: Height of the deck [m].
        above: Points above it [m], (n, 3).
        p_body: Where the body's upright axis stands [m], (2,).
    """

    deck_m: float
    above: np.ndarray
    p_body: np.ndarray

    @cached_property
    def apart(self) -> list[np.ndarray]:
        """Connected pieces (n, 3) away from the body, the largest first."""
        return pieces(self.above[np.linalg.norm(self.above[:, :2] - self.p_body, axis=1) > COLUMN_RADIUS_M])


def standing_on(
    scene: Scene, least_deck_m: float = THIN_DECK_M, band_m: float = DECK_BAND_M
) -> Standing | None:
    """What stands on the deck of a view; None where little does.

    Args:
        scene: Observed points.
        least_deck_m: As :func:`deck_height` takes it.
        band_m: Noise and edges so far above the deck are left out.
    """
    deck_m = deck_height(scene.p_base, least_deck_m)
    above = scene.p_base[scene.p_base[:, 2] > deck_m + band_m]
    if len(above) < LEAST_POINTS:
        return None
    return Standing(deck_m, above, column(above, deck_m, scene.p_camera))


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


def lying(p: np.ndarray, band_m: tuple[float, float], least: int) -> list[np.ndarray]:
    """Connected pieces of points (n, 3) within a band of heights [m] that have nothing on them, largest first."""
    low_m, high_m = band_m
    return [piece for piece in pieces(p[p[:, 2] > low_m], least) if piece[:, 2].max() < high_m]
