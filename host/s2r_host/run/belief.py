"""What the run believes about the object: the joint, the model on disk, and what execution has taught since."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from s2r_host.errors import SceneError
from s2r_host.model.build import ObjectModel, build_model
from s2r_host.perception.estimate import JointEstimate, estimate_joint
from s2r_host.run.measure import PartTemplate, part_template
from s2r_host.run.observe import Observation

THINNEST_M = 0.004


@dataclass(frozen=True, eq=False)
class Belief:
    """The object as the planner will see it.

    Attributes:
        estimate: The joint, its direction out of the cabinet.
        model: Built from it; joint value 0 is view A, + is out.
        template: The part's surface, for measuring.
        mjcf_path: The file to plan with: the model's own, or one corrected by :func:`corrected`.
        shifts_m: Geom name -> how far along the axis it was shifted from the built model.
    """

    estimate: JointEstimate
    model: ObjectModel
    template: PartTemplate
    mjcf_path: Path
    shifts_m: dict[str, float]

    @property
    def axis(self) -> np.ndarray:
        """Unit vector out of the cabinet, base frame, shape (3,)."""
        return self.template.axis


def estimate_slide(before: Observation, after: Observation, outward: np.ndarray, seed: int) -> JointEstimate:
    """The joint of a drawer that was pushed, signed so that + is out of the cabinet.

    Args:
        before, after: Views A and B.
        outward: The front's normal, shape (3,).
        seed: Of the estimator.

    Raises:
        AbstainError: The views do not determine the joint.
        SceneError: The motion seen is not along the front's normal.
    """
    estimate = estimate_joint(
        before.capture.frame,
        after.capture.frame,
        ignore_mask_before=before.arm_mask,
        ignore_mask_after=after.arm_mask,
        joint_type="prismatic",
        seed=seed,
    )
    along = float(estimate.axis_direction @ outward)
    if abs(along) < 0.8:
        raise SceneError(
            f"what moved between the views went {np.degrees(np.arccos(abs(along))):.0f}° away from the front's normal; "
            "that is no drawer, or something else moved"
        )
    return estimate if along > 0.0 else estimate.reversed()


def build_belief(estimate: JointEstimate, folder: Path, seed: int) -> Belief:
    """Build the physics model of an estimated slide.

    Raises:
        ModelError: The views do not show enough of the object.
    """
    model = build_model(estimate, folder, outward=True, seed=seed)
    template = part_template(estimate, estimate.axis_direction, estimate.delta)
    return Belief(estimate, model, template, model.mjcf_path, {})


def corrected(belief: Belief, geom: str, offset_m: float, pushed_out: bool, folder: Path) -> Belief:
    """Move the surface that was pushed to where the outcome says it is.

    With the tip at the same place the model ended at s and the drawer at s + offset: the pushed surface lies
    ``offset`` further in along the axis than modelled. Of a box only the pushed face moves (a handle's inner face
    no camera saw; its outer face was seen); another shape moves as a whole.

    Args:
        belief: So far.
        geom: The geom the fingertip pressed on.
        offset_m: Measured minus modelled joint value at the end of the motion [m].
        pushed_out: The motion was out of the cabinet, so the pushed face looks inwards.
        folder: For the new file.
    """
    tree = ET.parse(belief.mjcf_path)
    found = tree.find(f".//geom[@name='{geom}']")
    if found is None:
        raise SceneError(f"object model {belief.mjcf_path} has no geom '{geom}' to correct")
    shift = -offset_m * belief.axis
    size = _numbers(found, "size")
    if found.get("type") == "box":
        R = Rotation.from_quat(_numbers(found, "quat"), scalar_first=True).as_matrix()
        along = int(np.argmax(np.abs(R.T @ belief.axis)))
        thicker_m = offset_m if pushed_out else -offset_m
        half = max(size[along] + 0.5 * thicker_m, THINNEST_M / 2)
        shift = (half - size[along]) * (-belief.axis if pushed_out else belief.axis)
        size[along] = half
        found.set("size", " ".join(f"{v:.7g}" for v in size))
    found.set("pos", " ".join(f"{v:.7g}" for v in _numbers(found, "pos") + shift))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "object.xml"
    tree.write(path, encoding="unicode")
    shifts = {**belief.shifts_m, geom: belief.shifts_m.get(geom, 0.0) - offset_m}
    return replace(belief, mjcf_path=path, shifts_m=shifts)


def _numbers(element: ET.Element, key: str) -> np.ndarray:
    default = {"pos": "0 0 0", "quat": "1 0 0 0", "size": "0 0 0"}[key]
    return np.array([float(v) for v in element.get(key, default).split()])
