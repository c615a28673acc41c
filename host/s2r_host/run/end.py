"""How a manipulation leaves the part: pushed to the end by the fingertip, or gone on by itself.

The servos of the planner's model are springs: pushing with 10 N they stay a milliradian behind, and by how much depends
on a friction that is known to a third. A drive with an integral part gets to where it is sent. Where the fingertip
pushes to the end geometry alone says where the part stays then, and only where it does not the replay's word counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.nearest import nearest_to_tip
from s2r_host.motion.object_shapes import part_obstacles
from s2r_host.planning import PlanRequest
from s2r_host.run.belief import Belief
from s2r_host.run.contact import touch_at
from s2r_host.run.sure_part import at_an_edge
from s2r_host.run.task import Task
from s2r_host.trajectory import Delivery

TOUCHING_M = 3e-4  # the fingertip this near to the part touches it


@dataclass(frozen=True, eq=False)
class End:
    """How the fingertip leaves the part at the end of a manipulation.

    Attributes:
        geom: What it presses on.
        p_pushed: And where, in the part's frame (joint value 0), (3,) [m].
        yields: How much less far the model's arm, whose servos give way under the contact, moved the part than one that
            gets to where it is sent [m or rad].
        touching: Part and fingertip touch at the end; else the part went on by itself.
        at_edge: It pushes last where the part was cut back: the real edge lies beyond, and the part goes further.
    """

    geom: str
    p_pushed: np.ndarray
    yields: float
    touching: bool
    at_edge: bool = False


def end_of(
    arm: ArmModel, belief: Belief, request: PlanRequest, delivery: Delivery, yields: float, task: Task
) -> End:
    """How the fingertip leaves the part.

    Args:
        arm: Its fingertip.
        belief: In the object.
        request: The object file, and which way the part is pushed.
        delivery: The motion and its replay.
        yields: How much the model's servos give way by where fingertip and part do not touch at the end [m or rad].
        task: Kind of object.
    """
    played, path, growing = delivery.replay, Path(request.object_mjcf), request.s_target > request.s_initial
    part = part_obstacles(path)
    if nearest_to_tip(arm, played.q_meas[-1], part(played.final)).distance_m < TOUCHING_M:
        around, q_end = played.final + yields, delivery.trajectory.q[-1]
        touched = touch_at(path, arm, q_end, around, growing, task.far_off)
        if touched is not None:
            p = belief.carry(touched.p, touched.s, 0.0)
            edge = at_an_edge(p, belief.within)
            return End(touched.geom, p, touched.s - played.final, touching=True, at_edge=edge)
    moving = np.flatnonzero(np.abs(np.diff(played.s)) > task.moving)
    row = int(moving[-1]) if len(moving) else len(played.s) - 1
    s = float(played.s[row])
    nearest = nearest_to_tip(arm, played.q_meas[row], part(s))
    p = belief.carry(nearest.p, s, 0.0)
    return End(nearest.name, p, yields, touching=False, at_edge=at_an_edge(p, belief.within))
