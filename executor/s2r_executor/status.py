"""The executor's state for others to read, and one sentence on why the arm does not move."""

from __future__ import annotations

from dataclasses import dataclass

from s2r_executor.core import CoreSnapshot
from s2r_executor.fault_table import FAULTS, numbers_of
from s2r_protocol.faults import Cause, ExecutorState

NEVER_TICKS = 65_535  # where the core stops counting the age of an answer, and where it begins (core.cpp)


@dataclass(frozen=True, eq=False)
class ExecutorStatus:
    """The core's snapshot with what only the front end knows.

    Attributes:
        core: The snapshot.
        plan_seq: The host's number of the running or last plan; 0 = none since start.
        lease_holder: Empty if there is none.
        why_not_moving: One sentence.
        silent_joints: Joints whose drive has not answered yet; their measured values mean nothing.
    """

    core: CoreSnapshot
    plan_seq: int
    lease_holder: str
    why_not_moving: str
    silent_joints: tuple[str, ...]

    @property
    def state(self) -> ExecutorState:
        """State as an enum."""
        return ExecutorState(self.core.state)

    @property
    def cause(self) -> Cause:
        """Cause of the last stop or latch as an enum."""
        return known_cause(self.core.cause)


def known_cause(number: int) -> Cause:
    """The cause with this number; an unknown one is an internal fault, never ignored."""
    return Cause(number) if number in Cause._value2member_map_ else Cause.INTERNAL


def silent_joints(core: CoreSnapshot, joint_names: tuple[str, ...]) -> tuple[str, ...]:
    """Joints whose drive has not answered since the core started, or not for a minute and more."""
    return tuple(name for name, age in zip(joint_names, core.feedback_age, strict=True) if age >= NEVER_TICKS)


LOOK_AT = (
    "look at power, cables and bus, and whether the executor's --packing and --clock are theirs ('s2r sim-arm' runs in "
    "lockstep unless told otherwise)"
)
"""What to do about drives that do not answer or do not follow."""


def describe_silence(silent: tuple[str, ...]) -> str:
    """As a clause, what to do about joints whose drives do not answer."""
    return f"no answer from the drives of {', '.join(silent)}: {LOOK_AT}"


def describe_cause(core: CoreSnapshot, joint_names: tuple[str, ...]) -> str:
    """The cause as a clause: "joint 'joint2': a joint does not follow its reference (0.061 rad, limit 0.05 rad)"."""
    cause = known_cause(core.cause)
    if cause is Cause.NONE:
        return "no cause"
    text = FAULTS[cause].meaning
    numbers = numbers_of(cause, core.cause_value, core.cause_limit)
    if numbers:
        text += f" ({numbers})"
    if 0 <= core.cause_joint < len(joint_names):
        text = f"joint '{joint_names[core.cause_joint]}': {text}"
    return text


_ON_A_TERMINAL = " On a terminal: 's2r reset', then 's2r arm'; 's2r run' arms by itself."


def why_not_moving(core: CoreSnapshot, joint_names: tuple[str, ...], lease_holder: str) -> str:
    """One sentence for the operator."""
    if not core.alive:
        return "The real-time core is not running: restart the executor."
    state = ExecutorState(core.state)
    stopped = f" The last stop: {describe_cause(core, joint_names)}." if core.cause else ""
    match state:
        case ExecutorState.BOOT:
            return "The core is starting and checks its configuration and the bus."
        case ExecutorState.DISARMED:
            silent = silent_joints(core, joint_names)
            if silent:
                clause = describe_silence(silent)
                return f"{clause[0].upper()}{clause[1:]}."
            return (
                "The drives are off: take the lease and send ARM ('s2r arm'; 's2r run' arms by itself)."
                + stopped
            )
        case ExecutorState.ARMING:
            return "The drives are being switched on."
        case ExecutorState.HOLD:
            waiting = (
                "waits for a plan" if lease_holder else "waits for somebody to take the lease and send a plan"
            )
            return f"The arm holds its position and {waiting}." + stopped
        case ExecutorState.RUN:
            if core.speed_scale == 0.0:
                return "The plan is running with its path time frozen."
            return f"The arm is moving: {core.plan_t:.2f} s into its plan."
        case ExecutorState.PAUSED:
            return "The plan is paused: send RESUME or STOP."
        case ExecutorState.STOP1 if core.cause == Cause.BRAKE:
            return (
                f"The arm has stopped and stays under power: {describe_cause(core, joint_names)}. Support it, then "
                "press the emergency stop; a brake that closes after all ends the stop."
            )
        case ExecutorState.STOPPING | ExecutorState.STOP1:
            return f"The arm is coming to a stop: {describe_cause(core, joint_names)}."
        case ExecutorState.FAULT:
            recover = FAULTS[known_cause(core.cause)].recover
            return (
                f"A fault is latched: {describe_cause(core, joint_names)}; {recover[0].lower()}{recover[1:]}"
                + (_ON_A_TERMINAL if "RESET" in recover else "")
            )
        case ExecutorState.ESTOP:
            return _why_emergency_stop(core)


def _why_emergency_stop(core: CoreSnapshot) -> str:
    """Releasing mends no broken contact; whoever is told to would reset what still has to be repaired."""
    if known_cause(core.cause) is not Cause.ESTOP_DISCREPANCY:
        return "The emergency stop chain is open: release it, then send RESET and ARM." + _ON_A_TERMINAL
    fault = FAULTS[Cause.ESTOP_DISCREPANCY]
    recover = fault.recover[0].lower() + fault.recover[1:]
    return (
        f"The emergency stop is latched: {fault.meaning}; {recover} Then send RESET and ARM." + _ON_A_TERMINAL
    )
