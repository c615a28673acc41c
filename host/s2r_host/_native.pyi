"""
What is slow in Python: rewards of rollouts, and motors with a link behind a spring or play.
"""

from collections.abc import Sequence

import numpy
from numpy.typing import NDArray

class Task:
    """
    What the reward compares with: start, goal and success band of the object's joint [m or rad], and its kind.
    """

    def __init__(self, s_initial: float, s_target: float, tolerance: float, prismatic: bool) -> None: ...
    @property
    def s_initial(self) -> float: ...
    @property
    def s_target(self) -> float: ...
    @property
    def tolerance(self) -> float: ...
    @property
    def prismatic(self) -> bool: ...

class RewardWeights:
    """s2r_host.planning.settings.RewardWeights, as the native code has it."""

    def __init__(
        self,
        *,
        distance: float,
        distance_width_m: float,
        turn_m: float,
        target: float,
        success: float,
        contact: float,
        contact_after: float,
        collision: float,
        speed: float,
        acceleration: float,
        calm: float,
        press: float,
        press_free_N: float,
        load: float,
        load_free: float,
        joints: Sequence[float],
    ) -> None: ...

def r_dist(distance_m: float, turn_rad: float, weights: RewardWeights) -> float:
    """Distance term."""

def remaining(s: float, task: Task) -> float:
    """Share of the way that remains."""

def r_target(s: float, task: Task, weights: RewardWeights) -> float:
    """Approach term."""

def r_success(s: float, task: Task, weights: RewardWeights) -> float:
    """Success term."""

def r_contact(s: float, touches: bool, collides: bool, task: Task, weights: RewardWeights) -> float:
    """Contact term."""

def r_reg(dq: Sequence[float], ddq: Sequence[float], weights: RewardWeights) -> float:
    """Regularisation."""

def r_calm(ds: float, task: Task, weights: RewardWeights) -> float:
    """Speed term of the object."""

def r_press(press_N: float, weights: RewardWeights) -> float:
    """Press term."""

def r_load(load: Sequence[float], weights: RewardWeights) -> float:
    """Load term."""

class Place:
    """
    A place for the fingertip, as rollouts are judged by; see s2r_host.planning.hook.
    """

    def __init__(
        self,
        *,
        p: Sequence[float],
        push_m: float,
        axes: Sequence[Sequence[float]],
        push_along: Sequence[Sequence[float]],
        grips: Sequence[Sequence[float]],
        s_start: float,
        follow: float,
        funnel_m: float,
        funnel_slope: float,
    ) -> None: ...
    def distances(self, p_tip_part: NDArray[numpy.float64]) -> NDArray[numpy.float64]:
        """Of tool tips in the part's frame (n, 3) [m], (n,)."""

    def turn(self, tool_wxyz: Sequence[float], s: float) -> float:
        """
        Angle [rad] between an orientation in the part's frame and the one wanted with the joint at s.
        """

class Scorer:
    """Judges rollouts of the coarse model, for one place of the fingertip."""

    def __init__(
        self,
        *,
        place: Place,
        weights: RewardWeights,
        s_qpos: int,
        s_dof: int,
        substeps: int,
        control_dt_s: float,
        stiffness: Sequence[float],
        damping: Sequence[float],
        R_world_part: Sequence[Sequence[float]],
    ) -> None: ...
    def values(
        self,
        qpos: NDArray[numpy.float64],
        qvel: NDArray[numpy.float64],
        sensors: NDArray[numpy.float64],
        targets: NDArray[numpy.float64],
        dq_start: NDArray[numpy.float64],
        task: Task,
    ) -> NDArray[numpy.float64]:
        """
        Mean reward of every rollout, (rollout,), from records (rollout, row, number) with a row per substep,
        joint targets (rollout, step + 1, dof) and the joint speeds at the start (at least dof).
        """

    def facts(
        self,
        qpos: NDArray[numpy.float64],
        qvel: NDArray[numpy.float64],
        sensors: NDArray[numpy.float64],
        targets: NDArray[numpy.float64],
        dq_start: NDArray[numpy.float64],
    ) -> dict:
        """
        What the reward is made of, by name, (rollout, step) or (rollout, step, dof).
        """

def hanging_link(
    *,
    dt: float,
    steps: NDArray[numpy.float64],
    load: NDArray[numpy.float64],
    bend: NDArray[numpy.float64],
    stiffness: float,
    damping: float,
) -> NDArray[numpy.float64]:
    """
    Effort that reaches a link behind a spring, (rows,); see s2r_host.gap.motion.two_masses.
    """

def held_slip(step: NDArray[numpy.float64]) -> NDArray[numpy.float64]:
    """
    Slip in [-1, 1] held at its ends, (rows,); see s2r_host.gap.motion.states.
    """

def hysteresis_loop(
    step: NDArray[numpy.float64], *, width: float, power: float, beta: float
) -> NDArray[numpy.float64]:
    """
    State of a hysteresis loop along the steps, (rows,); see s2r_host.gap.motion.states.
    """

def forward_backward(
    *, x: NDArray[numpy.float64], sections: NDArray[numpy.float64], start: NDArray[numpy.float64], pad: int
) -> NDArray[numpy.float64]:
    """
    Second-order sections forward and backward over the rows, (rows, columns); see s2r_host.gap.motion.filters.
    """

def behind_recorded_motor(
    *,
    dt: float,
    inertia: NDArray[numpy.float64],
    load: NDArray[numpy.float64],
    slope: NDArray[numpy.float64],
    bend: NDArray[numpy.float64],
    stiffness: float,
    damping: float,
    gap: float,
    phase: float,
) -> NDArray[numpy.float64]:
    """
    Effort that reaches a link behind a motor that moves as recorded, (rows,); see s2r_host.gap.motion.states.
    """

def under_servo(
    *,
    dt: float,
    inertia: NDArray[numpy.float64],
    load: NDArray[numpy.float64],
    slope: NDArray[numpy.float64],
    bend: NDArray[numpy.float64],
    stiffness: float,
    damping: float,
    gap: float,
    q: NDArray[numpy.float64],
    speed: float,
    motor_inertia: float,
    motor_damping: float,
    friction: float,
    kp: float,
    kd: float,
    ki: float,
    low: float,
    high: float,
    ticks: int,
    q_cmd: NDArray[numpy.float64],
    dq_cmd: NDArray[numpy.float64],
    ahead: NDArray[numpy.float64],
    integral: float,
    follow: float,
    reads_link: bool,
    phase: float,
) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64], NDArray[numpy.float64]]:
    """
    Position at the encoder of a motor under its servo, the effort that moves it and its link, and its speed,
    (rows,) each; see s2r_host.gap.motion.two_masses.
    """
