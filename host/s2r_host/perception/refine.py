"""Two-way robust refinement of a one-joint motion: point to plane on surfaces, point to line on edges."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from s2r_host.perception.change import Change
from s2r_host.perception.edges import Edges, edges_of
from s2r_host.perception.evidence import THICKEST_M, Scene
from s2r_host.perception.motion import JointMotion, perpendicular_basis, rotation, unit
from s2r_host.perception.view import Seen, View, agreement
from s2r_host.perception.wishes import Wishes

Array = NDArray[np.floating]

SOFT_M = 0.002  # scale of the soft-L1 loss on surfaces
MOST_EDGES = 600
LAST_GATE_M = 0.006
LEAST_ROWS, LEAST_SPREAD_M = 30, 0.0005  # of surface; a fit is not believed to be closer
CORRELATED_POINTS = 30.0  # neighbouring pixels share their matching window, hence their error
# A plate that shows its other face afterwards: its thickness is one more unknown, known beforehand to be about this,
# within a factor of 1.35.
PLATE_M, PLATE_LOG_SIGMA = 0.010, 0.3
LEAST_BACK_SHARE = 0.5  # of the surface rows, for a motion to count as turning a plate over


@dataclass(frozen=True, eq=False)
class Side:
    """Everything of one direction (points of one view carried into the other) that stays fixed."""

    points: Array
    normals: Array
    normal_ok: NDArray[np.bool_]
    sigma_m: Array
    edges: Edges
    target: View
    target_label: NDArray[np.uint8]
    target_edges: Edges
    edge_tree: cKDTree | None
    oriented: bool


@dataclass(frozen=True, eq=False)
class Refined:
    """A refined motion.

    Attributes:
        motion: The motion.
        residual_m: Robust spread of the point-to-plane residuals [m].
        covariance: Of the local parameters (see `perturbed`), with residual scale.
        used: Number of surface points that took part.
        plate_m: Thickness of the part if it shows opposite faces in the two views, else None.
        exact: How many of the direction's two angles were taken to be as mounted: both of a lever's upright hinge, one
            of a level one.
    """

    motion: JointMotion
    residual_m: float
    covariance: Array
    used: int
    plate_m: float | None = None
    exact: int = 0


def sides(scene: Scene, rng: np.random.Generator, most: int = 2500) -> tuple[Side, Side]:
    """Prepare both directions: candidate part points (everything near that is not surely static)."""
    edges_before, edges_after = edges_of(scene)
    box = _moved_box(scene)
    forward = _side(
        scene.before, scene.changes.before, scene.candidate_before, box, scene.after,
        scene.changes.after, edges_before, edges_after, rng, most,
    )  # fmt: skip
    backward = _side(
        scene.after, scene.changes.after, scene.candidate_after, box, scene.before,
        scene.changes.before, edges_after, edges_before, rng, most,
    )  # fmt: skip
    return forward, backward


def refine(
    start: JointMotion,
    both: tuple[Side, Side],
    rounds: int = 8,
    first_gate_m: float = 0.02,
    wishes: Wishes | None = None,
) -> Refined | None:
    """Gauss-Newton with re-association in every round; None if nothing overlaps.

    Args:
        start: Where to begin.
        both: From `sides`.
        rounds: Re-associations; the association gate shrinks from ``first_gate_m`` to 6 mm over them.
        first_gate_m: First gate [m].
        wishes: What is known of joints beforehand; held against the surface rows as if neighbouring pixels were one
            measurement.
    """
    motion, plate = start, PLATE_M
    gates = np.geomspace(first_gate_m, LAST_GATE_M, rounds)
    scale = 0.01
    for gate in gates:
        system = linearised(motion, plate, both, float(gate))
        if system.surface.sum() < LEAST_ROWS:
            return None
        hessian, gradient = system.normal_equations()
        pull, push = wished(motion, plate, wishes, scale)
        hessian, gradient = hessian + pull, gradient + push
        damping = np.diag(1e-4 * np.diag(hessian) + 1e-9)
        step = -np.linalg.solve(hessian + damping, gradient)
        motion = perturbed(motion, limited(step[:-1], motion))
        plate = float(np.clip(plate + step[-1], 0.5 * plate, THICKEST_M))
        scale = system.scale_m()
    system = linearised(motion, plate, both, LAST_GATE_M)
    if system.surface.sum() < LEAST_ROWS:
        return None
    scale = system.scale_m()
    hessian = system.normal_equations()[0]
    hessian += 1e-9 * np.eye(len(hessian)) + wished(motion, plate, wishes, scale)[0]
    spread = max(scale, LEAST_SPREAD_M)
    covariance = np.linalg.inv(hessian)[:-1, :-1] * spread**2 * CORRELATED_POINTS
    turned_over = float(system.back.sum()) > LEAST_BACK_SHARE * float(system.surface.sum())
    return Refined(
        motion.positive(), scale, covariance, int(system.surface.sum()), plate if turned_over else None
    )


def wished(motion: JointMotion, plate_m: float, wishes: Wishes | None, scale_m: float) -> tuple[Array, Array]:
    """Hessian and gradient of the wishes and of the plate's thickness, in units of the surface rows."""
    steps = _steps(motion)
    active = [] if wishes is None else wishes.active(motion)
    r = np.array([wish(motion) for wish in active] + [np.log(plate_m / PLATE_M) / PLATE_LOG_SIGMA])
    J = np.zeros((len(r), len(steps) + 1))
    J[-1, -1] = 1.0 / (PLATE_LOG_SIGMA * plate_m)
    for k, step in enumerate(steps):
        moved = perturbed(motion, np.eye(len(steps))[k] * step)
        J[:-1, k] = (np.array([wish(moved) for wish in active]) - r[:-1]) / step
    weight = max(scale_m, LEAST_SPREAD_M) ** 2 * CORRELATED_POINTS
    return weight * J.T @ J, weight * J.T @ r


