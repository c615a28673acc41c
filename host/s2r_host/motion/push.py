"""From push proposals to joint paths: the first proposal whose every part is reachable and free."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import coal
import numpy as np
from scipy.spatial import cKDTree

from s2r_host.errors import NoMotionError
from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.cartesian import SPACING_M, straight_line
from s2r_host.motion.collision import Clearance, CollisionChecker
from s2r_host.motion.front import Front
from s2r_host.motion.inverse import InverseKinematics, seeds_around
from s2r_host.motion.joint_motion import plan_joint_motion
from s2r_host.motion.lid import Lid
from s2r_host.motion.obstacles import SHADOW_DEPTH_M, Obstacle, cloud_obstacle, table_obstacle
from s2r_host.motion.push_proposals import PushProposal
from s2r_host.motion.scene import Scene
from s2r_host.perception.motion import Push

PART = "pushed part"
FREE = Clearance()
# While pushing, the tip touches on purpose; the rest of the arm only must not reach the object.
PUSHING = Clearance(obstacle_m=0.006, table_m=0.008, tip_m=None)


@dataclass(frozen=True, eq=False)
class PushScene:
    """Obstacles of a push: what stays where it is, and the part that gives way along the push."""

    static: tuple[Obstacle, ...]
    part: Obstacle

    @property
    def all(self) -> tuple[Obstacle, ...]:
        """Everything, as found."""
        return (*self.static, self.part)

    def as_found_and_pushed(self, p_shift: np.ndarray) -> tuple[Obstacle, ...]:
        """Everything as found, and the part once more as far as a push takes it, or less: it may give way little."""
        X = self.part.X_base_shape.copy()
        X[:3, 3] += p_shift
        return (*self.all, replace(self.part, X_base_shape=X))


def push_scene(scene: Scene, front: Front) -> PushScene:
    """Split the observed points: what lies before or behind the front's outline moves, the rest stays."""
    moves = front.covers(scene.p_base)
    return PushScene(
        static=(table_obstacle(), cloud_obstacle(scene.p_base[~moves], scene.p_camera)),
        part=cloud_obstacle(scene.p_base[moves], scene.p_camera, name=PART),
    )


def piece_scene(
    scene: Scene, piece: np.ndarray, shadow_m: float = SHADOW_DEPTH_M, margin_m: float = 0.004
) -> PushScene:
    """A piece of the observed points, shape (m, 3), moves; the rest of them stays.

    Args:
        scene: All of them.
        piece: The piece [m].
        shadow_m: So deep behind what was seen unseen space counts as solid [m].
        margin_m: Points this near to the piece are of it.
    """
    moves = cKDTree(piece).query(scene.p_base, distance_upper_bound=margin_m)[0] <= margin_m
    return PushScene(
        static=(
            table_obstacle(),
            cloud_obstacle(scene.p_base[~moves], scene.p_camera, shadow_m=shadow_m),
        ),
        part=cloud_obstacle(piece, scene.p_camera, name=PART, shadow_m=shadow_m),
    )


def lid_scene(scene: Scene, lid: Lid, thickness_m: float) -> PushScene:
    """A lid as a plate; unlike behind other surfaces, the space behind it counts as free beyond its thickness."""
    X = np.eye(4)
    X[:3, :3] = np.column_stack([lid.along, lid.up, np.cross(lid.along, lid.up)])
    hidden = -0.5 if lid.outside_seen else 0.5  # the seen face is at the plane, the hidden one behind it
    X[:3, 3] = lid.p_hinge + 0.5 * lid.length_m * lid.up + hidden * thickness_m * lid.opening
    plate = coal.Box(lid.width_m, lid.length_m, thickness_m)
    rest = scene.p_base[~lid.covers(scene.p_base, margin_m=0.02)]
    return PushScene(
        static=(table_obstacle(), cloud_obstacle(rest, scene.p_camera)), part=Obstacle(PART, plate, X)
    )


@dataclass(frozen=True, eq=False)
class PushMotion:
    """Joint paths of one push, each of shape (n, dof): there, the push itself, back out, home.

    Attributes:
        approach: From the start posture to the stand-off.
        push: From the stand-off straight to the end of the push.
        retreat: Straight back to the stand-off.
        home: From the stand-off to the posture given as home.
        proposal: What it realises.
        tried: How many proposals were looked at.
        reasons: Why the earlier ones fell out, counted.
    """

    approach: np.ndarray
    push: np.ndarray
    retreat: np.ndarray
    home: np.ndarray
    proposal: PushProposal
    tried: int
    reasons: dict[str, int]

    @property
    def push_at_part(self) -> Push:
        """Where and which way the part is pushed."""
        return Push(self.proposal.p_contact, self.proposal.direction)


