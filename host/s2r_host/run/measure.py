"""Where the moving part is now, seen by the camera: a fit of the known joint, one degree of freedom.

The part's points and normals, brought to joint value 0 from the two views that built the model, are moved by the
joint until they explain the new view: first a scan over the range against the depth image, coarse then fine, then
point-to-plane steps with outliers weighed down where enough of a known face is seen. Where it is not, as with a lid
edge-on, the image has the last word.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from s2r_host.errors import SceneError
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.view import DepthView
from s2r_host.run.image_cost import ImageCost

SCAN_STEP_M = 0.002  # of the part's outermost points
FINE_SPAN_M, FINE_STEP_M = 0.006, 0.0004
TRUST_M = 0.008  # of the outermost points: matching that ends further from the image's answer has gone astray
GATE_M = 0.006
VISIBLE_M = 0.006  # behind the nearest point of its cell, a point of the same surface
LEAST_FACING = 0.35
LEAST_MATCHED = 0.25
LEAST_SEEN = 0.4  # of the cells where the part, or what stays around it, should be seen
EDGE_ON = 0.15  # share of the cells covered at its broadest, below which a part is too thin to be looked for
AROUND_M = 0.15
LEAST_POINTS = 50
MOST_POINTS = 24_000
SCAN_POINTS = 8_000
STRIPS = 12
OUTLINE_M = 0.003  # the outline is known this well: thickness guessed, edges fattened by the stereo window
STEPS = 8


@dataclass(frozen=True, eq=False)
class PartTemplate:
    """Surface of the moving part at joint value 0, base frame.

    Attributes:
        p: Points [m], (n, 3).
        n: Unit normals, (n, 3).
        motion: The joint, its direction towards growing values; ``delta`` is not used.
        p_still: Points of what does not move [m], (m, 3).
        guessed: From this index on the points were never seen; they lie where a guessed thickness puts them.
    """

    p: np.ndarray
    n: np.ndarray
    motion: JointMotion
    p_still: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    guessed: int | None = None

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
        return replace(self, p=p, n=np.concatenate([self.n, -self.n]), guessed=len(self.p))

    def _lever_arms(self, p: np.ndarray) -> np.ndarray:
        return np.cross(self.axis, p - self.motion.origin)


@dataclass(frozen=True)
class Measurement:
    """A measured joint value.

    Attributes:
        s: Joint value [m or rad].
        sigma: Its standard error, from the spread over patches of the surface or strips of the image [m or rad].
        residual_m: Median distance of the matched points from the surface [m]; NaN when the image had the last word.
        matched: Share of what should be seen of the part that is.
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
    points, normals, still = [], [], []
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
        still.append(view.points[~part & ~view.edge])
    p, n = np.concatenate(points), np.concatenate(normals)
    stride = max(1, len(p) // MOST_POINTS)
    return PartTemplate(p[::stride], n[::stride], motion, np.concatenate(still))


def measure_state(
    template: PartTemplate,
    view: DepthView,
    s_range: tuple[float, float] = (-0.25, 0.5),
    s_expected: float | None = None,
) -> Measurement:
    """Joint value of the part in a new view.

    Args:
        template: Of :func:`part_template`.
        view: The new view, without the arm.
        s_range: Where to look [m or rad].
        s_expected: Breaks ties between equally good places [m or rad].

    Raises:
        SceneError: The part is not found.
    """
    image = ImageCost(view, template.p_still)
    s_image, sigma_image = _scan(template, image, s_range, s_expected)
    seen = _seen(template, image, s_image, s_range)
    if seen < LEAST_SEEN:
        raise SceneError(
            f"only {seen:.0%} of the moving part is seen where it should be, even at the best place "
            f"(s = {s_image:.3f}, limit {LEAST_SEEN:.0%}); is it hidden, or did the object move as a whole?"
        )
    s = s_image
    for _ in range(STEPS):
        fit = _matched(template, image, view, s)
        if fit.use.sum() < LEAST_POINTS:
            break
        s += fit.step()
    fit = _matched(template, image, view, s)
    share = float(fit.use.sum() / max(1, fit.tells.sum()))
    astray = template.reach_m * abs(s - s_image) > TRUST_M
    if fit.use.sum() < LEAST_POINTS or share < LEAST_MATCHED or astray:
        sigma_image = float(np.hypot(sigma_image, OUTLINE_M / template.reach_m))
        return Measurement(s_image, sigma_image, float("nan"), seen)
    unsure = OUTLINE_M / template.reach_m if fit.guessed[fit.use].mean() > 0.5 else 0.0
    sigma = float(np.hypot(fit.standard_error(), unsure))
    return Measurement(s, sigma, float(np.median(np.abs(fit.r[fit.use]))), share)


def _scan(
    template: PartTemplate, image: ImageCost, s_range: tuple[float, float], s_expected: float | None
) -> tuple[float, float]:
    """Joint value that explains the image best, and its standard error from strips of the image that err apart."""
    reach_m = template.reach_m
    thin = replace(template, p=template.p[:: max(1, len(template.p) // SCAN_POINTS)])
    coarse = np.arange(s_range[0], s_range[1] + 1e-9, SCAN_STEP_M / reach_m)
    costs = image.of([thin.at(s)[0] for s in coarse])[0]
    if s_expected is not None:
        costs = costs + 0.02 * np.minimum(reach_m * np.abs(coarse - s_expected) / 0.1, 1.0)
    if not np.isfinite(costs).any():
        raise SceneError("the moving part would be outside the view at every joint value it can have")
    fine = (
        coarse[int(np.nanargmin(costs))] + np.arange(-FINE_SPAN_M, FINE_SPAN_M + 1e-9, FINE_STEP_M) / reach_m
    )
    strips = image.of([template.at(s)[0] for s in fine], STRIPS)
    best = _vertex(fine, np.nansum(strips, axis=0))
    each = np.array([_vertex(fine, row) for row in strips if np.isfinite(row).all() and np.ptp(row) > 0.05])
    if len(each) < 3:
        return best, FINE_SPAN_M / reach_m
    return best, float(1.4826 * np.median(np.abs(each - np.median(each))) / np.sqrt(len(each)))


def _seen(template: PartTemplate, image: ImageCost, s: float, s_range: tuple[float, float]) -> float:
    """Share of what should be seen that is: of the part, or of what stays around it while the part is edge-on."""
    p = template.at(s)[0]
    most = max(image.cells(template.at(one)[0]) for one in np.linspace(*s_range, 9))
    if image.cells(p) > EDGE_ON * most:
        return image.seen_as_told(p)
    low, high = p.min(axis=0) - AROUND_M, p.max(axis=0) + AROUND_M
    around = np.all((template.p_still > low) & (template.p_still < high), axis=1)
    return image.seen_as_told(template.p_still[around])


def _vertex(s: np.ndarray, cost: np.ndarray) -> float:
    """Middle of the lowest part of a curve: its values within a tenth of its range, weighed by their depth."""
    low = cost.min()
    weight = np.maximum(0.0, low + 0.1 * np.ptp(cost) - cost)
    return float((weight * s).sum() / weight.sum()) if weight.any() else float(s.mean())


@dataclass(frozen=True, eq=False)
class _Fit:
    """Residuals of the template's points at one joint value.

    Attributes:
        p: The points there [m], (n, 3).
        r: Distance of the seen surface along the normal [m], (n,).
        lever: Motion along the normal per unit of the joint [m], (n,).
        tells: Points whose surface moves across itself, so that they tell the joint value, (n,).
        use: Those among them that were seen and are near, (n,).
        guessed: Points of a face that no view of the template showed, (n,).
    """

    p: np.ndarray
    r: np.ndarray
    lever: np.ndarray
    tells: np.ndarray
    use: np.ndarray
    guessed: np.ndarray

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


def _matched(template: PartTemplate, image: ImageCost, view: DepthView, s: float) -> _Fit:
    """Residuals of the points that face the camera at a joint value, and which of them tell it."""
    p, n = template.at(s)
    shown = np.flatnonzero(image.visible(p, VISIBLE_M))
    p, n = p[shown], n[shown]
    guessed = np.zeros(len(p), bool) if template.guessed is None else shown >= template.guessed
    index = _looked_up(view, p)
    matched = index >= 0
    agree = np.zeros(len(p), bool)
    agree[matched] = np.einsum("ij,ij->i", view.normals[index[matched]], n[matched]) > 0.8
    matched &= agree
    r = np.zeros(len(p))
    r[matched] = np.einsum("ij,ij->i", n[matched], view.points[index[matched]] - p[matched])
    velocity = template.velocity(p)
    lever = np.einsum("ij,ij->i", n, velocity)
    tells = np.abs(lever) > LEAST_FACING * (1.0 if template.slides else 0.3 * template.reach_m)
    return _Fit(p, r, lever, tells, matched & (np.abs(r) < GATE_M) & tells, guessed)


def _looked_up(view: DepthView, p: np.ndarray) -> np.ndarray:
    """Index of the view's point at the pixel of each of the points (n, 3), or -1; shape (n,)."""
    p_C = p @ view.X_camera_base[:3, :3].T + view.X_camera_base[:3, 3]
    z = p_C[:, 2]
    safe = np.where(z > 0.05, z, 1.0)
    u = np.round(view.K[0, 0] * p_C[:, 0] / safe + view.K[0, 2]).astype(int)
    v = np.round(view.K[1, 1] * p_C[:, 1] / safe + view.K[1, 2]).astype(int)
    h, w = view.shape
    inside = (u >= 0) & (u < w) & (v >= 0) & (v < h) & (z > 0.05)
    index = np.full(len(p), -1, dtype=np.int64)
    index[inside] = view.index_of_pixel[v[inside] * w + u[inside]]
    return index
