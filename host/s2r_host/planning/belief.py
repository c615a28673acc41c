"""What is not known exactly about an object, and models of it that are all believable."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import mujoco.batch
import numpy as np

from s2r_host.planning.scene import GeomKind, Scene
from s2r_host.planning.settings import Doubt


@dataclass(frozen=True)
class Belief:
    """One believable object, as it differs from the object file.

    Attributes:
        shift_m: Displacement of the whole object in the world frame.
        friction: Factor on the friction between robot and object.
        damping: Factor on the viscous damping of the object's joint.
        joint_friction: Factor on the dry friction of the object's joint.
    """

    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    friction: float = 1.0
    damping: float = 1.0
    joint_friction: float = 1.0

    def applied(self, scene: Scene) -> Scene:
        """The scene with its fine model changed; the given one stays as it is."""
        model = copy.copy(scene.fine)
        body, sign = moved_body(scene)
        model.body_pos[body] += sign * np.array(self.shift_m)
        model.dof_damping[scene.s_dof] *= self.damping
        model.dof_frictionloss[scene.s_dof] *= self.joint_friction
        model.geom_friction[scene.geom_kind >= GeomKind.ROBOT, 0] *= self.friction
        return replace(scene, fine=model)


def draw_belief(doubt: Doubt, rng: np.random.Generator) -> Belief:
    """A believable object at random: shares uniform, place Gaussian."""
    return _belief_at(doubt, rng.uniform(-1.0, 1.0, 3), rng.normal(0.0, doubt.shift_sigma_m, 3))


def draw_ensemble(doubt: Doubt, count: int, rng: np.random.Generator) -> tuple[Belief, ...]:
    """The object file's object and ``count - 1`` others, in opposite pairs so that they are not one-sided."""
    found = [Belief()]
    while len(found) < count:
        shares, shift = rng.uniform(-1.0, 1.0, 3), rng.normal(0.0, doubt.shift_sigma_m, 3)
        found += [_belief_at(doubt, shares, shift), _belief_at(doubt, -shares, -shift)]
    return tuple(found[:count])


def _belief_at(doubt: Doubt, shares: np.ndarray, shift_m: np.ndarray) -> Belief:
    spread = np.array([doubt.friction, doubt.damping, doubt.joint_friction])
    x, y, z = shift_m.tolist()
    return Belief((x, y, z), *(1.0 + shares * spread).tolist())


def moved_body(scene: Scene) -> tuple[int, float]:
    """The body whose displacement moves the object against the arm, and the sign to move it with."""
    if scene.on_table:
        return int(scene.fine.body_rootid[scene.part_body]), 1.0
    # In a scene the object may consist of several trees: move the arm instead.
    return int(scene.fine.body(scene.arm.source.base).id), -1.0


def spread_over(batch: mujoco.batch.Batch, scene: Scene, beliefs: tuple[Belief, ...]) -> None:
    """Give simulation i of a batch of one of the scene's models the object ``beliefs[i % len(beliefs)]``."""
    member = np.arange(batch.nsim) % len(beliefs)
    body, sign = moved_body(scene)
    robot = np.flatnonzero(scene.geom_kind >= GeomKind.ROBOT)
    place, friction = batch.expand("body_pos"), batch.expand("geom_friction")
    damping, dry = batch.expand("dof_damping"), batch.expand("dof_frictionloss")
    place[:, body] += sign * np.array([b.shift_m for b in beliefs])[member]
    friction[:, robot, 0] *= np.array([b.friction for b in beliefs])[member, None]
    damping[:, scene.s_dof] *= np.array([b.damping for b in beliefs])[member]
    dry[:, scene.s_dof] *= np.array([b.joint_friction for b in beliefs])[member]
    batch.set_const()
