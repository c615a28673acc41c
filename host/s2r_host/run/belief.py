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
UNSEEN_MARGIN_M = 0.005


@dataclass(frozen=True, eq=False)
class Belief:
    """The object as the planner will see it.

    Attributes:
        estimate: The joint, its direction out of the cabinet.
        model: Built from it; joint value 0 is view A, + is out.
        template: The part's surface, for measuring.
        mjcf_path: The object as believed: the built model, or one corrected by :func:`corrected`.
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

    The belief differs from the built model in one face: the front's back, which no camera saw, is put 5 mm further
    in. A plan that hooks the front's upper edge must not count on millimetres nobody measured.

    Raises:
        ModelError: The views do not show enough of the object.
    """
    model = build_model(estimate, folder, outward=True, seed=seed)
    template = part_template(estimate, estimate.axis_direction, estimate.delta)
    belief = Belief(estimate, model, template, model.mjcf_path, {})
    if model.drawer is None:
        return belief
    return _with_face(belief, "part_front", -UNSEEN_MARGIN_M, folder / "believed.xml", inner=True)


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
    changed = _with_face(belief, geom, -offset_m, folder / "object.xml", inner=pushed_out)
    return replace(changed, shifts_m={**belief.shifts_m, geom: belief.shifts_m.get(geom, 0.0) - offset_m})


def _with_face(belief: Belief, name: str, shift_m: float, path: Path, inner: bool) -> Belief:
    """The belief with one face of a geom shifted along the axis by ``shift_m`` (+ = out); a hull shifts whole."""
    tree = ET.parse(belief.mjcf_path)
    geom = tree.find(f".//geom[@name='{name}']")
    if geom is None:
        raise SceneError(f"object model {belief.mjcf_path} has no geom '{name}' to correct")
    move = shift_m * belief.axis
    if geom.get("type") == "box":
        size = _numbers(geom, "size")
        R = Rotation.from_quat(_numbers(geom, "quat"), scalar_first=True).as_matrix()
        along = int(np.argmax(np.abs(R.T @ belief.axis)))
        half = max(size[along] + (-0.5 if inner else 0.5) * shift_m, 0.5 * THINNEST_M)
        move = (half - size[along]) * (-belief.axis if inner else belief.axis)
        size[along] = half
        geom.set("size", _text(size))
    geom.set("pos", _text(_numbers(geom, "pos") + move))
    path.parent.mkdir(parents=True, exist_ok=True)
    tree.write(path, encoding="unicode")
    return replace(belief, mjcf_path=path)


def _text(values: np.ndarray) -> str:
    return " ".join(f"{value:.7g}" for value in values)


def _numbers(element: ET.Element, key: str) -> np.ndarray:
    default = {"pos": "0 0 0", "quat": "1 0 0 0", "size": "0 0 0"}[key]
    return np.array([float(v) for v in element.get(key, default).split()])
