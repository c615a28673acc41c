"""Where the moving part is now, seen by the camera: a fit along the known axis, one degree of freedom.

The part's points and normals, brought to joint value 0 from the two views that built the model, are slid along
the axis until they lie on the new view: first a scan over the whole range against the depth image, then
point-to-plane steps with outliers weighed down. Slides only; hinges need the same with a rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.errors import SceneError
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.view import DepthView

SCAN_STEP_M = 0.002
TRUNCATION_M = 0.012
GATE_M = 0.006
LEAST_FACING = 0.35
LEAST_MATCHED = 0.25
MOST_POINTS = 6000
STEPS = 8


@dataclass(frozen=True, eq=False)
class PartTemplate:
    """Surface of the moving part at joint value 0, base frame: points [m] and unit normals (n, 3), unit axis (3,)."""

    p: np.ndarray
    n: np.ndarray
    axis: np.ndarray


@dataclass(frozen=True)
class Measurement:
    """A measured joint value.

    Attributes:
        s_m: Joint value [m].
        sigma_m: Its standard error, from the spread over patches of the surface [m].
        residual_m: Median distance of the matched points from the surface [m].
        matched: Share of the template's points that lie on the view.
    """

    s_m: float
    sigma_m: float
    residual_m: float
    matched: float


def part_template(estimate: JointEstimate, axis: np.ndarray, s_after: float) -> PartTemplate:
    """The part from both views of an estimate.

    Args:
        estimate: Of the views at joint values 0 and ``s_after``.
        axis: Direction of positive joint values, shape (3,).
        s_after: Joint value of the second view [m].
    """
    points, normals = [], []
    for view, part, s in (
        (estimate.view_before, estimate.parts.before, 0.0),
        (estimate.view_after, estimate.parts.after, s_after),
    ):
        if not isinstance(view, DepthView):
            raise SceneError("measuring the state needs depth images, not bare clouds")
        keep = part & view.normal_ok & ~view.edge
        points.append(view.points[keep] - s * axis)
        normals.append(view.normals[keep])
    p, n = np.concatenate(points), np.concatenate(normals)
    stride = max(1, len(p) // MOST_POINTS)
    return PartTemplate(p[::stride], n[::stride], np.asarray(axis, float))


def measure_state(
    template: PartTemplate,
    frame: DepthFrame,
    ignore: np.ndarray | None = None,
    s_range: tuple[float, float] = (-0.25, 0.5),
    s_expected: float | None = None,
) -> Measurement:
    """Joint value of the part in a new view.

    Args:
        template: Of :func:`part_template`.
        frame: The new view.
        ignore: Pixels to forget (the arm), shape (h, w), bool.
        s_range: Where to look [m].
        s_expected: Breaks ties between equally good places [m].

    Raises:
        SceneError: The part is not found.
    """
    view = DepthView(frame, ignore)
    candidates = np.arange(s_range[0], s_range[1] + 1e-9, SCAN_STEP_M)
    costs = np.array([_cost(template, view, s) for s in candidates])
    if s_expected is not None:
        costs += 0.02 * TRUNCATION_M * np.minimum(np.abs(candidates - s_expected) / 0.1, 1.0)
    s = float(candidates[int(np.argmin(costs))])
    for _ in range(STEPS):
        s += _step(template, *_matched(template, view, s))
    r, use = _matched(template, view, s)
    facing = np.abs(template.n @ template.axis) > LEAST_FACING
    share = float(use.sum() / facing.sum())
    if share < LEAST_MATCHED:
        raise SceneError(
            f"only {share:.0%} of the moving part's front lies on the new view near s = {s:.3f} m "
            f"(limit {LEAST_MATCHED:.0%}); did the cabinet move?"
        )
    return Measurement(s, _standard_error(template, r, use), float(np.median(np.abs(r[use]))), share)


def _project(view: DepthView, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(index of the view's point at the pixel or -1, depth) of points of shape (n, 3)."""
    p_C = p @ view.X_camera_base[:3, :3].T + view.X_camera_base[:3, 3]
    z = p_C[:, 2]
    safe = np.where(z > 0.05, z, 1.0)
    u = np.round(view.K[0, 0] * p_C[:, 0] / safe + view.K[0, 2]).astype(int)
    v = np.round(view.K[1, 1] * p_C[:, 1] / safe + view.K[1, 2]).astype(int)
    h, w = view.shape
    inside = (u >= 0) & (u < w) & (v >= 0) & (v < h) & (z > 0.05)
    index = np.full(len(p), -1, dtype=np.int64)
    index[inside] = view.index_of_pixel[v[inside] * w + u[inside]]
    return index, z


def _cost(template: PartTemplate, view: DepthView, s: float) -> float:
    """Mean truncated depth difference; pixels without a return count as half wrong."""
    index, z = _project(view, template.p + s * template.axis)
    seen = index >= 0
    z_seen = (view.points[index[seen]] @ view.X_camera_base[2, :3]) + view.X_camera_base[2, 3]
    total = np.minimum(np.abs(z_seen - z[seen]), TRUNCATION_M).sum()
    return float(total + 0.5 * TRUNCATION_M * (~seen).sum()) / len(z)


def _residuals(template: PartTemplate, view: DepthView, s: float) -> tuple[np.ndarray, np.ndarray]:
    """Distance of the seen surface from each point along its normal [m], and whether there is one."""
    p = template.p + s * template.axis
    index, _ = _project(view, p)
    matched = index >= 0
    agree = np.zeros(len(p), bool)
    agree[matched] = np.einsum("ij,ij->i", view.normals[index[matched]], template.n[matched]) > 0.8
    matched &= agree
    r = np.zeros(len(p))
    r[matched] = np.einsum("ij,ij->i", template.n[matched], view.points[index[matched]] - p[matched])
    return r, matched


def _matched(template: PartTemplate, view: DepthView, s: float) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of all points and which of them tell the state."""
    r, matched = _residuals(template, view, s)
    use = matched & (np.abs(r) < GATE_M) & (np.abs(template.n @ template.axis) > LEAST_FACING)
    if use.sum() < 50:
        raise SceneError(
            f"the moving part is not found in the new view: {int(use.sum())} of {len(template.p)} points match "
            f"near s = {s:.3f} m; is it hidden, or did something else move?"
        )
    return r, use


def _step(template: PartTemplate, r: np.ndarray, use: np.ndarray) -> float:
    lever = template.n[use] @ template.axis
    weight = (1.0 - (r[use] / GATE_M) ** 2) ** 2  # Tukey
    return float((weight * lever * r[use]).sum() / (weight * lever * lever).sum())


def _standard_error(template: PartTemplate, r: np.ndarray, use: np.ndarray) -> float:
    """From estimates over patches of 3 cm: neighbouring pixels err together, so points are no independent sample."""
    patch = np.unique(np.floor(template.p[use] / 0.03).astype(int), axis=0, return_inverse=True)[1].ravel()
    lever = template.n[use] @ template.axis
    total = np.bincount(patch, lever * lever)
    per_patch = np.bincount(patch, lever * r[use])[total > 5.0] / total[total > 5.0]
    if len(per_patch) < 3:
        return float("inf")
    return float(1.4826 * np.median(np.abs(per_patch - np.median(per_patch))) / np.sqrt(len(per_patch)))
