"""Objects a little different from the believed one, to find out whether a motion holds only by luck."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np

from s2r_host.planning.scene import GeomKind, Scene


@dataclass(frozen=True)
class Perturbation:
    """How the object differs from what is believed.

    Attributes:
        shift_m: Displacement of the whole object in the world frame.
        resistance: Factor on damping and dry friction of its joint.
        finger_friction: Friction coefficient between robot and object.
    """

    shift_m: tuple[float, float, float]
    resistance: float
    finger_friction: float

    def __str__(self) -> str:
        x, y, z = (f"{1e3 * v:+.0f}" for v in self.shift_m)
        return (
            f"object moved by ({x}, {y}, {z}) mm, joint resistance × {self.resistance:g}, "
            f"friction {self.finger_friction:g}"
        )

    def applied(self, scene: Scene) -> Scene:
        """The scene with its fine model changed; the given one stays as it is."""
        model = copy.copy(scene.fine)
        if scene.on_table:
            model.body_pos[model.body_rootid[scene.part_body]] += np.array(self.shift_m)
        else:  # in a scene the object may consist of several trees: move the arm instead
            model.body_pos[model.body(scene.arm.source.base).id] -= np.array(self.shift_m)
        model.dof_damping[scene.s_dof] *= self.resistance
        model.dof_frictionloss[scene.s_dof] *= self.resistance
        model.geom_friction[scene.geom_kind >= GeomKind.ROBOT, 0] = self.finger_friction
        return replace(scene, fine=model)


# Errors of calibration and perception are 1-2 mm; friction and damping are typed in, not measured.
# Little friction loses a part, much friction jams a fingertip on an edge: away from the robot both are tried.
PERTURBATIONS = (
    Perturbation((0.003, 0.0, 0.0), 0.5, 0.1),
    Perturbation((0.003, 0.0, 0.0), 1.5, 0.6),
    Perturbation((-0.003, 0.0, 0.0), 1.5, 0.6),
    Perturbation((0.0, 0.0, 0.003), 0.5, 0.6),
    Perturbation((0.0, 0.0, -0.003), 1.5, 0.1),
    Perturbation((0.0, 0.004, 0.0), 1.0, 0.6),
    Perturbation((0.0, -0.004, 0.0), 1.0, 0.6),
)
