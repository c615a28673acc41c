"""Dry friction with which a part stays where it is put, whatever it weighs; for objects that tell none."""

from __future__ import annotations

import mujoco
import numpy as np

LEAST = 0.5  # [N·m or N]
MARGIN = 1.3  # over what weight asks for where it pulls most; a laptop's hinge has 1.15 to 2.2


def holding_friction(body: mujoco.MjsBody, anchor: np.ndarray, axis: np.ndarray, slides: bool) -> float:
    """Dry friction of a joint [N·m or N].

    Args:
        body: Weighed, see :func:`s2r_sim.objects.weight.weigh`; gravity is along its -z at joint value 0.
        anchor, axis: Point on the joint's axis and unit vector, in the body's frame, (3,).
        slides: Whether it slides along the axis, or turns about it.
    """
    weight_N = np.array([0.0, 0.0, -9.81 * body.mass])
    if slides:
        pull = abs(float(weight_N @ axis))
    else:  # while it turns, the lever of its weight meets all directions across the axis
        lever, across = (v - (v @ axis) * axis for v in (np.asarray(body.ipos) - anchor, weight_N))
        pull = float(np.linalg.norm(lever) * np.linalg.norm(across))
    return max(LEAST, MARGIN * pull)
