"""A plan as the executor sees it, and the refusal that names what is wrong with one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from s2r_protocol.exits import RefusedError
from s2r_protocol.faults import Refusal


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """A timed quintic spline as it came from the host, not yet checked.

    Attributes:
        joint_names: In the sender's order.
        t: Knot times [s], shape (n,).
        q: Positions [rad], shape (n, dof).
        dq: Velocities [rad/s], shape (n, dof).
        ddq: Accelerations [rad/s²], shape (n, dof).
        parent_seq: Plan to splice into; 0 = start from hold.
        splice_t: Plan time of the parent at which this one begins [s].
        payload_mass: At the tool frame [kg].
        payload_com: Its centre of mass in the tool frame [m].
        path_tolerance: Largest following error [rad], also while its end is held; 0 = the executor's default.
        goal_tolerance: At the end [rad]; 0 = the executor's default.
        label: Free text for recordings.
    """

    joint_names: tuple[str, ...]
    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    parent_seq: int = 0
    splice_t: float = 0.0
    payload_mass: float = 0.0
    payload_com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    path_tolerance: float = 0.0
    goal_tolerance: float = 0.0
    label: str = ""


@dataclass(frozen=True, eq=False)
class AdmittedPlan:
    """A plan that passed every check, with what the core needs to stop on it.

    Attributes:
        t, q, dq, ddq: Knots as they will be played: the request's, except that the first one is the reference itself.
        stop_duration: Duration of the on-path stop that begins in each segment [s], shape (n - 1,).
        path_tolerance, goal_tolerance: [rad].
        tau_rest, tau_move: Torque standing still at each knot and passing it as planned [N·m], shape (n, dof).
        margins: Largest share of each limit in use, e.g. ``{"velocity": 0.42}``; 1 is the limit.
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    stop_duration: np.ndarray
    path_tolerance: float
    goal_tolerance: float
    tau_rest: np.ndarray
    tau_move: np.ndarray
    margins: dict[str, float] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        """Planned duration."""
        return float(self.t[-1])


class CommandRefusedError(RefusedError):
    """A command was refused at the door; carries everything a verdict says.

    Attributes:
        code: Why, in one word.
        joint: Joint concerned, or empty.
        t: Plan time [s] concerned.
        quantity: "velocity", "torque", ...; empty if none.
        value, limit: In the quantity's unit.
    """

    def __init__(
        self,
        code: Refusal,
        text: str,
        joint: str = "",
        t: float = 0.0,
        quantity: str = "",
        value: float = 0.0,
        limit: float = 0.0,
    ) -> None:
        super().__init__(text)
        self.code = code
        self.joint = joint
        self.t = t
        self.quantity = quantity
        self.value = value
        self.limit = limit
