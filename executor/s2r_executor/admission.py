"""The whole plan is checked before anything moves. A refusal names joint, time, quantity, value and limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_executor.checks.bounds import check_bounds
from s2r_executor.checks.collision import CollisionModel
from s2r_executor.checks.dynamics import InverseDynamics, check_torque
from s2r_executor.checks.form import check_form, check_start
from s2r_executor.config import AdmissionConfig
from s2r_executor.plan import AdmittedPlan, CommandRefusedError, PlanRequest
from s2r_executor.quintic import sample, spline_through
from s2r_executor.stop_ramps import stop_durations
from s2r_protocol.arms import ArmDescription
from s2r_protocol.faults import Refusal


class Admission:
    """Checks plans for one arm. Keeps no state between plans; not thread-safe (scratch memory of the libraries)."""

    def __init__(
        self,
        arm: ArmDescription,
        config: AdmissionConfig,
        path_tolerance_rad: float,
        goal_tolerance_rad: float,
    ) -> None:
        self._arm = arm
        self._config = config
        self._path_tolerance_rad = path_tolerance_rad
        self._goal_tolerance_rad = goal_tolerance_rad
        self._dynamics = InverseDynamics(arm)
        self._collision = CollisionModel(arm, config)

    def admit(self, plan: PlanRequest, q_ref: np.ndarray) -> AdmittedPlan:
        """Check everything.

        Args:
            plan: As it came.
            q_ref: The reference the core holds [rad], shape (dof,).

        Raises:
            CommandRefusedError: At the first check that fails; its text is one sentence for the operator.
        """
        names, config, limits = self._arm.joint_names, self._config, self._arm.limits
        check_form(plan, names, config)
        if plan.parent_seq or plan.splice_t:
            raise CommandRefusedError(
                Refusal.SPLICE,
                f"splicing into running plan {plan.parent_seq} is not available; send the plan when the arm holds",
                quantity="parent_seq",
                value=plan.parent_seq,
            )
        check_start(plan, names, q_ref, config)
        plan = _from_reference(plan, q_ref)
        # Absurdly large numbers overflow to inf or NaN here; the checks refuse both, so no warning is needed.
        with np.errstate(over="ignore", invalid="ignore"):
            spline = spline_through(plan.t, plan.q, plan.dq, plan.ddq)
            margins = check_bounds(spline, limits, names)
        grid = sample(spline, _times(plan.t, config.sample_step_s))
        self._dynamics.carry(plan.payload_mass, plan.payload_com)
        tau = self._dynamics.torque(grid.q, grid.dq, grid.ddq)
        margins["torque"] = check_torque(grid, tau, limits.tau_max, config.torque_margin, names)
        self._collision.check(spline, grid)
        tau_limit = (1 - config.torque_margin) * limits.tau_max
        stops = stop_durations(
            spline, limits, self._dynamics.torque, names, tau_limit, config.stop_duration_max_s
        )
        return AdmittedPlan(
            t=plan.t,
            q=plan.q,
            dq=plan.dq,
            ddq=plan.ddq,
            stop_duration=stops,
            path_tolerance=plan.path_tolerance or self._path_tolerance_rad,
            goal_tolerance=plan.goal_tolerance or self._goal_tolerance_rad,
            margins=margins,
        )


def _from_reference(plan: PlanRequest, q_ref: np.ndarray) -> PlanRequest:
    """Begin exactly at the reference and at rest, so that the first setpoint makes no step.

    The tolerance of the start check would otherwise be played within one tick. Everything is checked after this.
    """
    q, dq, ddq = plan.q.copy(), plan.dq.copy(), plan.ddq.copy()
    q[0] = q_ref
    dq[0] = dq[-1] = 0.0
    ddq[0] = ddq[-1] = 0.0
    return replace(plan, q=q, dq=dq, ddq=ddq)


def _times(knots: np.ndarray, step_s: float) -> np.ndarray:
    """All knots and points between them, at most ``step_s`` apart, at least one inside each segment [s]."""
    width = np.diff(knots)
    pieces = np.maximum(2, np.ceil(width / step_s).astype(int))
    segment = np.repeat(np.arange(len(width)), pieces)
    first = np.concatenate([[0], np.cumsum(pieces)[:-1]])
    fraction = (np.arange(len(segment)) - first[segment]) / pieces[segment]
    return np.append(knots[segment] + fraction * width[segment], knots[-1])
