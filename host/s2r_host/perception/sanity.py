"""Reasons to answer nothing: views that are no pair, a camera that moved, two parts that moved."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from s2r_host.perception.change import Change, Changes
from s2r_host.perception.errors import AbstainError, BadViewError
from s2r_host.perception.evidence import COST_ON_SURFACE, Probe, Scene, carry, score, subset, thinned
from s2r_host.perception.motion import JointMotion, rotation
from s2r_host.perception.planes import find_planes
from s2r_host.perception.refine import Side, refine
from s2r_host.perception.view import DepthView, Seen, View

Array = NDArray[np.floating]

SECOND_PART_SHARE = 0.15
SECOND_PART_EXPLAINED = 0.45
MOST_CAMERA_SHIFT_M = 0.006
# A camera that moved: so much more of the surroundings agrees once they are moved, or most of what did not agree does.
MORE_AGREES, MOST_AGREES, CLEAR_SHIFT_M = 0.15, 0.6, 0.010


def check_pair(before: View, after: View) -> None:
    """Refuse the same file twice and views without overlap.

    Raises:
        BadViewError: Nothing can be compared.
    """
    if len(before.points) == len(after.points) and np.array_equal(before.points, after.points):
        raise BadViewError(
            "both views are identical, number for number; give one before and one after the motion"
        )
    seen = after.look(before.points[:: max(1, len(before.points) // 3000)], 0.002).seen
    shared = float(np.isin(seen, (Seen.SURFACE, Seen.FREE, Seen.HIDDEN)).mean())
    if shared < 0.2:
        raise BadViewError(
            f"only {100 * shared:.0f} % of the first view lies in the sight of the second; the views do not overlap,"
            " or their frames differ"
        )


def check_same_camera(
    before: View, after: View, changes: Changes, surroundings: NDArray[np.bool_], rng: np.random.Generator
) -> None:
    """Refuse a pair whose unmoving surroundings do not coincide.

    Aligns the surroundings by a small free motion; if that fits clearly better than the given poses, the camera (or
    its calibration) moved. Every direction of surface counts alike, else a large table would hide a shift along it.

    Args:
        before: First view.
        after: Second view.
        changes: Labels of both.
        surroundings: Points of the first view that are not the moving part.
        rng: For sampling.

    Raises:
        AbstainError: By how much the surroundings seem to have moved.
    """
    static = float((changes.before == Change.STATIC)[surroundings].mean()) if surroundings.any() else 0.0
    if static < 0.05:
        raise AbstainError(
            f"only {100 * static:.0f} % of the surroundings are unchanged between the views; the camera moved or the"
            " views show different scenes"
        )
    use = _balanced(before, np.flatnonzero(surroundings & before.normal_ok), rng)
    if len(use) < 300:
        return
    p, sigma = before.points[use], before.sigma_m[use]
    fit_now = _matched(p, sigma, after, np.eye(4))
    if fit_now > 0.95:
        return
    centre = p.mean(axis=0)
    X = np.eye(4)
    for gate in (0.06, 0.06, 0.05, 0.05, 0.04, 0.03, 0.02, 0.015, 0.01, 0.008):
        step = _align_step(p, sigma, after, X, centre, gate)
        if step is None:
            return
        X = step @ X
    fit_then = _matched(p, sigma, after, X)
    moved_m = float(np.median(np.linalg.norm(p @ X[:3, :3].T + X[:3, 3] - p, axis=1)))
    more = moved_m > MOST_CAMERA_SHIFT_M and fit_then > fit_now + MORE_AGREES and fit_then > 0.5
    most = moved_m > CLEAR_SHIFT_M and fit_then - fit_now > MOST_AGREES * (1.0 - fit_now)
    if more or most:
        raise AbstainError(
            f"the surroundings moved by {moved_m * 1e3:.0f} mm between the views ({100 * fit_then:.0f} % of them agree"
            f" after moving them, {100 * fit_now:.0f} % as given): the camera moved; fix it, or give the pose of each"
            " view"
        )


def _balanced(
    view: View, index: NDArray[np.int64], rng: np.random.Generator, most: int = 4000
) -> NDArray[np.int64]:
    """At most ``most`` points, no more than a quarter of them from one of the 26 main directions of normals."""
    direction = np.rint(view.normals[index] / np.abs(view.normals[index]).max(axis=1, keepdims=True)).astype(
        int
    )
    number = direction @ np.array([9, 3, 1])
    chosen = []
    for value in np.unique(number):
        members = index[number == value]
        if len(members) >= 60:
            chosen.append(rng.permutation(members)[: most // 4])
    if not chosen:
        return np.zeros(0, dtype=np.int64)
    everything = np.concatenate(chosen)
    return rng.permutation(everything)[:most]


def check_second_part(
    best: JointMotion,
    scanned: list[JointMotion],
    scene: Scene,
    both: tuple[Side, Side],
    probes: tuple[Probe, Probe],
    rng: np.random.Generator,
) -> None:
    """Refuse a pair in which a second rigid piece moved differently.

    A second piece is claimed only if what the best motion leaves over is large, half of it follows one other
    motion, and that half is a flat piece of its own: the arm that moves a lid moves too, but is not flat.

    Args:
        best: The chosen motion.
        scanned: All motions of the scan; the leftover is judged by them anew.
        scene: Both views.
        both: Prepared sides for refinement.
        probes: Samples of surely moved points.
        rng: For sampling.

    Raises:
        AbstainError: Names both motions.
    """
    left = ~_fitting(best, scene, probes)
    if left.sum() < max(100, SECOND_PART_SHARE * len(left)):
        return
    count = len(probes[0].points)
    rest = subset(probes[0], left[:count]), subset(probes[1], left[count:])
    cost = score(scanned, scene, thinned(rest[0], 100), thinned(rest[1], 100), extra_m=0.006)
    for k in np.argsort(cost, kind="stable")[:3]:
        refined = refine(scanned[int(k)], both)
        other = scanned[int(k)] if refined is None else refined.motion
        follows = _fitting(other, scene, rest)
        if float(follows.mean()) > SECOND_PART_EXPLAINED and _flat_elsewhere(probes, left, follows, rng):
            raise AbstainError(
                f"two parts moved: besides the {best.joint_type} part ({best.delta:.3g}"
                f" {'rad' if best.joint_type == 'revolute' else 'm'}), {100 * left.mean():.0f} % of the change follows"
                f" another {other.joint_type} motion ({other.delta:.3g}); move one part at a time or give --region"
            )


def _flat_elsewhere(
    probes: tuple[Probe, Probe], left: NDArray[np.bool_], follows: NDArray[np.bool_], rng: np.random.Generator
) -> bool:
    """Whether the points that follow the other motion form a flat piece, 3 cm or more from the first part."""
    count = len(probes[0].points)
    kept = 0
    follower = np.zeros(len(left), dtype=bool)
    follower[np.flatnonzero(left)[follows]] = True
    for part, own, second in (
        (probes[0], ~left[:count], follower[:count]),
        (probes[1], ~left[count:], follower[count:]),
    ):
        if second.sum() < 40:
            continue
        index = np.flatnonzero(second)
        if own.any():
            distance, _ = cKDTree(part.points[own]).query(part.points[index])
            index = index[distance > 0.03]
        index = index[part.normal_ok[index]]
        planes = (
            find_planes(part.points[index], part.normals[index], rng, 1, 0.003) if len(index) >= 40 else []
        )
        kept += planes[0].size if planes else 0
    return kept > 0.1 * len(left)


def _fitting(motion: JointMotion, scene: Scene, probes: tuple[Probe, Probe]) -> NDArray[np.bool_]:
    """Which sampled points of both views land on a matching surface."""
    X = motion.transform()[None]
    costs = []
    for part, view, label, T in (
        (probes[0], scene.after, scene.changes.after, X),
        (probes[1], scene.before, scene.changes.before, np.linalg.inv(X)),
    ):
        costs.append(carry(T, part, view, label, 0.001)[0] if len(part.points) else np.zeros(0))
    return np.concatenate(costs) <= COST_ON_SURFACE


def _align_step(p: Array, sigma: Array, after: View, X: Array, centre: Array, gate_m: float) -> Array | None:
    """One Gauss-Newton step of rigid point-to-plane alignment as a transform (4, 4)."""
    at = p @ X[:3, :3].T + X[:3, 3]
    found = after.look(at, sigma, extra_m=gate_m)
    index = np.maximum(found.index, 0)
    n = after.normals[index]
    r = np.einsum("ni,ni->n", at - after.points[index], n)
    use = (found.seen == Seen.SURFACE) & after.normal_ok[index] & (np.abs(r) < gate_m)
    if use.sum() < 200:
        return None
    arm = np.cross(at[use] - centre, n[use])
    J = np.concatenate([arm, n[use]], axis=1)
    w = 1.0 / np.sqrt(1.0 + (r[use] / 0.002) ** 2)
    H = (J * w[:, None]).T @ J
    # Directions that no surface fixes stay put.
    H += np.diag([1e-3 * H[:3, :3].trace()] * 3 + [1e-3 * H[3:, 3:].trace()] * 3)
    step = -np.linalg.solve(H, (J * w[:, None]).T @ r[use])
    angle = float(np.linalg.norm(step[:3]))
    R = np.eye(3)
    if angle > 1e-12:
        R = rotation(step[:3] / angle, angle)
    result = np.eye(4)
    result[:3, :3] = R
    result[:3, 3] = centre - R @ centre + step[3:]
    return result


def _matched(p: Array, sigma: Array, after: View, X: Array) -> float:
    """Share of the points that can be judged and lie on a surface of the other view."""
    at = p @ X[:3, :3].T + X[:3, 3]
    found = after.look(at, sigma)
    judged = np.isin(found.seen, (Seen.SURFACE, Seen.FREE, Seen.HIDDEN))
    if isinstance(after, DepthView):
        index = np.maximum(found.index, 0)
        offset = np.abs(np.einsum("ni,ni->n", at - after.points[index], after.normals[index]))
        on = (found.seen == Seen.SURFACE) & (offset < 3 * after.sigma_m[index])
    else:
        on = found.seen == Seen.SURFACE
    return float(on.sum() / max(1, judged.sum()))
