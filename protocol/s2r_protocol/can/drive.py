"""Words of CiA 402 (drives and motion control) that both packings use."""

from __future__ import annotations

import enum


class DriveState(enum.IntEnum):
    """State of the CiA 402 state machine, as in the low nibble of STAT."""

    NOT_READY = 0  # self test; left by itself
    SWITCH_ON_DISABLED = 1  # power off, brake on; left by "shutdown"
    READY_TO_SWITCH_ON = 2  # left by "switch on"
    SWITCHED_ON = 3  # power stage ready, no torque; left by "enable operation"
    OPERATION_ENABLED = 4  # follows set-points
    QUICK_STOP_ACTIVE = 5  # on its own ramp, then at rest; left only by "disable voltage"
    FAULT_REACTION = 6  # on its own ramp; left by itself to FAULT
    FAULT = 7  # latched, brake on; left by a rising "fault reset"


class Control(enum.IntEnum):
    """Low nibble of SET's ctrl byte: what all drives are asked to become.

    Only SWITCH_ON takes a drive up from where its power is off. Under a standing ENABLE one that has dropped out stays
    where it is.
    """

    DISABLE = 0
    SWITCH_ON = 1  # one step at a time from where the power is off; down from OPERATION_ENABLED
    ENABLE = 2  # from SWITCHED_ON alone, on its rising edge
    QUICK_STOP = 3
    FAULT_RESET = 4  # acts on its rising edge
    DISABLE_OPERATION = 5  # down from OPERATION_ENABLED alone; the torque stays until the brake has closed


class DriveError(enum.IntEnum):
    """High byte of the CANopen emergency error code (CiA 301, table of error code classes)."""

    NONE = 0x00
    OVER_CURRENT = 0x23
    TEMPERATURE = 0x42
    BRAKE = 0x71
    ENCODER = 0x73
    COMMUNICATION = 0x81  # life guard: set-points missing
    FOLLOWING = 0x86  # positioning controller: following error


BRAKE_RELEASED = 0x10  # STAT state byte, bit 4
FOLLOWING_WARNING = 0x20  # STAT state byte, bit 5
ESTOP_SHIFT = 6  # STAT state byte, bits 6 and 7: channel 1 and 2 of the emergency stop chain are open

# Statusword (0x6041): the bits that tell the states apart, then the ones a master watches.
STATUSWORD: dict[DriveState, int] = {
    DriveState.NOT_READY: 0x0000,
    DriveState.SWITCH_ON_DISABLED: 0x0040,
    DriveState.READY_TO_SWITCH_ON: 0x0031,
    DriveState.SWITCHED_ON: 0x0033,
    DriveState.OPERATION_ENABLED: 0x0037,
    DriveState.QUICK_STOP_ACTIVE: 0x0017,
    DriveState.FAULT_REACTION: 0x001F,
    DriveState.FAULT: 0x0018,
}
SW_WARNING = 0x0080
SW_REMOTE = 0x0200
SW_FOLLOWS = 0x1000  # cyclic synchronous modes: the drive follows the command value
SW_FOLLOWING_ERROR = 0x2000
SW_BRAKE_RELEASED = 0x4000  # manufacturer specific
SW_ESTOP_1 = 0x0100  # manufacturer specific: channel 1 of the emergency stop chain is open
SW_ESTOP_2 = 0x8000  # manufacturer specific: channel 2

CW_FAULT_RESET = 0x0080  # controlword (0x6040), acts on its rising edge


class DriveCommand(enum.IntEnum):
    """What a controlword (0x6040) asks of the state machine; the value is the usual controlword."""

    DISABLE_VOLTAGE = 0x0000
    QUICK_STOP = 0x0002
    SHUTDOWN = 0x0006
    SWITCH_ON = 0x0007  # also "disable operation"
    ENABLE_OPERATION = 0x000F


def command_of(controlword: int) -> DriveCommand:
    """Decode a controlword (CiA 402, table "command coding")."""
    if not controlword & 0x02:
        return DriveCommand.DISABLE_VOLTAGE
    if not controlword & 0x04:
        return DriveCommand.QUICK_STOP
    if not controlword & 0x01:
        return DriveCommand.SHUTDOWN
    return DriveCommand.ENABLE_OPERATION if controlword & 0x08 else DriveCommand.SWITCH_ON


def state_of(statusword: int) -> DriveState:
    """The state a statusword (0x6041) tells.

    Raises:
        ValueError: No state has these bits.
    """
    low = statusword & 0x4F
    by_4f = {
        0x00: DriveState.NOT_READY,
        0x40: DriveState.SWITCH_ON_DISABLED,
        0x0F: DriveState.FAULT_REACTION,
        0x08: DriveState.FAULT,
    }
    if low in by_4f:
        return by_4f[low]
    by_6f = {
        0x21: DriveState.READY_TO_SWITCH_ON,
        0x23: DriveState.SWITCHED_ON,
        0x27: DriveState.OPERATION_ENABLED,
        0x07: DriveState.QUICK_STOP_ACTIVE,
    }
    state = by_6f.get(statusword & 0x6F)
    if state is None:
        raise ValueError(f"statusword {statusword:#06x} matches no CiA 402 state")
    return state


_EMERGENCY_CODES = {DriveError.NONE: 0x0000, DriveError.COMMUNICATION: 0x8130, DriveError.FOLLOWING: 0x8611}


PDO_TOO_SHORT, PDO_TOO_LONG = 0x8210, 0x8220
"""Emergency error codes of a PDO that was not processed, and of one whose first bytes were (CiA 301)."""

# Error register (0x1001, and the third byte of EMCY): generic, and what kind of error it is.
_GENERIC, _CURRENT, _TEMPERATURE, _COMMUNICATION, _PROFILE = 0x01, 0x02, 0x08, 0x10, 0x20
_KINDS = {
    DriveError.OVER_CURRENT: _CURRENT,
    DriveError.TEMPERATURE: _TEMPERATURE,
    DriveError.COMMUNICATION: _COMMUNICATION,
    DriveError.FOLLOWING: _PROFILE,
}


def error_register(error: DriveError, pdo_error: int = 0) -> int:
    """Error register (0x1001) while these errors are there; 0 without any."""
    kinds = _KINDS.get(error, 0) | (_COMMUNICATION if pdo_error else 0)
    return kinds | _GENERIC if error or pdo_error else 0


def emergency_code(error: DriveError) -> int:
    """The 16-bit emergency error code sent in EMCY and TPDO2; 0 = no error."""
    return _EMERGENCY_CODES.get(error, error << 8)