def perturbed(motion: JointMotion, step: Array) -> JointMotion:
    """Motion with local parameters changed.

    Prismatic: (tilt1, tilt2, delta); revolute: (tilt1, tilt2, shift1, shift2, delta). Tilts [rad] turn the
    direction about the two basis vectors of `perpendicular_basis`, shifts [m] move the line along them.
    """
    e1, e2 = perpendicular_basis(motion.direction)
    tilt = step[0] * e1 + step[1] * e2
    angle = float(np.linalg.norm(tilt))
    direction = motion.direction
    if angle > 1e-12:
        direction = unit(rotation(tilt / angle, angle) @ direction)
    origin = motion.origin
    if motion.joint_type == "revolute":
        origin = origin + step[2] * e1 + step[3] * e2
    return replace(motion, origin=origin, direction=direction, delta=motion.delta + float(step[-1]))


def _steps(motion: JointMotion) -> Array:
    """Finite-difference steps of the local parameters."""
    if motion.joint_type == "prismatic":
        return np.array([1e-5, 1e-5, 1e-6])
    return np.array([1e-5, 1e-5, 1e-6, 1e-6, 1e-5])


def limited(step: Array, motion: JointMotion) -> Array:
    """No more than 12 degrees of tilt, 3 cm of shift, 3 cm or 12 degrees of delta in one round."""
    limit = np.array([0.2, 0.2, 0.03] if motion.joint_type == "prismatic" else [0.2, 0.2, 0.03, 0.03, 0.2])
    return step / max(1.0, float(np.max(np.abs(step) / limit)))


@dataclass(frozen=True, eq=False)
class System:
    """Linearised residuals; the last column of the jacobian is the thickness of the plate.

    Attributes:
        J, r, w: Jacobian (rows, parameters + 1), residuals [m] and robust weights (rows,).
        surface: Rows of points on surfaces, near face or far.
        back: Rows of points on the far face of a plate.
    """

    J: Array
    r: Array
    w: Array
    surface: NDArray[np.bool_]
    back: NDArray[np.bool_]

    def normal_equations(self) -> tuple[Array, Array]:
        """Hessian and gradient."""
        weighted = (self.J * self.w[:, None]).T
        return weighted @ self.J, weighted @ self.r

    def scale_m(self) -> float:
        """Robust spread of the surface residuals [m]."""
        return 1.4826 * float(np.median(np.abs(self.r[self.surface])))


def linearised(motion: JointMotion, plate_m: float, both: tuple[Side, Side], gate_m: float) -> System:
    """Rows of both directions at a motion, for a plate of some thickness, within a gate."""
    X = motion.transform()
    steps = _steps(motion)
    moved = [perturbed(motion, np.eye(len(steps))[k] * steps[k]).transform() for k in range(len(steps))]
    D_forward = np.stack([(M - X) / s for M, s in zip(moved, steps, strict=True)])
    X_back = np.linalg.inv(X)
    D_back = np.stack([(np.linalg.inv(M) - X_back) / s for M, s in zip(moved, steps, strict=True)])
    J, r, w, back, surface = [], [], [], [], []
    for side, T, D in ((both[0], X, D_forward), (both[1], X_back, D_back)):
        far, *rows = _surface_rows(side, T, D, plate_m, gate_m)
        edge = _edge_rows(side, T, D, gate_m)
        for (j, residual, weight), on_surface, on_back in (
            (rows, True, far),
            (edge, False, np.zeros(len(edge[1]), bool)),
        ):
            J.append(np.hstack([j, on_back[:, None].astype(float)]))
            r.append(residual)
            w.append(weight)
            back.append(on_back)
            surface.append(np.full(len(residual), on_surface))
    return System(*(np.concatenate(part) for part in (J, r, w, surface, back)))