def plan_push(
    arm: ArmModel,
    scene: PushScene,
    proposals: Iterable[PushProposal],
    q_start: np.ndarray,
    q_home: np.ndarray,
    rng: np.random.Generator,
    max_tried: int = 500,
) -> PushMotion:
    """The first proposal with an approach, a straight push and a way home.

    Raises:
        NoMotionError: None of them; the text counts why.
    """
    free = CollisionChecker(arm, scene.all, FREE)
    pushing = CollisionChecker(arm, scene.all, PUSHING)
    ik = InverseKinematics(arm)
    seeds = seeds_around(arm, q_home, rng, count=4)
    reasons: dict[str, int] = {}
    tried = 0
    for proposal in proposals:
        if tried >= max_tried:
            break
        tried += 1
        if (reason := _hand_hits(free, pushing, proposal)) is not None:
            _count(reasons, reason)
            continue
        found = _realise(arm, ik, free, pushing, proposal, seeds, reasons)
        if found is None:
            continue
        push = found
        try:
            approach = plan_joint_motion(free, q_start, push[0], rng, what="approach")
            after = CollisionChecker(
                arm, scene.as_found_and_pushed(_way_of_part(proposal, proposal.p_end)), FREE
            )
            home = plan_joint_motion(after, push[0], q_home, rng, what="way home")
        except NoMotionError as error:
            _count(reasons, str(error))
            continue
        return PushMotion(approach, push, push[::-1].copy(), home, proposal, tried, reasons)
    if not tried:
        raise NoMotionError(
            "no push proposal is left: no point of the part qualifies, or all that do were tried; turn the object so "
            "that the camera sees more of the part, or move the part by hand to where it stands free"
        )
    counted = "; ".join(
        f"{count} × {reason}" for reason, count in sorted(reasons.items(), key=lambda kv: -kv[1])
    )
    raise NoMotionError(f"none of {tried} push proposals can be carried out ({counted}); {_advice(reasons)}")


def _advice(reasons: dict[str, int]) -> str:
    """What follows from why most proposals fell out."""
    blocked = sum(count for reason, count in reasons.items() if "not free" in reason)
    if 2 * blocked > sum(reasons.values()):
        return "make room for the hand at the part: what is in its way is named there"
    return "move the object closer to the middle of the arm's workspace"


def _hand_hits(free: CollisionChecker, pushing: CollisionChecker, proposal: PushProposal) -> str | None:
    """Why the hand alone has no room for a push: a hundred times quicker to see than with the arm behind it."""
    X = proposal.X_base_tool.copy()
    if (pair := free.hand_touching(X)) is not None:
        return f"stand-off not free ({pair})"
    p_start = X[:3, 3].copy()
    count = max(1, int(np.ceil(np.linalg.norm(proposal.p_end - p_start) / SPACING_M)))
    for k in range(1, count + 1):
        X[:3, 3] = p_start + (proposal.p_end - p_start) * k / count
        _give_way(pushing, proposal, X[:3, 3])
        if (pair := pushing.hand_touching(X)) is not None:
            return f"push not free ({pair})"
    return None


def _give_way(pushing: CollisionChecker, proposal: PushProposal, p_tip: np.ndarray) -> None:
    """The pushed part gives way as the tip advances."""
    pushing.place(PART, _way_of_part(proposal, p_tip))


def _way_of_part(proposal: PushProposal, p_tip: np.ndarray) -> np.ndarray:
    """How far a tip that has come to ``p_tip`` has taken the part [m]."""
    return max(0.0, float((p_tip - proposal.p_contact) @ proposal.direction)) * proposal.direction


def _realise(
    arm: ArmModel,
    ik: InverseKinematics,
    free: CollisionChecker,
    pushing: CollisionChecker,
    proposal: PushProposal,
    seeds: Sequence[np.ndarray],
    reasons: dict[str, int],
) -> np.ndarray | None:
    """The push as a joint path, or None with the reason counted."""
    for q in ik.solve_any(proposal.X_base_tool, seeds):
        if (pair := free.touching(q)) is not None:
            _count(reasons, f"stand-off not free ({pair})")
            continue
        path = straight_line(arm, ik, q, proposal.p_end)
        if path is None:
            _count(reasons, "straight push out of reach")
            continue
        if (pair := _first_hit(arm, pushing, proposal, path)) is not None:
            _count(reasons, f"push not free ({pair})")
            continue
        return path
    _count(reasons, "no posture reaches the stand-off or none was free")
    return None


def _first_hit(
    arm: ArmModel, pushing: CollisionChecker, proposal: PushProposal, path: np.ndarray
) -> str | None:
    """What the arm would touch during the push."""
    for q in path:
        _give_way(pushing, proposal, arm.tool_pose(q)[:3, 3])
        if (pair := pushing.touching(q)) is not None:
            return pair
    return None


def _count(reasons: dict[str, int], reason: str) -> None:
    reasons[reason] = reasons.get(reason, 0) + 1
