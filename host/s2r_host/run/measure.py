"""Where the moving part is now, seen by the camera: a fit of the known joint, one degree of freedom.

The part's points and normals, brought to joint value 0 from the two views that built the model, are moved by the
joint until they lie on the new view: first a scan over the whole range against the depth image, then
point-to-plane steps with outliers weighed down.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from s2r_host.errors import SceneError
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.view import DepthView

SCAN_STEP_M = 0.002  # of the part's outermost points
TRUNCATION_M = 0.012
GATE_M = 0.006
LEAST_FACING = 0.35
LEAST_MATCHED = 0.25
MOST_POINTS = 6000
STEPS = 8


@dataclass(frozen=True, eq=False)
class PartTemplate:
    """Surface of the moving part at joint value 0, base frame.

    Attributes:
        p: Points [m], (n, 3).
        n: Unit normals, (n, 3).
        motion: The joint, its direction towards growing values; ``delta`` is not used.
    """

    p: np.ndarray
    n: np.ndarray
    motion: JointMotion

    @property
    def axis(self) -> np.ndarray:
        """Unit vector along (slide) or about (hinge) which the joint grows, base frame, (3,)."""
        return self.motion.direction

    @property
    def slides(self) -> bool:
        """The joint is prismatic."""
        return self.motion.joint_type == "prismatic"

    @property
    def reach_m(self) -> float:
        """How far the outermost point goes per unit of the joint: 1 for a slide, the largest radius of a hinge [m]."""
        return 1.0 if self.slides else float(np.linalg.norm(self._lever_arms(self.p), axis=1).max())

    def pose(self, s: float) -> np.ndarray:
        """X (4, 4) from joint value 0 to s."""
        return replace(self.motion, delta=s).transform()

    def at(self, s: float) -> tuple[np.ndarray, np.ndarray]:
        """Points [m] and normals at joint value s, both (n, 3)."""
        X = self.pose(s)
        return self.p @ X[:3, :3].T + X[:3, 3], self.n @ X[:3, :3].T

    def velocity(self, p: np.ndarray) -> np.ndarray:
        """Motion of points of the part per unit of the joint, (n, 3)."""
        return np.broadcast_to(self.axis, p.shape) if self.slides else self._lever_arms(p)

    def with_back(self, thickness_m: float) -> PartTemplate:
        """With the hidden face of a plate, too: a lid that turns may show the camera the side it had not seen."""
        p = np.concatenate([self.p, self.p - thickness_m * self.n])
        return replace(self, p=p, n=np.concatenate([self.n, -self.n]))

    def _lever_arms(self, p: np.ndarray) -> np.ndarray:
        return np.cross(self.axis, p - self.motion.origin)


@dataclass(frozen=True)
class Measurement:
    """A measured joint value.

    Attributes:
        s: Joint value [m or rad].
        sigma: Its standard error, from the spread over patches of the surface [m or rad].
        residual_m: Median distance of the matched points from the surface [m].
        matched: Share of the template's points that lie on the view.
    """

    s: float
    sigma: float
    residual_m: float
    matched: float


def part_template(estimate: JointEstimate) -> PartTemplate:
    """The part from both views of an estimate, whose joint grows along the estimate's direction.

    Raises:
        SceneError: The views are bare clouds.
    """
    points, normals = [], []
    motion = estimate.motion
    for view, part, s in (
        (estimate.view_before, estimate.parts.before, 0.0),
        (estimate.view_after, estimate.parts.after, estimate.delta),
    ):
        if not isinstance(view, DepthView):
            raise SceneError("measuring the state needs depth images, not bare clouds")
        keep = part & view.normal_ok & ~view.edge
        back = np.linalg.inv(replace(motion, delta=s).transform())
        points.append(view.points[keep] @ back[:3, :3].T + back[:3, 3])
        normals.append(view.normals[keep] @ back[:3, :3].T)
    p, n = np.concatenate(points), np.concatenate(normals)
    stride = max(1, len(p) // MOST_POINTS)
    return PartTemplate(p[::stride], n[::stride], motion)


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
        s_range: Where to look [m or rad].
        s_expected: Breaks ties between equally good places [m or rad].

    Raises:
        SceneError: The part is not found.
    """
    view = DepthView(frame, ignore)
    reach_m = template.reach_m
    candidates = np.arange(s_range[0], s_range[1] + 1e-9, SCAN_STEP_M / reach_m)
    costs = np.array([_cost(template, view, s) for s in candidates])
    if s_expected is not None:
        costs += 0.02 * TRUNCATION_M * np.minimum(reach_m * np.abs(candidates - s_expected) / 0.1, 1.0)
    s = float(candidates[int(np.argmin(costs))])
    for _ in range(STEPS):
        fit = _matched(template, view, s)
        s += fit.step()
    fit = _matched(template, view, s)
    share = float(fit.use.sum() / fit.tells.sum())
    if share < LEAST_MATCHED:
        raise SceneError(
            f"only {share:.0%} of the moving part's surface lies on the new view near s = {s:.3f} "
            f"(limit {LEAST_MATCHED:.0%}); did the object move as a whole?"
        )
    return Measurement(s, fit.standard_error(), float(np.median(np.abs(fit.r[fit.use]))), share)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Residuals of the template's points at one joint value.

    Attributes:
        p: The points there [m], (n, 3).
        r: Distance of the seen surface along the normal [m], (n,).
        lever: Motion along the normal per unit of the joint [m], (n,).
        tells: Points whose surface moves across itself, so that they tell the joint value, (n,).
        use: Those among them that were seen and are near, (n,).
    """

    p: np.ndarray
    r: np.ndarray
    lever: np.ndarray
    tells: np.ndarray
    use: np.ndarray

    def step(self) -> float:
        """Change of the joint value that brings the points to the surface."""
        lever, r = self.lever[self.use], self.r[self.use]
        weight = (1.0 - (r / GATE_M) ** 2) ** 2  # Tukey
        return float((weight * lever * r).sum() / (weight * lever * lever).sum())

    def standard_error(self) -> float:
        """From patches of 3 cm: neighbouring pixels err together, so points are no independent sample."""
        cells = np.floor(self.p[self.use] / 0.03).astype(int)
        patch = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
        lever, r = self.lever[self.use], self.r[self.use]
        total, typical = np.bincount(patch, lever * lever), float(np.median(lever * lever))
        enough = total > 5.0 * typical
        per_patch = np.bincount(patch, lever * r)[enough] / total[enough]
        if len(per_patch) < 3:
            return float("inf")
        return float(1.4826 * np.median(np.abs(per_patch - np.median(per_patch))) / np.sqrt(len(per_patch)))


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
    index, z = _project(view, template.at(s)[0])
    seen = index >= 0
    z_seen = (view.points[index[seen]] @ view.X_camera_base[2, :3]) + view.X_camera_base[2, 3]
    total = np.minimum(np.abs(z_seen - z[seen]), TRUNCATION_M).sum()
    return float(total + 0.5 * TRUNCATION_M * (~seen).sum()) / len(z)


def _matched(template: PartTemplate, view: DepthView, s: float) -> _Fit:
    """Residuals of all points and which of them tell the state."""
    p, n = template.at(s)
    index, _ = _project(view, p)
    matched = index >= 0
    agree = np.zeros(len(p), bool)
    agree[matched] = np.einsum("ij,ij->i", view.normals[index[matched]], n[matched]) > 0.8
    matched &= agree
    r = np.zeros(len(p))
    r[matched] = np.einsum("ij,ij->i", n[matched], view.points[index[matched]] - p[matched])
    velocity = template.velocity(p)
    lever = np.einsum("ij,ij->i", n, velocity)
    tells = np.abs(lever) > LEAST_FACING * (1.0 if template.slides else 0.3 * template.reach_m)
    use = matched & (np.abs(r) < GATE_M) & tells
    if use.sum() < 50:
        raise SceneError(
            f"the moving part is not found in the new view: {int(use.sum())} of {len(p)} points match "
            f"near s = {s:.3f}; is it hidden, or did something else move?"
        )
    return _Fit(p, r, lever, tells, use)
