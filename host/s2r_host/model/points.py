"""The observed points of an object, both views brought into the pose of the first one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from s2r_host.model.errors import ModelError
from s2r_host.perception.edges import Edges, outlines_of
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.planes import find_planes
from s2r_host.perception.view import Seen, View

Array = NDArray[np.floating]

SUPPORT_CLEARANCE_M = 0.006
LEVEL_COS = 0.95  # of a support; planes that lean further are the object's own
UPRIGHT_COS = 0.985
UP_IN_PICTURE = np.array(
    [0.0, -1.0, 0.0]
)  # where a camera's own frame is all that is known, and no support is seen
EMPTY_M = 0.002  # before a seen surface, besides its noise, from which on space counts as empty


@dataclass(frozen=True, eq=False)
class Look:
    """What one view shows of the part, in the pose of the first view.

    Attributes:
        p: Points [m], (n, 3).
        p_camera: Where the camera stands, seen from the part, (3,).
        outline: Its outlines in colour; None without colour.
    """

    p: Array
    p_camera: Array
    outline: Edges | None


@dataclass(frozen=True, eq=False)
class ObservedObject:
    """Points of one object.

    Attributes:
        part, part_normals: Moving part in the pose of the first view, shape (n, 3). Normals point to the camera that
            saw the point, where one is known.
        rest, rest_normals: Everything else above the supporting plane near the part, shape (m, 3).
        up: Unit vector away from the support, shape (3,).
        support_height: Height of the supporting plane along ``up`` [m].
        p_camera: Where the first view's camera stood, shape (3,), or None.
        empty: Per body: which of some points (n, 3), pose of the first view, a camera saw to be empty.
        looks: What each view with a camera shows of the part.
    """

    part: Array
    part_normals: Array
    rest: Array
    rest_normals: Array
    up: Array
    support_height: float
    p_camera: Array | None
    empty: Mapping[str, Callable[[Array], NDArray[np.bool_]]] = field(
        default_factory=lambda: {"base": _unknown, "part": _unknown}
    )
    looks: tuple[Look, ...] = ()


def _unknown(p: Array) -> NDArray[np.bool_]:
    return np.zeros(len(p), dtype=bool)


def observe(estimate: JointEstimate, rng: np.random.Generator, reach_m: float = 0.5) -> ObservedObject:
    """Collect the points of the part and of what stands around it.

    Raises:
        ModelError: Too few points on the part.
    """
    X_back = np.linalg.inv(estimate.motion.transform())
    a, b = estimate.view_before, estimate.view_after
    in_a, in_b = estimate.parts.before, estimate.parts.after
    part = np.concatenate([a.points[in_a], b.points[in_b] @ X_back[:3, :3].T + X_back[:3, 3]])
    normals_a, normals_b = _outward(a), _outward(b)
    normals = np.concatenate([normals_a[in_a], normals_b[in_b] @ X_back[:3, :3].T])
    if len(part) < 200:
        raise ModelError(
            f"the moving part shows only {len(part)} points, 200 are needed for a model; look closer"
        )
    from s2r_host.perception.change import Change, compare

    label_a = compare(a, b).before
    static = (label_a == Change.STATIC) & ~in_a
    low, high = np.percentile(part, [1, 99], axis=0)
    near = static & ((a.points > low - reach_m) & (a.points < high + reach_m)).all(axis=1)
    rest, rest_normals = a.points[near], normals_a[near]
    p_plane, normal = _support(rest, rest_normals, part, a.p_camera, estimate.up, rng)
    above = (rest - p_plane) @ normal > SUPPORT_CLEARANCE_M
    up = estimate.up if estimate.up is not None and normal @ estimate.up > UPRIGHT_COS else normal
    # Height of the plane below the part, measured along ``up`` (tables are never quite level).
    middle = np.median(part, axis=0)
    height = float(up @ middle - (middle - p_plane) @ normal / (normal @ up))
    X = estimate.motion.transform()
    empty = {
        "base": lambda p: _through(a, p) | _through(b, p),
        "part": lambda p: _through(a, p) | _through(b, p @ X[:3, :3].T + X[:3, 3]),
    }
    looks = (*_look(a, in_a, np.eye(4)), *_look(b, in_b, X_back))
    return ObservedObject(
        part, normals, rest[above], rest_normals[above], up, height, a.p_camera, empty, looks
    )


def _look(view: View, mask: NDArray[np.bool_], X: Array) -> Iterator[Look]:
    """The part in a view, carried by X (4, 4); nothing where no camera is known."""
    if view.p_camera is None:
        return
    found = outlines_of(view, mask)
    if found is not None:
        found = Edges(found.points @ X[:3, :3].T + X[:3, 3], found.across @ X[:3, :3].T, found.sharp)
    yield Look(view.points[mask] @ X[:3, :3].T + X[:3, 3], X[:3, :3] @ view.p_camera + X[:3, 3], found)


def _outward(view: View) -> Array:
    """Normals of a view's points, (n, 3), towards its camera if that is known."""
    if view.oriented or view.p_camera is None:
        return view.normals
    inward = np.einsum("ni,ni->n", view.normals, view.p_camera - view.points) < 0
    return np.where(inward[:, None], -view.normals, view.normals)


def _through(view: View, p: Array) -> NDArray[np.bool_]:
    return view.look(p, 0.0, EMPTY_M).seen == Seen.FREE


def _support(
    rest: Array,
    normals: Array,
    part: Array,
    p_camera: Array | None,
    up: Array | None,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Point and normal of the plane the object stands on.

    Takes the largest level plane with nearly all points of the part on one side; without any: level, through the lowest
    point seen. Where nothing tells what is level (``up`` is None), any such plane: the front of a cabinet has all of
    its drawer on one side, too, and would else be what the cabinet stands on wherever no floor is in view.
    """
    chosen = rng.permutation(len(rest))[:8000]
    best: tuple[int, Array, Array] | None = None
    for plane in find_planes(rest[chosen], normals[chosen], rng, most=5) if len(rest) > 200 else []:
        n = plane.normal
        side = (part - plane.centre) @ n
        if np.median(side) < 0:
            n, side = -n, -side
        if up is not None and n @ up < LEVEL_COS:
            continue
        if np.percentile(side, 3) < -0.01:
            continue
        if p_camera is not None and (p_camera - plane.centre) @ n < 0:
            continue
        if best is None or plane.size > best[0]:
            best = (plane.size, plane.centre, n)
    if best is None:
        level = UP_IN_PICTURE if up is None else up
        everything = np.concatenate([rest, part])
        return everything[int(np.argmin(everything @ level))], level
    return best[1], best[2]
