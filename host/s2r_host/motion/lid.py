"""Finding the lid of a laptop-like object: the largest plane that stands up, hinged at the edge of a lower base."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from s2r_host.errors import SceneError
from s2r_host.motion.scene import Scene

MIN_AREA_M2 = 0.008
CELL_M = 0.006
PATCH_CELL_M = 0.012  # points further apart than about two of these do not belong to one lid
BASE_BAND_M = 0.06  # the base reaches at most this high above the hinge
BASE_REACH_M = (0.03, 0.35)


@dataclass(frozen=True, eq=False)
class Lid:
    """A flat lid as seen, base frame. Its hinge line is its lower edge.

    Attributes:
        p_hinge: Middle of the lower edge [m], (3,).
        along: Unit vector along the hinge; the lid opens about it by the right-hand rule, (3,).
        up: Unit vector in the lid from the hinge to the free edge, (3,).
        length_m, width_m: From the hinge to the free edge, and along the hinge.
        angle_rad: Opening angle; 0 is closed on the base, level base assumed.
        outside_seen: The camera saw the face that is outside when closed.
        p_camera: Where the camera was [m], (3,).
    """

    p_hinge: np.ndarray
    along: np.ndarray
    up: np.ndarray
    length_m: float
    width_m: float
    angle_rad: float
    outside_seen: bool
    p_camera: np.ndarray

    def facing(self, turn_rad: float) -> float:
        """Cosine between the seen face's normal and the ray to the camera, the lid opened further by ``turn_rad``.

        Small values: edge-on. Below 0 the camera sees the other face.
        """
        c, s = np.cos(turn_rad), np.sin(turn_rad)
        up = c * self.up + s * np.cross(self.along, self.up)
        normal = (1.0 if self.outside_seen else -1.0) * np.cross(self.along, up)
        ray = self.p_camera - (self.p_hinge + 0.5 * self.length_m * up)
        return float(normal @ ray / np.linalg.norm(ray))

    @property
    def opening(self) -> np.ndarray:
        """Unit vector in which the free edge goes when the lid opens; normal of the outside, (3,)."""
        return np.cross(self.along, self.up)

    def covers(self, p_base: np.ndarray, margin_m: float = 0.012) -> np.ndarray:
        """Which points belong to the lid or lie within a margin of it; shape (n,), bool."""
        offset = p_base - self.p_hinge
        height = offset @ self.up
        return (
            (np.abs(offset @ self.opening) < margin_m)
            & (np.abs(offset @ self.along) < 0.5 * self.width_m + margin_m)
            & (height > 0.1 * self.length_m)
            & (height < self.length_m + margin_m)
        )


def find_lid(scene: Scene) -> Lid:
    """The largest inclined plane with a level lower edge and a base on one side of it.

    Raises:
        SceneError: There is none.
    """
    from s2r_host.motion.steep_planes import steep_planes  # loads Open3D, which drawers and levers do without

    points, planes = steep_planes(scene.p_base, CELL_M, MIN_AREA_M2)
    reasons: list[str] = []
    for plane in planes:
        found = _lid(points, plane, scene.p_camera)
        if isinstance(found, Lid):
            return found
        reasons.append(found)
    raise SceneError(
        f"no lid in view: {'; '.join(reasons) or 'no inclined plane'}. Needed is an inclined plane of at least "
        f"{1e4 * MIN_AREA_M2:.0f} cm² with a level lower edge and a base before or behind it"
    )


def _largest_patch(members: np.ndarray) -> np.ndarray:
    """Which points of a plane (n, 3) form its largest connected piece: a plane goes on for ever, a lid does not."""
    axes = np.linalg.svd(members - members.mean(axis=0), full_matrices=False)[2][:2]
    cells = np.floor(members @ axes.T / PATCH_CELL_M).astype(int)
    cells -= cells.min(axis=0)
    grid = np.zeros(cells.max(axis=0) + 1, bool)
    grid[tuple(cells.T)] = True
    labels = np.zeros(grid.shape, np.int32)
    ndimage.label(grid, structure=np.ones((3, 3)), output=labels)
    patch = labels[tuple(cells.T)]
    return patch == np.bincount(patch).argmax()


def _lid(points: np.ndarray, plane: np.ndarray, p_camera: np.ndarray) -> Lid | str:
    """The lid of one plane, or why it is none."""
    members = points[plane]
    members = members[_largest_patch(members)]
    centre = members.mean(axis=0)
    normal = np.linalg.svd(members - centre, full_matrices=False)[2][2]
    if normal @ (p_camera - centre) < 0.0:
        normal = -normal
    along = np.cross([0.0, 0.0, 1.0], normal)
    along /= np.linalg.norm(along)
    up = np.cross(normal, along)
    flat = np.stack([(members - centre) @ along, (members - centre) @ up], axis=-1)
    low, high = np.percentile(flat, 1, axis=0), np.percentile(flat, 99, axis=0)
    p_hinge = centre + 0.5 * (low[0] + high[0]) * along + low[1] * up
    side = np.cross(along, [0.0, 0.0, 1.0])  # level, across the hinge
    offset = points[~plane] - p_hinge
    across = offset @ side
    near = (
        (offset[:, 2] < BASE_BAND_M)
        & (np.abs(offset @ along) < 0.5 * (high[0] - low[0]))
        & (np.abs(across) > BASE_REACH_M[0])
        & (np.abs(across) < BASE_REACH_M[1])
    )
    if near.sum() * CELL_M**2 < 0.25 * MIN_AREA_M2:
        return f"the plane at {np.array2string(centre, precision=2)} m has no base beside its lower edge"
    base = side if np.median(across[near]) > 0.0 else -side
    along = np.cross(base, [0.0, 0.0, 1.0])  # about this, up turns away from the base: opening
    along = -along if np.cross(along, up) @ base > 0.0 else along
    return Lid(
        p_hinge=p_hinge,
        along=along,
        up=up,
        length_m=float(high[1] - low[1]),
        width_m=float(high[0] - low[0]),
        angle_rad=float(np.arctan2(up[2], up @ base)),
        outside_seen=bool(normal @ np.cross(along, up) > 0.0),
        p_camera=p_camera,
    )