def _surface_rows(
    side: Side, T: Array, D: Array, plate_m: float, gate_m: float
) -> tuple[NDArray[np.bool_], Array, Array, Array]:
    """Which rows lie on a plate's far face; jacobian, residuals [m] and weights.

    A point carried behind a surface that faces the other way is on the far face of a plate if it lies as deep as the
    plate is thick.
    """
    if len(side.points) == 0:
        return np.zeros(0, bool), np.zeros((0, len(D))), np.zeros(0), np.zeros(0)
    p = side.points @ T[:3, :3].T + T[:3, 3]
    found = side.target.look(p, side.sigma_m, extra_m=gate_m)
    index = np.maximum(found.index, 0)
    n = side.target.normals[index]
    r = np.einsum("ni,ni->n", p - side.target.points[index], n)
    cosine = agreement(side.normals @ T[:3, :3].T, n, side.oriented)
    fair = side.target.normal_ok[index] & side.normal_ok & (side.target_label[index] != Change.STATIC)
    near = fair & (found.seen == Seen.SURFACE) & (cosine > 0.85) & (np.abs(r) < gate_m)
    seen = (found.seen == Seen.SURFACE) | (found.seen == Seen.HIDDEN)
    back = fair & seen & (cosine < -0.85) & (np.abs(r + plate_m) < gate_m)
    r = np.where(back, r + plate_m, r)
    use = near | back
    q = np.concatenate([side.points[use], np.ones((int(use.sum()), 1))], axis=1)
    J = np.einsum("kij,nj,ni->nk", D[:, :3, :], q, n[use])
    w = 1.0 / np.sqrt(1.0 + (r[use] / SOFT_M) ** 2)
    return back[use], J, r[use], w


def _edge_rows(side: Side, T: Array, D: Array, gate_m: float) -> tuple[Array, Array, Array]:
    empty = np.zeros((0, len(D))), np.zeros(0), np.zeros(0)
    if len(side.edges.points) == 0 or side.edge_tree is None:
        return empty
    p = side.edges.points @ T[:3, :3].T + T[:3, 3]
    target = side.target_edges
    index = target.matched(side.edge_tree, p, side.edges.across @ T[:3, :3].T, 2.0 * gate_m)
    use = index >= 0
    if not use.any():
        return empty
    m = target.across[index[use]]
    r = np.einsum("ni,ni->n", p[use] - target.points[index[use]], m)
    q = np.concatenate([side.edges.points[use], np.ones((int(use.sum()), 1))], axis=1)
    J = np.einsum("kij,nj,ni->nk", D[:, :3, :], q, m)
    # Scaled to the surface rows: (2 mm / its own softness)² as much.
    w = target.weight * (SOFT_M / target.soft_m) ** 2 / np.sqrt(1.0 + (r / target.soft_m) ** 2)
    return J, r, w


def _moved_box(scene: Scene) -> tuple[Array, Array]:
    points = np.concatenate(
        [scene.before.points[scene.moved_before()], scene.after.points[scene.moved_after()]]
    )
    low, high = np.percentile(points, [1, 99], axis=0)
    return low - 0.05, high + 0.05


def _side(
    view: View, label: NDArray[np.uint8], candidate: NDArray[np.bool_], box: tuple[Array, Array],
    target: View, target_label: NDArray[np.uint8],
    edges: Edges, target_edges: Edges, rng: np.random.Generator, most: int,
) -> Side:  # fmt: skip
    inside = ((view.points > box[0]) & (view.points < box[1])).all(axis=1)
    sure = np.flatnonzero((label == Change.MOVED) & candidate & view.normal_ok)
    maybe = np.flatnonzero((label == Change.UNKNOWN) & candidate & inside & view.normal_ok)
    chosen = np.concatenate([rng.permutation(sure)[:most], rng.permutation(maybe)[: most // 2]])
    near = np.flatnonzero(((edges.points > box[0]) & (edges.points < box[1])).all(axis=1))
    return Side(
        view.points[chosen], view.normals[chosen], view.normal_ok[chosen], view.sigma_m[chosen],
        edges.of(rng.permutation(near)[:MOST_EDGES]), target, target_label, target_edges, target_edges.tree(),
        view.oriented and target.oriented,
    )  # fmt: skip
