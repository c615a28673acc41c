"""Is this a plan at all: sizes, names, finite numbers, rising time, rest at both ends, the right start."""

from __future__ import annotations

import numpy as np

from s2r_executor.config import AdmissionConfig
from s2r_executor.plan import CommandRefusedError, PlanRequest
from s2r_protocol.faults import Refusal

_FINITE = "send finite numbers; a planner that divides by zero makes these"
_UNITS = {"q": "rad", "dq": "rad/s", "ddq": "rad/s²"}


def check_form(
    plan: PlanRequest, joint_names: tuple[str, ...], config: AdmissionConfig, from_rest: bool = True
) -> None:
    """Everything that needs no arm model but its joint names. Arrays have matching shapes afterwards."""
    check_names(plan.joint_names, joint_names)
    _check_sizes(plan, len(joint_names), config)
    _check_finite(plan, joint_names)
    _check_time(plan, config)
    _check_scalars(plan, config)
    _check_rest(plan, joint_names, config, from_rest)


def check_names(theirs: tuple[str, ...], joint_names: tuple[str, ...]) -> None:
    """The joints a plan is for are the arm's, in its order.

    Raises:
        CommandRefusedError: MODEL.
    """
    if theirs == joint_names:
        return
    wrong = next(
        (
            f"joint {i} is {a!r}, expected {b!r}"
            for i, (a, b) in enumerate(zip(theirs, joint_names, strict=False))
            if a != b
        ),
        f"{len(theirs)} joints, expected {len(joint_names)}",
    )
    raise CommandRefusedError(
        Refusal.MODEL,
        f"joint names do not match the arm: {wrong}; send {', '.join(joint_names)} in this order",
        quantity="joint_names",
        value=len(theirs),
        limit=len(joint_names),
    )


def _check_sizes(plan: PlanRequest, dof: int, config: AdmissionConfig) -> None:
    n = len(plan.t)
    if not 2 <= n <= config.max_knots:
        raise CommandRefusedError(
            Refusal.SIZE,
            f"plan has {n} knots, allowed are 2 to {config.max_knots}; "
            + ("send its start and its end" if n < 2 else "set knots less close, or divide the motion"),
            quantity="knots",
            value=n,
            limit=2 if n < 2 else config.max_knots,
        )
    for name in ("q", "dq", "ddq"):
        shape = getattr(plan, name).shape
        if shape != (n, dof):
            raise CommandRefusedError(
                Refusal.SIZE,
                f"{name} holds {shape[0] if shape else 0} x {shape[1] if len(shape) > 1 else 0} values "
                f"for {n} knots of {dof} joints; send one per knot and joint",
                quantity=name,
                value=float(np.prod(shape)),
                limit=n * dof,
            )


def _check_finite(plan: PlanRequest, joint_names: tuple[str, ...]) -> None:
    bad = np.nonzero(~np.isfinite(plan.t))[0]
    if len(bad):
        raise CommandRefusedError(
            Refusal.NONFINITE,
            f"time of knot {bad[0]} is {plan.t[bad[0]]}; {_FINITE}",
            quantity="time",
            value=float(plan.t[bad[0]]),
        )
    for name, unit in _UNITS.items():
        values = getattr(plan, name)
        knots, joints = np.nonzero(~np.isfinite(values))
        if len(knots):
            k, j = int(knots[0]), int(joints[0])
            raise CommandRefusedError(
                Refusal.NONFINITE,
                f"joint '{joint_names[j]}' (index {j}): {name} of knot {k} is {values[k, j]} {unit}; "
                f"{_FINITE}",
                joint=joint_names[j],
                t=float(plan.t[k]),
                quantity=name,
                value=float(values[k, j]),
            )
    for name in ("splice_t", "payload_mass", "path_tolerance", "goal_tolerance"):
        if not np.isfinite(getattr(plan, name)):
            raise CommandRefusedError(
                Refusal.NONFINITE,
                f"{name} is {getattr(plan, name)}; {_FINITE}",
                quantity=name,
                value=getattr(plan, name),
            )
    if not np.isfinite(plan.payload_com).all():
        raise CommandRefusedError(
            Refusal.NONFINITE, f"payload_com is {list(plan.payload_com)}; {_FINITE}", quantity="payload_com"
        )


