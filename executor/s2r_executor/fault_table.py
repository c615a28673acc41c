"""Every cause with what it means, what the arm did and how to recover; docs/faults/README.md is made from it.

Run ``python -m s2r_executor.fault_table > docs/faults/README.md`` after a change.
"""

from __future__ import annotations

from dataclasses import dataclass

from s2r_protocol.can.drive import DriveState
from s2r_protocol.faults import Cause


@dataclass(frozen=True)
class Fault:
    """One row: a clause, then two sentences, then the unit of its value and limit; empty where they have none."""

    meaning: str
    reaction: str
    recover: str
    unit: str = ""


_CAT2 = "Slowed down on its path to rest and holds there, drives on (category 2)."
_CAT1 = "Braked every joint within its limits, then switched the drives off and latched (category 1)."
_NO_STOP = "Stayed where it was."
_AGAIN = "Take the lease again and send a new plan from the held position."
_RESET = "Remove the cause, then send RESET and ARM."

FAULTS: dict[Cause, Fault] = {
    Cause.NONE: Fault("nothing stopped the arm", "Nothing.", "Nothing to do."),
    Cause.HOST_LOST: Fault(
        "the lease holder's heartbeat fell silent or it gave the lease back in motion",
        _CAT2,
        "Look after the host and its link, then take the lease again and send a new plan from the held position.",
    ),
    Cause.FRONT_END_LOST: Fault(
        "the executor's front end fell silent",
        _CAT2,
        "Restart the executor; the front end crashed or its machine is overloaded.",
        "s",
    ),
    Cause.FEEDBACK_LOST: Fault(
        "a joint's answers are missing on the bus",
        _CAT1,
        "Check the drive's cable and power, that --packing and --clock are its own, and on the classical packing that "
        "it sends its TPDO2 every eighth SYNC; then send RESET and ARM.",
        "ticks",
    ),
    Cause.BUS_OFF: Fault(
        "the CAN controller went bus-off",
        "The drives stopped by their own watchdogs; the executor latched.",
        "Check termination and cables, then send RESET and ARM.",
    ),
    Cause.BUS_LOAD: Fault(
        "the bus is too busy for the cycle",
        _CAT1,
        "Find the node that floods the bus, then send RESET and ARM.",
    ),
    Cause.FOREIGN_MASTER: Fault(
        "somebody else sends setpoints or network commands on the bus",
        _CAT1,
        "Disconnect the other master, then send RESET and ARM.",
    ),
    Cause.TX_FAILED: Fault(
        "setpoints could not be put on the bus",
        "The drives extrapolate up to 3 ticks, then stop by their own watchdogs.",
        "Check the bus and its transmit queue length, then send RESET and ARM.",
        "ticks",
    ),
    Cause.OVERRUN: Fault(
        "the loop missed too many cycles",
        _CAT1,
        "Give the core real-time rights ('s2r doctor' says how), then send RESET and ARM.",
        "ticks",
    ),
    Cause.DRIVE_FAULT: Fault(
        "a drive reports a fault",
        _CAT1,
        "Read the drive's error number in its recording, remove the cause, then send RESET and ARM.",
    ),
    Cause.DRIVE_NOT_ENABLED: Fault(
        "a drive left 'operation enabled' by itself",
        _CAT1,
        "Check the drive's supply and enable input, then send RESET and ARM.",
    ),
    Cause.ARMING_TIMEOUT: Fault(
        "a drive did not reach 'operation enabled' in time",
        _NO_STOP,
        "Check that all drives are powered and on the bus, then send RESET and ARM.",
    ),
    Cause.PLAUSIBILITY: Fault("a joint's measured position made an impossible jump", _CAT1, _RESET, "rad"),
    Cause.BRAKE: Fault(
        "a brake is not where its drive wants it",
        "Switched off (category 0); a brake that does not close keeps the arm under power instead.",
        "Support the arm before its power is cut, look after the brake, then send RESET and ARM.",
    ),
    Cause.ESTOP: Fault(
        "the emergency stop chain is open",
        "The hardware removed power (category 0).",
        "Release the emergency stop, then send RESET and ARM; releasing alone never moves the arm.",
    ),
    Cause.ESTOP_DISCREPANCY: Fault(
        "the two channels of the emergency stop disagree",
        "Treated as an emergency stop, latched.",
        "Have the chain repaired; one of its contacts is stuck or broken.",
    ),
    Cause.INTERNAL: Fault(
        "the core met a state it must never meet",
        _CAT1,
        "Report it with the recording, then restart the executor.",
    ),
    Cause.LIMIT_POSITION: Fault("a setpoint would have left the position limits", _CAT1, _RESET, "rad"),
    Cause.LIMIT_VELOCITY: Fault("a setpoint would have exceeded the velocity limit", _CAT1, _RESET, "rad/s"),
    Cause.LIMIT_ACCELERATION: Fault(
        "a setpoint would have exceeded the acceleration limit", _CAT1, _RESET, "rad/s²"
    ),
    Cause.LIMIT_JERK: Fault("a setpoint would have exceeded the jerk limit", _CAT1, _RESET, "rad/s³"),
    Cause.FOLLOWING: Fault(
        "a joint does not follow its reference",
        _CAT1,
        "Look for contact, overload or a wrong payload, then send RESET and ARM.",
        "rad",
    ),
    Cause.COLLISION: Fault(
        "joint torques say that the arm met something", _CAT1, "Free the arm, then send RESET and ARM.", "N·m"
    ),
    Cause.OVER_TEMPERATURE: Fault(
        "a drive is too hot", _CAT1, "Let it cool down, then send RESET and ARM.", "°C"
    ),
    Cause.GOAL_TOLERANCE: Fault(
        "a joint did not reach its goal in time",
        "Holds at the end of its plan, drives on (category 2).",
        "Look for contact or a wrong payload; " + _AGAIN[0].lower() + _AGAIN[1:],
        "rad",
    ),
    Cause.STOP_REQUESTED: Fault("a stop was requested", _CAT2, _AGAIN),
    Cause.DISARM_REQUESTED: Fault(
        "the drives were switched off on request", "Drives off, brakes on.", "Send ARM."
    ),
    Cause.PAUSE_REQUESTED: Fault(
        "a pause was requested", "Slowed down on its path to rest.", "Send RESUME or STOP."
    ),
}


