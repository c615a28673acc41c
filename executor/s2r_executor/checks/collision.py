"""Self-collision and keep-out zones along a plan, without gaps between the checked poses.

All shapes are inflated by r, with round edges and corners, so that two of them touch where the true ones are 2 r apart,
whichever way they are turned. Poses are spaced so that no point of the arm moves more than 2 r between two of them,
measured by an upper bound (joint speed times the largest possible lever arm). Every pose in between is then within r of
a checked one, so that what the inflated shapes do not touch there, the true shapes do not touch anywhere.
"""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from s2r_executor.config import AdmissionConfig
from s2r_executor.plan import CommandRefusedError
from s2r_executor.quintic import Samples, Spline, sample
from s2r_protocol.arms import ArmDescription
from s2r_protocol.arms.source import Box, Rod
from s2r_protocol.faults import Refusal

_TABLE = "table"
_AT_ONCE = 256
"""Poses per call: Pinocchio lets no other thread run meanwhile, and beats and heartbeats must come through."""


class CollisionModel:
    """Inflated capsules and boxes of one arm, the table and the keep-out boxes. Not thread-safe."""

    def __init__(self, arm: ArmDescription, config: AdmissionConfig) -> None:
        self._arm = arm
        self._inflation_m = config.collision_inflation_m
        self._model = pin.buildModelFromXML(arm.urdf)
        self._geometry = pin.GeometryModel()
        self._link_of: list[str] = []
        self._shape_names: list[str] = []
        for shape in arm.source.shapes:
            self._add_shape(shape)
        arm_shapes = len(self._link_of)
        self._pair_links(arm_shapes)
        self._add_surroundings(arm_shapes, config)
        self._data = self._model.createData()
        self._geometry_data = self._geometry.createData()
        self._pool = pin.GeometryPool(self._model, self._geometry, 1)
        self.lever_m = _lever_arms(arm)

    def _add(
        self, name: str, link: str, joint: int, placement: pin.SE3, shape: coal.CollisionGeometry
    ) -> int:
        self._link_of.append(link)
        self._shape_names.append(name)
        return self._geometry.addGeometryObject(pin.GeometryObject(name, joint, placement, shape))

    def _add_shape(self, shape: Rod | Box) -> None:
        frame = self._model.frames[self._model.getFrameId(shape.link, pin.FrameType.BODY)]
        if isinstance(shape, Box):
            geometry: coal.CollisionGeometry = coal.Box(*(2 * h for h in shape.half))
            local = pin.SE3(np.eye(3), np.array(shape.center))
        else:
            a, b = np.array(shape.a), np.array(shape.b)
            length = float(np.linalg.norm(b - a))
            geometry = (coal.Capsule if shape.type == "capsule" else coal.Cylinder)(shape.radius, length)
            local = pin.SE3(_rotation_of_z_to((b - a) / length), (a + b) / 2)
        geometry.setSweptSphereRadius(self._inflation_m)
        self._add(shape.name, shape.link, frame.parentJoint, frame.placement * local, geometry)

    def _pair_links(self, count: int) -> None:
        excluded = {frozenset(pair) for pair in self._arm.collision_exclude}
        for i in range(count):
            for j in range(i):
                links = frozenset((self._link_of[i], self._link_of[j]))
                if len(links) == 2 and links not in excluded:
                    self._geometry.addCollisionPair(pin.CollisionPair(j, i))

    def _add_surroundings(self, arm_shapes: int, config: AdmissionConfig) -> None:
        """The base stands on the table and the keep-out boxes do not move: only moving links are paired with them."""
        source = self._arm.source
        moving = [i for i in range(arm_shapes) if self._link_of[i] not in source.standing]
        up = np.array([0.0, 0.0, 1.0])
        if config.table_z_m is not None:
            hand = [i for i in moving if self._link_of[i] in source.hand]
            rest = [i for i in moving if i not in hand]
            for name, group, z in (
                (_TABLE, rest, config.table_z_m),
                (f"{_TABLE} (hand)", hand, config.table_z_m - config.fingertip_table_margin_m),
            ):
                plane = self._add(name, _TABLE, 0, pin.SE3.Identity(), coal.Halfspace(up, z))
                for i in group:
                    self._geometry.addCollisionPair(pin.CollisionPair(i, plane))
        for zone in config.keep_out:
            lower, upper = np.array(zone.lower_m), np.array(zone.upper_m)
            shape = coal.Box(*(upper - lower))
            shape.setSweptSphereRadius(self._inflation_m)
            box = self._add(zone.name, zone.name, 0, pin.SE3(np.eye(3), (lower + upper) / 2), shape)
            for i in moving:
                self._geometry.addCollisionPair(pin.CollisionPair(i, box))

    def check(self, spline: Spline, samples: Samples) -> None:
        """Refuse the first pose along the spline that touches.

        Args:
            spline: The plan.
            samples: A dense grid over it, used to find how far the arm moves.
        """
        t = self.sample_times(samples)
        q = sample(spline, t).q
        for first in range(0, len(q), _AT_ONCE):
            part = q[first : first + _AT_ONCE]
            hits = pin.computeCollisionsInParallel(1, self._pool, np.asfortranarray(part.T), True)
            touching = np.nonzero(np.asarray(hits))[0]
            if len(touching):
                raise self._refusal(part[touching[0]], float(t[first + touching[0]]))

    def sample_times(self, samples: Samples) -> np.ndarray:
        """Times [s] between which no point of the arm moves more than twice the inflation."""
        speed = np.abs(samples.dq) @ self.lever_m
        # The larger end value of each interval: a lower speed in between only makes the spacing finer than needed.
        step = np.maximum(speed[:-1], speed[1:]) * np.diff(samples.t)
        path_m = np.concatenate([[0.0], np.cumsum(step)])
        count = max(2, int(np.ceil(path_m[-1] / (2 * self._inflation_m))) + 1)
        strictly = path_m + np.linspace(
            0.0, 1e-9, len(path_m)
        )  # stand-still would make the inverse ambiguous
        return np.interp(np.linspace(0.0, strictly[-1], count), strictly, samples.t)

    def _refusal(self, q: np.ndarray, t: float) -> CommandRefusedError:
        pin.computeCollisions(self._model, self._data, self._geometry, self._geometry_data, q, False)
        for index in range(len(self._geometry.collisionPairs)):
            if self._geometry_data.collisionResults[index].isCollision():
                return self._too_near(index, t)
        return CommandRefusedError(
            Refusal.COLLISION, f"the arm touches something at {t:.3f} s; plan around it", t=t
        )

    def _too_near(self, index: int, t: float) -> CommandRefusedError:
        """The refusal for a pair that touches with its inflation, with what is left between the two without."""
        pair = self._geometry.collisionPairs[index]
        first, second = self._shape_names[pair.first], self._shape_names[pair.second]
        shapes = (self._geometry.geometryObjects[i].geometry for i in (pair.first, pair.second))
        needed_m = self._inflation_m * sum(not isinstance(shape, coal.Halfspace) for shape in shapes)
        between = pin.computeDistance(self._geometry, self._geometry_data, index).min_distance
        distance_m = needed_m + min(0.0, float(between))
        apart = (
            f"comes within {1e3 * distance_m:.1f} mm of"
            if distance_m > 0.0
            else f"goes {-1e3 * distance_m:.1f} mm into"
        )
        return CommandRefusedError(
            Refusal.COLLISION,
            f"'{first}' {apart} '{second}' at {t:.3f} s, {1e3 * needed_m:g} mm must be between them; plan around it",
            t=t,
            quantity=f"{first} - {second}",
            value=distance_m,
            limit=needed_m,
        )


def _rotation_of_z_to(direction: np.ndarray) -> np.ndarray:
    return pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction).toRotationMatrix()


def _lever_arms(arm: ArmDescription) -> np.ndarray:
    """Per joint the largest distance of any later point of the arm from its axis, in any pose [m], shape (dof,)."""
    source = arm.source
    reach = {
        link.name: max((_extent(s) for s in source.shapes_of(link.name)), default=0.0)
        for link in source.links
    }
    for connection in (*reversed(source.mounts), *reversed(source.joints)):
        beyond = float(np.linalg.norm(connection.origin)) + reach[connection.child]
        reach[connection.parent] = max(reach[connection.parent], beyond)
    return np.array([reach[joint.child] for joint in source.joints])


def _extent(shape: Rod | Box) -> float:
    """Largest distance of a shape's point from its link's origin [m]."""
    if isinstance(shape, Box):
        return float(np.linalg.norm(np.abs(shape.center) + np.array(shape.half)))
    ends = max(float(np.linalg.norm(shape.a)), float(np.linalg.norm(shape.b)))
    return ends + shape.radius * (1.0 if shape.type == "capsule" else 1.5)
