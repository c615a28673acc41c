"""Requests whose numbers are refused before anything is planned."""

from __future__ import annotations

import numpy as np

from s2r_host.planning.out_of_reach import arm_reach_m
from s2r_host.planning.scene import Scene
from s2r_host.planning.task import PlanRefusedError, PlanRequest

_MOST_TURNS = 4.0  # of a hinge without limits; a plan of many legs makes about two


def check_numbers(request: PlanRequest) -> None:
    """Refuse numbers that are not finite, wrong joint counts and moves of nothing."""
    arm = request.arm
    q = np.asarray(request.q_initial, dtype=float)
    if q.shape != (arm.dof,):
        raise PlanRefusedError(f"the start pose has shape {q.shape}; arm {arm.name!r} needs ({arm.dof},)")
    for name, value in (("start", request.s_initial), ("target", request.s_target)):
        if not np.isfinite(value):
            raise PlanRefusedError(f"joint {request.joint!r}: {name} = {value} is not a finite number")
    for name, value in zip(arm.joint_names, q, strict=True):
        if not np.isfinite(value):
            raise PlanRefusedError(f"joint {name!r}: start pose = {value} is not a finite number")
    limits = arm.limits
    for i, name in enumerate(arm.joint_names):
        if not limits.q_min[i] <= q[i] <= limits.q_max[i]:
            raise PlanRefusedError(
                f"joint {name!r} (index {i}): start pose = {q[i]:.3f} rad is outside "
                f"[{limits.q_min[i]:.3f}, {limits.q_max[i]:.3f}] rad"
            )


def check_target(request: PlanRequest, scene: Scene, tolerance: float) -> None:
    """Refuse targets that are where the joint already is, or where it cannot be."""
    unit = "m" if scene.prismatic else "rad"
    s_initial, s_target = request.s_initial, request.s_target
    if abs(s_target - s_initial) < tolerance:
        raise PlanRefusedError(
            f"joint {request.joint!r}: target = {s_target:.4f} {unit} equals start = {s_initial:.4f} {unit} "
            f"within the success band of {tolerance:g} {unit}: there is nothing to move"
        )
    if scene.s_range is None:
        _refuse_absurd_way(request, scene)
        return
    low, high = scene.s_range
    for name, value, slack in (("start", s_initial, tolerance), ("target", s_target, 0.0)):
        if not low - slack <= value <= high + slack:
            raise PlanRefusedError(
                f"joint {request.joint!r}: {name} = {value:.4f} {unit} is beyond its range "
                f"[{low:.4f}, {high:.4f}] {unit}{_in_degrees(scene, value)}"
            )


def check_links(request: PlanRequest, scene: Scene) -> None:
    """Refuse a start pose from which the executor refuses every motion."""
    near = scene.links.near(np.asarray(request.q_initial, dtype=float)[None])
    if near is not None:
        raise PlanRefusedError(
            f"at the start pose {near}; the executor refuses every motion from there: move them apart first"
        )


def _refuse_absurd_way(request: PlanRequest, scene: Scene) -> None:
    """Refuse ways of a joint without limits that no arm goes along with."""
    way = abs(request.s_target - request.s_initial)
    reach_m = arm_reach_m(scene)
    if scene.prismatic and way > 2.0 * reach_m:
        raise PlanRefusedError(
            f"joint {request.joint!r}: target = {request.s_target:g} m is {way:g} m away, farther than the arm "
            f"{scene.arm.name!r} gets from one side of its base to the other, {2.0 * reach_m:.2f} m"
        )
    turns = way / (2.0 * np.pi)
    if not scene.prismatic and turns > _MOST_TURNS:
        raise PlanRefusedError(
            f"joint {request.joint!r}: target = {request.s_target:g} rad is {turns:.1f} turns away, more than the "
            f"{_MOST_TURNS:g} that are planned; is it meant in degrees?"
        )


def _in_degrees(scene: Scene, value: float) -> str:
    """A hint where the range would hold the value if its numbers were radians, for the end of a sentence."""
    if scene.prismatic or scene.s_range is None:
        return ""
    low, high = np.rad2deg(scene.s_range)
    if high - low > 2.0 * np.pi or not low <= value <= high:
        return ""
    return (
        f"; the file's angles are degrees: were [{low:.4g}, {high:.4g}] meant as radians, it needs "
        '<compiler angle="radian"/>'
    )