def _check_time(plan: PlanRequest, config: AdmissionConfig) -> None:
    if plan.t[0] != 0.0:
        raise CommandRefusedError(
            Refusal.TIME,
            f"the first knot is at {plan.t[0]} s, it must be at 0; count time from the plan's beginning",
            quantity="time",
            value=plan.t[0],
        )
    width = np.diff(plan.t)
    # A knot grid of exactly the smallest step may round below it.
    short = np.nonzero(~(width >= config.min_segment_s * (1 - 1e-6)))[0]
    long = np.nonzero(~(width <= config.max_segment_s))[0]
    for bad, limit, word, what_to_do in (
        (short, config.min_segment_s, "at least", "let times rise, and leave out knots that stand too close"),
        (long, config.max_segment_s, "at most", "set knots in between"),
    ):
        if len(bad):
            k = int(bad[0])
            raise CommandRefusedError(
                Refusal.TIME,
                f"segment {k} from {plan.t[k]:.6g} s lasts {width[k]:.6g} s, it must last {word} {limit:g} s; "
                f"{what_to_do}",
                t=float(plan.t[k]),
                quantity="segment time",
                value=float(width[k]),
                limit=limit,
            )
    if not plan.t[-1] <= config.max_duration_s:
        raise CommandRefusedError(
            Refusal.TIME,
            f"plan lasts {plan.t[-1]:.6g} s, allowed are {config.max_duration_s:g} s; send it in parts",
            t=float(plan.t[-1]),
            quantity="duration",
            value=float(plan.t[-1]),
            limit=config.max_duration_s,
        )


def _check_scalars(plan: PlanRequest, config: AdmissionConfig) -> None:
    for name, value, key, unit, code in (
        ("payload_mass", plan.payload_mass, "max_payload_kg", "kg", Refusal.TORQUE),
        ("path_tolerance", plan.path_tolerance, "max_path_tolerance_rad", "rad", Refusal.POSITION),
        ("goal_tolerance", plan.goal_tolerance, "max_goal_tolerance_rad", "rad", Refusal.POSITION),
    ):
        limit: float = getattr(config, key)
        if not 0 <= value <= limit:
            raise CommandRefusedError(
                code,
                f"{name} = {value:g} {unit} is outside [0, {limit:g}] {unit}; send one inside, or start the executor "
                f"with another admission.{key}",
                quantity=name,
                value=value,
                limit=limit,
            )


def _check_rest(
    plan: PlanRequest, joint_names: tuple[str, ...], config: AdmissionConfig, from_rest: bool
) -> None:
    for knot, where in ((0, "starts"), (-1, "ends"))[0 if from_rest else 1 :]:
        for name, limit, unit in (
            ("dq", config.rest_speed_rad_s, "rad/s"),
            ("ddq", config.rest_acceleration_rad_s2, "rad/s²"),
        ):
            values = np.abs(getattr(plan, name)[knot])
            j = int(np.argmax(values))
            if not values[j] <= limit:
                raise CommandRefusedError(
                    Refusal.NOT_AT_REST,
                    f"joint '{joint_names[j]}' (index {j}): plan {where} with {name} = {values[j]:.6g} {unit}, "
                    f"rest is at most {limit:g} {unit}; begin and end at rest",
                    joint=joint_names[j],
                    t=float(plan.t[knot]),
                    quantity=name,
                    value=float(values[j]),
                    limit=limit,
                )


def check_start(
    plan: PlanRequest, joint_names: tuple[str, ...], q_ref: np.ndarray, config: AdmissionConfig
) -> None:
    """The first knot is the last acknowledged reference, not the measured position [rad], shape (dof,)."""
    offset = np.abs(plan.q[0] - q_ref)
    j = int(np.argmax(offset))
    if not offset[j] <= config.start_tolerance_rad:
        raise CommandRefusedError(
            Refusal.START,
            f"joint '{joint_names[j]}' (index {j}): plan starts at {plan.q[0, j]:.6f} rad, the arm holds "
            f"{q_ref[j]:.6f} rad; they may differ by {config.start_tolerance_rad:g} rad: plan from the reference",
            joint=joint_names[j],
            quantity="start position",
            value=float(offset[j]),
            limit=config.start_tolerance_rad,
        )
