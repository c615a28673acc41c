"""What is asked of a home pose, and how far a pose keeps it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from s2r_host.motion.arm_model import ArmModel
from s2r_protocol.arms import ArmDescription
from s2r_protocol.arms.clearance import LINKS_APART_M
from s2r_protocol.arms.link_pairs import link_pairs

LIMIT_RAD = 0.15  # to the nearest limit; a tenth of a narrow range
LINKS_M = LINKS_APART_M + 0.002
TABLE_M = 0.03
TORQUE_SHARE = 0.6  # the rest is for moving
OFF_DOWN_RAD = 0.6
NEAR, ASIDE, HIGH = (0.2, 1.0), 0.6, (0.2, 1.3)  # of the distance at which objects stand
AGILITY = 0.03  # smallest singular value of the Jacobian, lengths as shares of the reach

_OBJECT_M = 0.6  # where the stand-in's objects stand, before the base
_OBJECT_OF_REACH = 0.75
_WAIT = (0.48, 0.2, 0.5)  # before, left of and above the base, of the distance at which objects stand
_LEFT, _ROOM, _TOP = 0.4, (0.75, 1.6), 0.55  # of that distance: half the width, from where to where, how high
_CAMERA_M, _LOOKS_AT_M, _VIEW_RADIUS_M = (0.02, -0.48, 0.56), (0.58, 0.0, 0.13), 0.1  # the stand-in's
_SAMPLES = 3000


@dataclass(frozen=True)
class Place:
    """Where objects stand before an arm and where its hand waits [m]."""

    object_m: float

    @property
    def p_wait(self) -> np.ndarray:
        """Where the fingertip waits in the base frame, shape (3,): before objects, on the left, as high as they are."""
        return self.object_m * np.array(_WAIT)


def place_of(arm: ArmModel, rng: np.random.Generator) -> Place:
    """Where the stand-in puts objects, or nearer by where the arm reaches less far forward."""
    q_low, q_high = turns(arm)
    tips = np.array([arm.tool_pose(q)[:3, 3] for q in rng.uniform(q_low, q_high, (_SAMPLES, len(q_low)))])
    farthest_m = float(np.linalg.norm(tips, axis=1).max())
    ahead = (tips[:, 2] > 0.0) & (tips[:, 2] < 0.5 * farthest_m) & (np.abs(tips[:, 1]) < 0.35 * tips[:, 0])
    reach_m = float(np.percentile(tips[ahead, 0], 98)) if ahead.any() else farthest_m
    return Place(min(_OBJECT_M, _OBJECT_OF_REACH * reach_m))


def turns(arm: ArmModel) -> tuple[np.ndarray, np.ndarray]:
    """The range of every joint [rad], each (dof,), of at most one turn around zero, or around its middle."""
    middle = 0.5 * (arm.q_min + arm.q_max)
    low, high = np.minimum(arm.q_min, middle), np.maximum(arm.q_max, middle)
    wide = high - low > 2.0 * np.pi
    middle = np.where((low < -np.pi) & (high > np.pi), 0.0, middle)
    return np.where(wide, middle - np.pi, low), np.where(wide, middle + np.pi, high)


@dataclass(frozen=True, eq=False)
class Measured:
    """A pose as it was found.

    Attributes:
        q: The pose (dof,) [rad].
        p_tip: Of the fingertip in the base frame (3,) [m].
        off_down_rad: Between the tool's z axis and straight down.
        limit: The joint that is nearest to a limit, and how far it is [rad], as a share of what is asked.
        links: The nearest two links and the distance between them [m]; None where nothing is to be checked.
        lowest: The lowest shape and its height over the table [m]; None where only the first link moves.
        torque: The joint that holds the largest share of its torque, and that share.
        agility: Smallest singular value of the Jacobian, lengths as shares of the reach.
        room_m: How far the nearest shape is from where objects stand, negative inside.
        view_m: How far the nearest shape is from where the stand-in's camera looks, negative inside.
    """

    q: np.ndarray
    p_tip: np.ndarray
    off_down_rad: float
    limit: tuple[str, float, float]
    links: tuple[str, str, float] | None
    lowest: tuple[str, float] | None
    torque: tuple[str, float]
    agility: float
    room_m: float
    view_m: float

    def faults(self, place: Place) -> list[str]:
        """What the pose fails of what is asked, in words."""
        found = []
        ahead, left, high = self.p_tip / place.object_m
        if self.limit[2] < 1.0:
            found.append(f"joint '{self.limit[0]}' is {self.limit[1]:.2g} rad from a limit")
        if self.links is not None and self.links[2] < LINKS_M:
            found.append(
                f"links '{self.links[0]}' and '{self.links[1]}' are {1e3 * self.links[2]:.3g} mm apart, "
                f"{1e3 * LINKS_M:.0f} mm are asked for"
            )
        if self.lowest is not None and self.lowest[1] < TABLE_M:
            found.append(f"'{self.lowest[0]}' is {1e3 * self.lowest[1]:.3g} mm over the table")
        if self.torque[1] > TORQUE_SHARE:
            found.append(f"joint '{self.torque[0]}' holds {self.torque[1]:.0%} of its torque")
        if self.off_down_rad > OFF_DOWN_RAD:
            found.append(f"the hand points {np.degrees(self.off_down_rad):.0f}° off straight down")
        if not (NEAR[0] <= ahead <= NEAR[1] and abs(left) <= ASIDE and HIGH[0] <= high <= HIGH[1]):
            found.append(
                f"the fingertip is at {_point(self.p_tip)}, not between the base and objects {place.object_m:.2f} m "
                "before it"
            )
        if self.agility < AGILITY:
            found.append("the arm is nearly stretched or folded: in one direction its hand can hardly move")
        if self.room_m < 0.0:
            found.append("it reaches into where objects stand")
        return found

    def links_alone(self, place: Place) -> bool:
        """Whether two links that are too near to each other are all that is wrong."""
        return self.links is not None and self.links[2] < LINKS_M and len(self.faults(place)) == 1


class Gauge:
    """Measures poses of one arm."""

    def __init__(self, arm: ArmDescription, place: Place) -> None:
        self.arm, self.place = ArmModel(arm), place
        self._model, self._shapes, self._pairs = link_pairs(arm)
        self._first = arm.source.joints[0].child
        moving = [
            i
            for i, shape in enumerate(self._shapes.geometryObjects)
            if self._link(shape) not in arm.source.standing
        ]
        self._over = [i for i in moving if self._link(self._shapes.geometryObjects[i]) != self._first]
        far = place.object_m
        (near, end), width = _ROOM, 2 * _LEFT * far
        room = coal.Box((end - near) * far, width, _TOP * far)
        at = pin.SE3(np.eye(3), far * np.array([0.5 * (near + end), 0.0, 0.5 * _TOP]))
        table = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        self._around = [
            self._pair(name, solid, X, group)
            for name, solid, X, group in (
                ("table", table, pin.SE3.Identity(), self._over),
                ("room", room, at, moving),
                ("view", *_view(), moving),
            )
        ]
        self._data, self._found = self._model.createData(), self._shapes.createData()
        self._reach_m = max(float(self.arm.lever_m[0]), 1e-3)

    def _link(self, shape: pin.GeometryObject) -> str:
        return self._model.frames[shape.parentFrame].name

    def _pair(self, name: str, solid: coal.CollisionGeometry, X: pin.SE3, group: Iterable[int]) -> slice:
        """Pair shapes with something that stands; where their distances will be."""
        index = self._shapes.addGeometryObject(pin.GeometryObject(name, 0, 0, X, solid))
        start = len(self._shapes.collisionPairs)
        for i in group:
            self._shapes.addCollisionPair(pin.CollisionPair(i, index))
        return slice(start, len(self._shapes.collisionPairs))

    def jacobian(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pose (4, 4) of the fingertip and its Jacobian (6, dof), linear first, along the base's axes."""
        data = self.arm.data
        J = pin.computeFrameJacobian(
            self.arm.model, data, q, self.arm.tool_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        pin.updateFramePlacement(self.arm.model, data, self.arm.tool_id)
        return data.oMf[self.arm.tool_id].homogeneous, J

    def measure(self, q: np.ndarray) -> Measured:
        """Look at a pose (dof,) [rad]."""
        arm = self.arm.arm
        X, J = self.jacobian(q)
        pin.computeDistances(self._model, self._data, self._shapes, self._found, q)
        away = np.array([result.min_distance for result in self._found.distanceResults])
        table, room, view = (away[part] for part in self._around)
        limits = arm.limits
        to_limit = np.minimum(q - limits.q_min, limits.q_max - q)
        shares = to_limit / np.minimum(LIMIT_RAD, 0.1 * (limits.q_max - limits.q_min))
        torques = np.abs(pin.computeGeneralizedGravity(self._model, self._data, q)) / limits.tau_max
        tight, heavy = int(np.argmin(shares)), int(np.argmax(torques))
        nearest = int(np.argmin(away[: len(self._pairs)])) if self._pairs else -1
        low = int(np.argmin(table)) if len(table) else -1
        scaled = np.vstack([J[:3] / self._reach_m, J[3:]])
        return Measured(
            q=q,
            p_tip=X[:3, 3].copy(),
            off_down_rad=float(np.arctan2(np.linalg.norm(X[:2, 2]), -X[2, 2])),
            limit=(arm.joint_names[tight], float(to_limit[tight]), float(shares[tight])),
            links=(*self._pairs[nearest], float(away[nearest])) if self._pairs else None,
            lowest=(self._link(self._shapes.geometryObjects[self._over[low]]), float(table[low]))
            if low >= 0
            else None,
            torque=(arm.joint_names[heavy], float(torques[heavy])),
            agility=float(np.linalg.svd(scaled, compute_uv=False)[-1]),
            room_m=float(room.min(initial=np.inf)),
            view_m=float(view.min(initial=np.inf)),
        )


def _view() -> tuple[coal.Capsule, pin.SE3]:
    a, b = np.array(_CAMERA_M), np.array(_LOOKS_AT_M)
    length_m = float(np.linalg.norm(b - a))
    R = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (b - a) / length_m).toRotationMatrix()
    return coal.Capsule(_VIEW_RADIUS_M, length_m), pin.SE3(R, 0.5 * (a + b))


def _point(p: np.ndarray) -> str:
    return f"({', '.join(f'{v:.2f}' for v in p)}) m"
