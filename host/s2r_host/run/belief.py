"""What the run believes about the object: the joint, the models on disk, and what execution has taught since."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from s2r_host.errors import SceneError
from s2r_host.model.build import ObjectModel, build_model
from s2r_host.model.write import write_mjcf
from s2r_host.object_names import JOINT
from s2r_host.perception.estimate import JointEstimate, Region, estimate_joint
from s2r_host.perception.motion import JointMotion, Push
from s2r_host.perception.verdict import VAGUELY
from s2r_host.proprioception.object_numbers import ObjectNumbers
from s2r_host.run.measure import PartTemplate, part_template
from s2r_host.run.object_file import with_face, with_friction
from s2r_host.run.observe import Observation
from s2r_host.run.sure_part import HalfSpace, rims, sure_pieces, sure_within
from s2r_host.run.task import Task

UPRIGHT_AXIS = 0.5
LEAST_ALIGNED = 0.8  # cosine between the axis seen and the one the first view promised
LARGEST_M = 0.8  # an object's points are not further from their middle
AROUND_M = 0.1  # beyond the object's points, in which its part may have moved
USUAL_PLATE_M = 0.006
HOLDING = 1.25  # friction over the gravity that it holds
RANGE_SAMPLES = 41
SIDES = {True: "the side pushed to let it grow", False: "the side pushed to let it fall"}  # of a hinge's part
UNSEEN_MARGIN_M = 0.005


@dataclass(frozen=True, eq=False)
class Belief:
    """The object as the planner will see it.

    Attributes:
        estimate: The joint, signed as the task says.
        model: Built from it; joint value 0 is view A.
        template: The part's surface, for measuring.
        falling, growing: The object as believed for motions that let the joint fall or grow: the built model, corrected
            at the side of the part that such motions push, see :mod:`s2r_host.run.contact`.
        shifts: What was corrected -> how far along or about the axis it was moved from the built model [m or rad].
        within: Where a hinge's part is sure: it is believed to end there.
        moved: Surface and direction -> how the side that such motions push was moved by lessons about lost motion, see
            :mod:`s2r_host.run.lost_motion`.
        felt: Mass and friction of the part as the arm felt them; None before it felt anything.
        missed: Places for the fingertip in the part's frame [m] from which a push meant to let the joint grow (True) or
            fall moved nothing: things are not there as believed.
        proven: The same of pushes that moved it, and whose outcome taught where its surface is.
        braking: Lowest and highest factor on the dry friction at the next target, where a lesson about physics left
            out says them (:mod:`s2r_host.run.physics`).
    """

    estimate: JointEstimate
    model: ObjectModel
    template: PartTemplate
    falling: Path
    growing: Path
    shifts: dict[str, float]
    within: tuple[HalfSpace, ...] = ()
    moved: dict[str, np.ndarray] = field(default_factory=dict)
    felt: ObjectNumbers | None = None
    braking: tuple[float, float] | None = None
    missed: tuple[tuple[bool, tuple[float, float, float]], ...] = ()
    proven: tuple[tuple[bool, tuple[float, float, float]], ...] = ()

    def path(self, positive: bool) -> Path:
        """The object file for motions that let the joint grow (``positive``) or fall."""
        return self.growing if positive else self.falling

    def touched(self, positive: bool) -> bool:
        """Whether the side of a hinge's part that is pushed to let the joint grow or fall has been touched before."""
        return SIDES[positive] in self.shifts

    def missed_when(self, positive: bool) -> tuple[tuple[float, float, float], ...]:
        """The places from which a push that lets the joint grow or fall has moved nothing."""
        return tuple(place for grows, place in self.missed if grows == positive)

    def proven_when(self, positive: bool) -> tuple[tuple[float, float, float], ...]:
        """The places from which a push that lets the joint grow or fall has moved it."""
        return tuple(place for grows, place in self.proven if grows == positive)

    def with_proven(self, positive: bool, place: np.ndarray) -> Belief:
        """With one more of them, (3,) [m]."""
        x, y, z = (float(value) for value in place)
        return replace(self, proven=(*self.proven, (positive, (x, y, z))))

    def with_missed(self, positive: bool, place: np.ndarray) -> Belief:
        """With one more of them, (3,) [m]."""
        x, y, z = (float(value) for value in place)
        return replace(self, missed=(*self.missed, (positive, (x, y, z))))

    @property
    def axis(self) -> np.ndarray:
        """Unit vector along or about which the joint grows, base frame, shape (3,)."""
        return self.template.axis

    def direction_at(self, p: np.ndarray) -> np.ndarray:
        """Unit vector of the part's motion at a point (3,) when the joint grows, (3,)."""
        velocity = self.template.velocity(p[None])[0]
        return velocity / np.linalg.norm(velocity)

    def carried(self, s_from: float, s_to: float) -> np.ndarray:
        """X (4, 4) that carries what is fixed to the part from one joint value to another, base frame."""
        return self.template.pose(s_to) @ np.linalg.inv(self.template.pose(s_from))

    def carry(self, p: np.ndarray, s_from: float, s_to: float) -> np.ndarray:
        """Where a point (3,) that is fixed to the part goes from one joint value to another, base frame, (3,)."""
        X = self.carried(s_from, s_to)
        return X[:3, :3] @ p + X[:3, 3]


