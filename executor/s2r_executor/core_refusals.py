"""What the core refused, as sentences for the operator."""

from __future__ import annotations

import numpy as np

from s2r_executor.core import CoreSnapshot
from s2r_executor.fault_table import FAULTS
from s2r_executor.plan import CommandRefusedError
from s2r_executor.status import LOOK_AT, NEVER_TICKS, known_cause
from s2r_protocol.faults import ExecutorState, Refusal
from s2r_protocol.proto import s2r_pb2 as pb


def refused_plan(event: np.void, joint_names: tuple[str, ...]) -> CommandRefusedError:
    """Of a plan: the core checks again by itself what admission has checked."""
    code = Refusal(int(event["cause"]))
    why = {
        Refusal.STALE: "it stopped or was armed meanwhile",
        Refusal.STATE: "it changed its state meanwhile",
        Refusal.LATE: "the splice point had passed when the plan arrived; splice further ahead",
    }.get(code, "the plan does not fit the reference any more")
    text = f"the core refused the plan ({code.name}): {why}; value {event['value']:.6g}, limit {event['limit']:.6g}"
    return _refusal(event, joint_names, text, code.name.lower())


def refused_command(
    kind: int, event: np.void, core: CoreSnapshot, joint_names: tuple[str, ...], why_not_moving: str
) -> CommandRefusedError:
    """Of a control command.

    Args:
        kind: Which command, e.g. ``pb.ARM``.
        event: The core's refusal of it.
        core: Its state now.
        joint_names: Of the arm.
        why_not_moving: What there is to say where no joint is the reason.
    """
    command = f"the core refused {pb.ControlKind.Name(kind)}"
    about_a_joint = 0 <= event["joint"] < len(joint_names)
    told = _about_a_joint(kind, event) if about_a_joint else _about_the_bus(kind, event)
    if told is None:
        state = ExecutorState(core.state).name
        return _refusal(event, joint_names, f"{command} in {state}. {why_not_moving}", "state")
    why, quantity = told
    return _refusal(event, joint_names, f"{command}: {why}", quantity)


def _about_a_joint(kind: int, event: np.void) -> tuple[str, str] | None:
    """Why a joint is the reason, and what its value and limit are of; None where nothing is known to say."""
    value, limit = float(event["value"]), float(event["limit"])
    if event["cause"] == Refusal.POSITION:
        return (
            f"it stands at {value:.4f} rad, beyond its limit of {limit:.4f} rad, where no plan could begin; bring it "
            "back with the arm's own controller or by hand, drives off",
            "position",
        )
    if kind in (pb.ARM, pb.RESET) and limit > 0.0:
        silence = "not yet answered" if value >= NEVER_TICKS else f"not answered for {value:.0f} ticks"
        return (
            f"its drive has {silence} (limit {limit:.0f} ticks; on the classical packing, whether its TPDO2 comes is "
            f"counted, too); {LOOK_AT}",
            "ticks without an answer",
        )
    if kind == pb.RESET:
        return (
            f"its drive still reports a fault, error 0x{int(value):04x}; remove its cause, then 's2r reset' again",
            "drive error",
        )
    if kind == pb.DISARM:
        return (
            "its brake has not closed; the drives are enabled again, so that the arm holds and nothing falls. Look "
            "after the brake, and support the arm before its power is cut",
            "brake",
        )
    return None


def _about_the_bus(kind: int, event: np.void) -> tuple[str, str] | None:
    """What is wrong with the bus, where that is why no drive is switched on: the value is its cause then."""
    if kind != pb.ARM or event["limit"] != 0.0:
        return None
    cause = known_cause(int(event["value"]))
    return f"{FAULTS[cause].meaning}; mend that, then 's2r arm' again", "bus"


def _refusal(event: np.void, joint_names: tuple[str, ...], text: str, quantity: str) -> CommandRefusedError:
    index = int(event["joint"])
    joint = joint_names[index] if 0 <= index < len(joint_names) else ""
    return CommandRefusedError(
        Refusal(int(event["cause"])),
        f"joint '{joint}' (index {index}): {text}" if joint else text,
        joint=joint,
        quantity=quantity,
        value=float(event["value"]),
        limit=float(event["limit"]),
    )
