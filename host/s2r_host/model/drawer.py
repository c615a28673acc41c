"""A drawer from its points: front slab, handle with the open gap behind it, box body, cabinet, its neighbours.

Frame D: x out of the cabinet along the front's normal, z up, origin on the front's outer face.
Seen faces keep their measured place; what no camera saw follows from thickness priors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from s2r_host.model.errors import ModelError
from s2r_host.model.handle import Handle, find_handle, handle_pieces
from s2r_host.model.neighbours import neighbours_of
from s2r_host.model.pieces import Piece, box
from s2r_host.model.points import ObservedObject
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.motion import unit
from s2r_host.perception.planes import fit_plane

Array = NDArray[np.floating]

FRONT_THICKNESS_M = 0.018
WALL_M = 0.008
SIDE_CLEARANCE_M = 0.015
SHELL_M = 0.012  # boxes are at least this much narrower than their fronts
LEAST_SHELL_POINTS = 60
CABINET_DEPTH_M = 0.40
LEAST_FRONT_POINTS = 300
OUTWARD_COS = 0.9


@dataclass(frozen=True, eq=False)
class Drawer:
    """Measures of a drawer in frame D [m].

    Attributes:
        X_base_D: Frame D, shape (4, 4).
        front_low, front_high: Corners of the front slab (its outer face is x = 0).
        handle: The handle, or None if none stands out.
        depth_m: Length of the body behind the front.
        cabinet_low, cabinet_high: Corners of the cabinet, or None if nothing static was seen.
        neighbours: Corners of boxes that stand out of the cabinet around the drawer, as other drawers that are open.
        outward_sign: +1 if the estimated axis direction points out of the cabinet.
    """

    X_base_D: Array
    front_low: Array
    front_high: Array
    handle: Handle | None
    depth_m: float
    cabinet_low: Array | None
    cabinet_high: Array | None
    neighbours: tuple[tuple[Array, Array], ...]
    outward_sign: float

    @property
    def closing_m(self) -> float:
        """Travel from the first view until the front meets the cabinet."""
        if self.cabinet_high is None:
            return 0.1
        return max(0.0, float(self.front_low[0] - self.cabinet_high[0]))


def looks_like_drawer(estimate: JointEstimate, seen: ObservedObject) -> bool:
    """A slide, roughly level, whose part shows a large flat face across the axis."""
    if estimate.joint_type != "prismatic" or abs(estimate.axis_direction @ seen.up) > 0.5:
        return False
    facing = np.abs(seen.part_normals @ estimate.axis_direction) > OUTWARD_COS
    return int(facing.sum()) >= LEAST_FRONT_POINTS


def measure_drawer(estimate: JointEstimate, seen: ObservedObject) -> Drawer:
    """Measure front, handle, body and cabinet.

    Raises:
        ModelError: No flat front.
    """
    axis = estimate.axis_direction
    facing = np.abs(seen.part_normals @ axis) > OUTWARD_COS
    face = seen.part[facing]
    if len(face) < LEAST_FRONT_POINTS:
        raise ModelError(f"no front: only {len(face)} points of the part face along the axis")
    along = face @ axis
    # The front is the fullest 8 mm slice; handles are slices of their own.
    counts, edges = np.histogram(along, bins=np.arange(along.min() - 0.004, along.max() + 0.008, 0.004))
    middle = (
        edges[int(np.argmax(counts[:-1] + counts[1:])) + 1] if len(counts) > 1 else float(np.median(along))
    )
    centre, normal = fit_plane(face[np.abs(along - middle) < 0.005])
    inlier = face[np.abs((face - centre) @ normal) < 0.004]
    centre, normal = fit_plane(inlier)
    out = _outward(normal, centre, seen)
    x = unit(out - (out @ seen.up) * seen.up) if abs(out @ seen.up) < 0.1 else out
    z = unit(seen.up - (seen.up @ x) * x)
    X = np.eye(4)
    X[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    X[:3, 3] = centre
    q = _into(X, seen.part)
    n = seen.part_normals @ X[:3, :3]
    low, high = _front_slab(q, n)
    handle = find_handle(q, low, high, estimate, X)
    cabinet_low, cabinet_high, neighbours = _cabinet(X, seen, low, high)
    depth = (
        CABINET_DEPTH_M if cabinet_low is None or cabinet_high is None else cabinet_high[0] - cabinet_low[0]
    )
    return Drawer(
        X, low, high, handle, float(np.clip(0.85 * depth, 0.1, 0.6)), cabinet_low, cabinet_high, neighbours,
        1.0 if out @ axis > 0 else -1.0,
    )  # fmt: skip


def drawer_pieces(drawer: Drawer) -> list[Piece]:
    """Boxes of a measured drawer."""
    X, low, high = drawer.X_base_D, drawer.front_low, drawer.front_high
    pieces = [box("front", "part", X, low, high)]
    if drawer.handle is not None:
        pieces += handle_pieces(drawer.handle, X)
    back, y0, y1 = low[0] - drawer.depth_m, low[1] + SIDE_CLEARANCE_M, high[1] - SIDE_CLEARANCE_M
    z0, z1 = low[2] + 0.012, high[2] - 0.02
    walls = {
        "left": ((back, y1 - WALL_M, z0), (low[0], y1, z1)),
        "right": ((back, y0, z0), (low[0], y0 + WALL_M, z1)),
        "floor": ((back, y0, z0), (low[0], y1, z0 + WALL_M)),
        "back": ((back, y0, z0), (back + WALL_M, y1, z1)),
    }
    pieces += [box(name, "part", X, np.array(a), np.array(b), seen=False) for name, (a, b) in walls.items()]
    if drawer.cabinet_low is not None and drawer.cabinet_high is not None:
        pieces.append(box("cabinet", "base", X, drawer.cabinet_low, drawer.cabinet_high))
    pieces += [box(f"neighbour_{k}", "base", X, *corners) for k, corners in enumerate(drawer.neighbours)]
    return pieces


def _into(X: Array, points: Array) -> Array:
    return (points - X[:3, 3]) @ X[:3, :3]


def _outward(normal: Array, centre: Array, seen: ObservedObject) -> Array:
    """The front's normal on the camera's side; without a camera: away from what stands still."""
    if seen.p_camera is not None:
        reference = seen.p_camera - centre
    elif len(seen.rest):
        reference = centre - seen.rest.mean(axis=0)
    else:
        raise ModelError("nothing tells the drawer's outside from its inside; give --camera")
    return normal if normal @ reference > 0 else -normal


def _front_slab(q: Array, n: Array) -> tuple[Array, Array]:
    """Corners of the front: outline of its face, thickness from its visible rim."""
    # Rims have no good normals, so the outline uses every point on the face's plane.
    face = q[(np.abs(q[:, 0]) < 0.006)]
    keep = _dense(face[:, 1:])
    low, high = np.percentile(face[keep][:, 1:], [0.4, 99.6], axis=0)
    thickness = FRONT_THICKNESS_M
    rim = q[
        (q[:, 0] < -0.004) & (q[:, 0] > -0.05) & (np.abs(n[:, 0]) < 0.5)
        & (np.abs(q[:, [2, 1, 1]] - [high[1], low[0], high[0]]) < 0.006).any(axis=1)
    ]  # fmt: skip
    if len(rim) > 60:
        thickness = float(np.clip(-np.percentile(rim[:, 0], 5), 0.010, 0.03))
    return np.array([-thickness, low[0], low[1]]), np.array([0.0, high[0], high[1]])


def _dense(yz: Array) -> NDArray[np.bool_]:
    """Points with at least 8 neighbours within 8 mm."""
    if len(yz) < 20:
        return np.ones(len(yz), dtype=bool)
    tree = cKDTree(yz)
    count = tree.query_ball_point(yz, 0.008, return_length=True)
    return np.asarray(count) >= 8


def _cabinet(
    X: Array, seen: ObservedObject, low: Array, high: Array
) -> tuple[Array | None, Array | None, tuple[tuple[Array, Array], ...]]:
    """Box of the static points right behind and around the front, down to the support, and what stands out of it."""
    q = _into(X, seen.rest)
    near = (
        (q[:, 0] < 0.01) & (q[:, 0] > -0.8)
        & (q[:, 1] > low[1] - 0.12) & (q[:, 1] < high[1] + 0.12) & (q[:, 2] < high[2] + 0.35)
    )  # fmt: skip
    q = q[near]
    q = q[_connected(q, low, high)] if len(q) else q
    if len(q) < 150:
        return None, None, ()
    a, b = np.percentile(q, [1, 99], axis=0)
    # The drawer's own walls slide within their planes and look unmoved; they keep clear of the front's outline.
    around = (
        q[:, 2] > high[2] - SHELL_M, q[:, 2] < low[2], q[:, 1] < low[1] + SHELL_M, q[:, 1] > high[1] - SHELL_M
    )  # fmt: skip
    shell = np.logical_or.reduce(around)
    neighbours: tuple[tuple[Array, Array], ...] = ()
    if shell.sum() >= LEAST_SHELL_POINTS:
        b[0], neighbours = neighbours_of(q, around, LEAST_SHELL_POINTS)
    a[2] = seen.support_height - X[:3, 3] @ seen.up
    # Seen from the front only, the back is a guess.
    if b[0] - a[0] < 0.08:
        a[0] = b[0] - CABINET_DEPTH_M
    b[0] = min(b[0], float(low[0]) - 0.001)
    a[1], b[1] = min(a[1], low[1]), max(b[1], high[1])
    return a, b, neighbours


def _connected(q: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Points linked to the region behind the front by steps of at most 3 cm."""
    from scipy.sparse.csgraph import connected_components

    cell, inverse = np.unique(np.floor(q / 0.015).astype(np.int64), axis=0, return_inverse=True)
    tree = cKDTree(cell.astype(np.float64))
    graph = tree.sparse_distance_matrix(tree, 2.0, output_type="coo_matrix")
    _, label = connected_components(graph, directed=False)
    centre = (cell + 0.5) * 0.015
    behind = (
        (centre[:, 0] > -0.3) & (centre[:, 1] > low[1] - 0.05) & (centre[:, 1] < high[1] + 0.05)
        & (centre[:, 2] > low[2] - 0.05) & (centre[:, 2] < high[2] + 0.10)
    )  # fmt: skip
    if not behind.any():
        return np.zeros(len(q), dtype=bool)
    main = np.bincount(label[behind]).argmax()
    return (label == main)[inverse.ravel()]