def numbers_of(cause: Cause, value: float, limit: float) -> str:
    """What the core compared, in words: "0.0612 rad, limit 0.05 rad"; empty where its numbers say nothing."""
    match cause:
        case Cause.DRIVE_NOT_ENABLED | Cause.ARMING_TIMEOUT:
            return f"it is {_drive_state(value)}"
        case Cause.DRIVE_FAULT:
            return f"error 0x{int(value):04x}" if value else ""
        case Cause.BRAKE | Cause.ESTOP | Cause.ESTOP_DISCREPANCY:
            return ""  # which of two contacts
        case _ if limit == 0.0:  # the cause has no number to tell
            return ""
    unit = FAULTS[cause].unit
    space = f" {unit}" if unit else ""
    return f"{value:.4g}{space}, limit {limit:.4g}{space}"


def _drive_state(number: float) -> str:
    """The drive's state in its own words: "switched on"."""
    known = number in DriveState._value2member_map_
    return DriveState(int(number)).name.lower().replace("_", " ") if known else f"in state {number:g}"


def markdown() -> str:
    """The table as a page."""
    lines = [
        "# Faults",
        "",
        "Why the arm stopped or will not move. 1xx: transport, 2xx: hard fault, 3xx: limiting, 4xx: asked for.",
        "Generated by `python -m s2r_executor.fault_table`; a test compares.",
        "This is software and carries no performance level: emergency stop and safe torque off are hardware.",
        "",
        "On a terminal, `s2r state` tells which one it is, `s2r reset` sends RESET and `s2r arm` sends ARM; "
        "`s2r run` arms by itself.",
        "A RESET that comes while the drives still brake, up to 1 s after a latch in motion, waits for them.",
        "",
        "| number | cause | meaning | what the arm did | how to recover |",
        "|---|---|---|---|---|",
    ]
    for cause in sorted(FAULTS):
        fault = FAULTS[cause]
        meaning = fault.meaning[0].upper() + fault.meaning[1:] + "."
        lines.append(f"| {int(cause)} | {cause.name} | {meaning} | {fault.reaction} | {fault.recover} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
