"""The whole plan is checked before anything moves. A refusal names joint, time, quantity, value and limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_executor.bridge_motion import PathState, bridge
from s2r_executor.checks.bounds import check_bounds
from s2r_executor.checks.collision import CollisionModel
from s2r_executor.checks.dynamics import InverseDynamics, check_torque
from s2r_executor.checks.form import check_form, check_start
from s2r_executor.config import AdmissionConfig, CoreConfig
from s2r_executor.plan import AdmittedPlan, CommandRefusedError, PlanRequest
from s2r_executor.quintic import minimum_jerk, sample, spline_through
from s2r_executor.stop_ramps import load_along, stop_durations
from s2r_protocol.arms import ArmDescription
from s2r_protocol.faults import Refusal

SPLICE_POSITION_RAD, SPLICE_VELOCITY_RAD_S, SPLICE_ACCELERATION_RAD_S2 = 1e-6, 1e-5, 1e-4
"""Where a plan may begin off the one it replaces without a bridge; plan_check.hpp holds the same numbers."""

START_FADE_S = 0.2
"""How long the difference between a plan's start and the reference takes to vanish: 0.1 mrad then costs 0.75 rad/s³."""


class Admission:
    """Checks plans for one arm. Keeps no state between plans; not thread-safe (scratch memory of the libraries)."""

    def __init__(self, arm: ArmDescription, config: AdmissionConfig, core: CoreConfig) -> None:
        self._arm = arm
        self._config = config
        self._core = core
        self._dynamics = InverseDynamics(arm)
        self._collision = CollisionModel(arm, config)

    def admit(self, plan: PlanRequest, q_ref: np.ndarray) -> AdmittedPlan:
        """Check a plan that starts from rest.

        Args:
            plan: As it came.
            q_ref: The reference the core holds [rad], shape (dof,).

        Raises:
            CommandRefusedError: At the first check that fails; its text is one sentence for the operator.
        """
        check_form(plan, self._arm.joint_names, self._config)
        check_start(plan, self._arm.joint_names, q_ref, self._config)
        return self._check_motion(_from_reference(plan, q_ref))

    def admit_splice(self, plan: PlanRequest, start: PathState) -> AdmittedPlan:
        """Check a plan that takes over from a running one; where it does not begin on that one, build a bridge.

        Args:
            plan: As it came.
            start: Where the running plan will be at ``plan.splice_t``.

        Raises:
            CommandRefusedError: As :meth:`admit`; SPLICE when the two cannot be joined. The running plan goes on.
        """
        check_form(plan, self._arm.joint_names, self._config, from_rest=False)
        ending = plan.dq.copy(), plan.ddq.copy()
        for values in ending:
            values[-1] = 0.0
        plan = replace(plan, dq=ending[0], ddq=ending[1])
        if _meets(plan, start):
            q, dq, ddq = plan.q.copy(), plan.dq.copy(), plan.ddq.copy()
            q[0], dq[0], ddq[0] = start.q, start.dq, start.ddq
            plan = replace(plan, q=q, dq=dq, ddq=ddq)
        else:
            plan = bridge(plan, start, self._arm.limits, self._config)
            if len(plan.t) > self._config.max_knots:
                raise CommandRefusedError(
                    Refusal.SIZE,
                    f"with its bridge the plan has {len(plan.t)} knots, allowed are {self._config.max_knots}; "
                    "set knots less close",
                    quantity="knots",
                    value=len(plan.t),
                    limit=self._config.max_knots,
                )
        return self._check_motion(plan)

    def _check_motion(self, plan: PlanRequest) -> AdmittedPlan:
        names, config, limits = self._arm.joint_names, self._config, self._arm.limits
        path_tolerance, goal_tolerance = _tolerances(plan, self._core)
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
        load = load_along(spline, self._dynamics.torque)
        stops = stop_durations(spline, load, limits, names, tau_limit, config.stop_duration_max_s)
        load_t = load.step_s * np.arange(len(load.gravity))
        tau_rest = np.stack([np.interp(plan.t, load_t, g) for g in load.gravity.T], axis=1)
        return AdmittedPlan(
            t=plan.t,
            q=plan.q,
            dq=plan.dq,
            ddq=plan.ddq,
            stop_duration=stops,
            path_tolerance=path_tolerance,
            goal_tolerance=goal_tolerance,
            tau_rest=tau_rest,
            tau_move=tau[np.searchsorted(grid.t, plan.t)],
            margins=margins,
        )


def _tolerances(plan: PlanRequest, core: CoreConfig) -> tuple[float, float]:
    """Of the path and at the goal [rad]. An arm at rest farther off than its following window allows is stopped."""
    path = plan.path_tolerance or core.path_tolerance_rad
    at_rest = core.following_rest_share * path
    if plan.goal_tolerance > at_rest:
        raise CommandRefusedError(
            Refusal.POSITION,
            f"goal_tolerance = {plan.goal_tolerance:g} rad: at rest a joint may be off by {at_rest:g} rad at most, a "
            f"share of {core.following_rest_share:g} of the path tolerance; send a path_tolerance that is larger by as "
            "much, or a smaller goal_tolerance",
            quantity="goal_tolerance",
            value=plan.goal_tolerance,
            limit=at_rest,
        )
    return path, plan.goal_tolerance or min(core.goal_tolerance_rad, at_rest)


def _meets(plan: PlanRequest, start: PathState) -> bool:
    """The core's own tolerances for a splice: nobody could see such a step."""
    return bool(
        (np.abs(plan.q[0] - start.q) <= SPLICE_POSITION_RAD).all()
        and (np.abs(plan.dq[0] - start.dq) <= SPLICE_VELOCITY_RAD_S).all()
        and (np.abs(plan.ddq[0] - start.ddq) <= SPLICE_ACCELERATION_RAD_S2).all()
    )


def _from_reference(plan: PlanRequest, q_ref: np.ndarray) -> PlanRequest:
    """Begin exactly at the reference and at rest, so that the first setpoint makes no step.

    What the start check tolerates fades out over ``START_FADE_S`` along the minimum-jerk polynomial. Played within the
    first segment it would break the jerk limit where knots stand close: 10 µrad in 10 ms are 600 rad/s³. Everything is
    checked after this.
    """
    q, dq, ddq = plan.q.copy(), plan.dq.copy(), plan.ddq.copy()
    end = min(int(np.searchsorted(plan.t, plan.t[0] + START_FADE_S)), len(plan.t) - 1)
    duration = plan.t[end] - plan.t[0]
    s, ds, dds = minimum_jerk(((plan.t[: end + 1] - plan.t[0]) / duration)[:, None])
    offset = q_ref - plan.q[0]
    q[: end + 1] += offset * (1.0 - s)
    dq[: end + 1] -= offset * ds / duration
    ddq[: end + 1] -= offset * dds / duration**2
    q[0] = q_ref
    dq[0] = dq[-1] = 0.0
    ddq[0] = ddq[-1] = 0.0
    return replace(plan, q=q, dq=dq, ddq=ddq)


def _times(knots: np.ndarray, step_s: float) -> np.ndarray:
    """All knots, and points between those that are more than ``step_s`` apart [s]."""
    width = np.diff(knots)
    pieces = np.maximum(
        1, np.ceil(width / step_s - 1e-6).astype(int)
    )  # a grid of exactly that step may round above it
    segment = np.repeat(np.arange(len(width)), pieces)
    first = np.concatenate([[0], np.cumsum(pieces)[:-1]])
    fraction = (np.arange(len(segment)) - first[segment]) / pieces[segment]
    return np.append(knots[segment] + fraction * width[segment], knots[-1])
