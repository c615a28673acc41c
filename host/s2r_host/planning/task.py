"""What the planner is asked and what it answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from s2r_host.errors import HostError
from s2r_host.object_names import JOINT
from s2r_host.planning.hook import Hook
from s2r_host.planning.settings import PlanSettings
from s2r_protocol.arms import ArmDescription
from s2r_protocol.exits import RefusedError


class PlanRefusedError(HostError, RefusedError):
    """A request that cannot be planned; the text says in one sentence why."""


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """Move one joint of an object to a value with the arm.

    Attributes:
        arm: The arm; its base is the world frame.
        object_mjcf: MJCF file of the object in that frame, standing on the table z = 0.
        in_scene: That file is a whole scene instead, with the arm or an ``arm_base`` for it; nothing is added.
        s_initial: The object's joint now [m or rad].
        s_target: Where it shall end [m or rad].
        q_initial: The arm's joints now [rad], (dof,), at rest.
        joint: Name of the object's joint.
        seed: Of all chance in the plan; same request and seed, same plan.
        settings: See PlanSettings.
        others: Positions of everything in the scene besides the arm at the start, (nq - dof,); s counts where they
            differ. None: as the file has them.
        leave: The fingertip has to be able to let go of the part at the target, because the arm goes elsewhere then.
    """

    arm: ArmDescription
    object_mjcf: str | Path
    s_initial: float
    s_target: float
    q_initial: np.ndarray
    joint: str = JOINT
    seed: int = 0
    in_scene: bool = False
    settings: PlanSettings = field(default_factory=PlanSettings)
    others: np.ndarray | None = None
    leave: bool = False


@dataclass(frozen=True, eq=False)
class StepTrace:
    """One control step, for the report.

    Attributes:
        stage: Index in the cascade.
        step: Control step within the stage, from 0.
        s: The object's joint after the step, in the fine model.
        distance_m: Fingertip to its point on the part after the step.
        predicted: Mean reward of the executed sequence in the coarse model.
        rank: Which of the ranked sequences was executed; above 0, better ones touched something unexpected.
        torque_share: Largest torque over its limit during the step.
        contact: Unexpected contact of this step, or None.
    """

    stage: int
    step: int
    s: float
    distance_m: float
    predicted: float
    rank: int
    torque_share: float
    contact: str | None


@dataclass(frozen=True, eq=False)
class PlanResult:
    """A plan that the fine model has executed and held, or the reason why there is none.

    Attributes:
        success: The plan may be delivered: on target, held, nothing unexpected touched. How much of
            the torque limits it takes is judged where it is timed (:func:`s2r_host.trajectory.deliver`).
        q_cmd: Joint targets at the control rate, from the start pose to the end of the hold, (T, dof) [rad].
        q_meas: Where the fine model's arm was at those times, (T, dof) [rad].
        s: The object's joint at those times, (T,).
        control_dt_s: Time between rows.
        s_initial, s_target: As requested.
        final: The object's joint at the end of the hold.
        error: ``s_target - final``.
        reason: One sentence; "held on target" for a success.
        touch_step: Row at which the fingertip first touched the part, or None.
        hold_step: Row at which the hold begins.
        stage: Stage of the cascade that delivered, or the last one tried.
        control_steps: Actions executed, over all stages tried.
        env_steps: Control steps simulated in rollouts, over all stages.
        cpu_s, wall_s: Time used, all threads and elapsed.
        places_cpu_s: Part of it that the search for places for the fingertip took.
        torque_share: Largest torque over its limit in the delivered plan.
        contact: What else than the fingertip on the part it touched, the first of it; None: nothing.
        hook: The place that the fingertip was sent to.
        p_part: The point on the part that the fingertip was sent to, part frame [m], (3,).
        route: Joint postures that the sampler was offered: on the way there, above that point, there, at the touch,
            and on with the part to the target, (m, dof) [rad].
        route_touch: Row of the route at which the fingertip meets the part.
        trace: One entry per executed action.
    """

    success: bool
    q_cmd: np.ndarray
    q_meas: np.ndarray
    s: np.ndarray
    control_dt_s: float
    s_initial: float
    s_target: float
    final: float
    error: float
    reason: str
    touch_step: int | None
    hold_step: int
    stage: int
    control_steps: int
    env_steps: int
    cpu_s: float
    wall_s: float
    places_cpu_s: float
    torque_share: float
    contact: str | None
    hook: Hook
    p_part: np.ndarray
    route: np.ndarray
    route_touch: int
    trace: tuple[StepTrace, ...]