def estimate_part(
    before: Observation,
    after: Observation,
    task: Task,
    positive: np.ndarray | None,
    pushed: Sequence[Push],
    seed: int,
) -> JointEstimate:
    """The joint of a part that was pushed, signed so that it grows the way the task calls positive.

    However vague: what the run does next moves the part further, and the joint is told again from that.

    Args:
        before, after: Views A and B.
        task: What kind of joint is expected.
        positive: Unit vector along (slide) or about (hinge) which it grows, as far as the first view tells, (3,);
            None if it does not: then hinges grow counter-clockwise seen from above, level ones towards the arm.
        pushed: What was done between the views, as far as all of it is known.
        seed: Of the estimator.

    Raises:
        AbstainError: The views do not determine the joint.
        SceneError: The joint seen is not the expected one.
    """
    estimate = estimate_joint(
        before.capture.frame,
        after.capture.frame,
        region=_around(before, after),
        ignore_mask_before=before.arm_mask,
        ignore_mask_after=after.arm_mask,
        joint_type=task.joint_type,
        pushed=pushed,
        known_to=VAGUELY,
        seed=seed,
    )
    if positive is None:
        return grown_usually(estimate)
    along = float(estimate.axis_direction @ positive)
    if abs(along) < LEAST_ALIGNED:
        raise SceneError(
            f"the axis of what moved between the views is {np.degrees(np.arccos(abs(along))):.0f}° away from where "
            f"a {task.name} has it; that is no {task.name}, or something else moved"
        )
    return estimate if along > 0.0 else estimate.reversed()


def _around(before: Observation, after: Observation) -> Region:
    """The box about what both views took for the object; what changes elsewhere are ghosts on a far table."""
    p = np.concatenate([before.scene.p_base, after.scene.p_base])
    p = p[np.linalg.norm(p - np.median(p, axis=0), axis=1) < LARGEST_M]
    low, high = p.min(axis=0) - AROUND_M, p.max(axis=0) + AROUND_M
    return low[0], high[0], low[1], high[1], low[2], high[2]


def grown_usually(estimate: JointEstimate) -> JointEstimate:
    """A hinge that grows counter-clockwise from above; a level one so that its upper side moves to the arm (-x)."""
    axis = estimate.axis_direction
    usual = axis[2] > 0.0 if abs(axis[2]) > UPRIGHT_AXIS else axis[1] < 0.0
    return estimate if usual else estimate.reversed()


def build_belief(estimate: JointEstimate, folder: Path, seed: int) -> Belief:
    """Build the physics model of an estimated joint.

    The belief in a drawer differs from the built model in one face: the front's back, which no camera saw, is put
    5 mm further in. A plan that hooks the front's upper edge must not count on millimetres nobody measured.
    A hinge is believed to have enough dry friction to hold its part anywhere, and its part to end a little before
    where it was seen to end (:mod:`s2r_host.run.sure_part`).

    Raises:
        ModelError: The views do not show enough of the object.
    """
    model = build_model(estimate, folder, outward=True, seed=seed)
    template, path = part_template(estimate), model.mjcf_path
    within: tuple[HalfSpace, ...] = ()
    if not template.slides:
        template = template.with_back(_thickness_m(model))
        within = sure_within(model.pieces, estimate.motion)
        path = _held(model, estimate.motion, within, folder / "believed.xml")
    elif model.drawer is not None:
        path = with_face(
            path, "part_front", template.axis, -UNSEEN_MARGIN_M, folder / "believed.xml", inner=True
        )
    return Belief(estimate, model, template, path, path, {}, within)


def _thickness_m(model: ObjectModel) -> float:
    """Of the part's thinnest plate, as modelled [m]."""
    plates = [
        2.0 * float(np.min(p.half_size)) for p in model.pieces if p.body == "part" and p.half_size is not None
    ]
    return min(plates, default=USUAL_PLATE_M)


def _held(built: ObjectModel, hinge: JointMotion, within: Sequence[HalfSpace], path: Path) -> Path:
    """The object with at least the friction that keeps the part at rest anywhere in its range, its edges cut back.

    Mass is a guess from a guessed density. That the part stayed where both views found it is a fact, that it stays
    elsewhere, too, is what such hinges are made for: a lid that falls from half its way would be of no use.
    """
    model = mujoco.MjModel.from_xml_path(str(built.mjcf_path))
    believed = float(model.dof_frictionloss[model.joint(JOINT).dofadr[0]])
    sure = path.with_name("sure.xml")
    pieces = sure_pieces(built.pieces, within)
    write_mjcf(sure, pieces, hinge, built.range, built.physics, rims(built.pieces, pieces))
    friction = max(believed, holding_friction(built.mjcf_path, built.range))
    return with_friction(sure, JOINT, friction, path)


def holding_friction(mjcf: Path, span: tuple[float, float]) -> float:
    """Dry friction that holds the part against gravity everywhere between two joint values, and some more."""
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    data = mujoco.MjData(model)
    joint = model.joint(JOINT)
    needed = 0.0
    for s in np.linspace(*span, RANGE_SAMPLES):
        data.qpos[joint.qposadr[0]] = s
        mujoco.mj_forward(model, data)
        needed = max(needed, abs(float(data.qfrc_bias[joint.dofadr[0]])))
    return HOLDING * needed
