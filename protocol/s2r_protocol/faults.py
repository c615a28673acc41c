"""Numbers that mean the same on every side: executor states, stop causes, refusals.

The native core's ``faults.hpp`` holds the same numbers; a test compares the two.
"""

from __future__ import annotations

import enum


class ExecutorState(enum.IntEnum):
    """State of the executor. Entered and left as each line says; any doubt leads towards a stop."""

    BOOT = 0  # entered at start; left to DISARMED once configuration and bus are checked
    DISARMED = 1  # drives off; left to ARMING by a fresh ARM request
    ARMING = 2  # drives walk to operation-enabled; left to HOLD, or to FAULT on a time-out
    HOLD = 3  # at rest, drives hold the reference; left to RUN by an accepted plan
    RUN = 4  # a plan plays; left to HOLD at its end, to PAUSED, STOPPING or STOP1
    PAUSED = 5  # path time stands still; left to RUN by RESUME, to STOPPING by STOP
    STOPPING = 6  # category 2: on-path ramp to rest; left to HOLD
    STOP1 = 7  # category 1: joint-space stop, brakes, then drives off; left to FAULT (latched)
    FAULT = 8  # latched, drives off; left to DISARMED by RESET once the cause is gone
    ESTOP = 9  # latched, the hardware chain is open; left to DISARMED by RESET after release


class StopCategory(enum.IntEnum):
    """IEC 60204-1 words. This is software: it carries no performance level."""

    NONE = 9
    CAT0 = 0  # power off now
    CAT1 = 1  # controlled stop, then power off
    CAT2 = 2  # controlled stop, power stays


class Cause(enum.IntEnum):
    """Why the arm stopped or will not move. Ranges: 100 transport, 200 hard fault, 300 limiting, 400 asked."""

    NONE = 0
    HOST_LOST = 100
    FRONT_END_LOST = 101
    FEEDBACK_LOST = 102
    BUS_OFF = 103
    BUS_LOAD = 104
    FOREIGN_MASTER = 105
    TX_FAILED = 106
    OVERRUN = 107
    DRIVE_FAULT = 200
    DRIVE_NOT_ENABLED = 201
    ARMING_TIMEOUT = 202
    PLAUSIBILITY = 203
    BRAKE = 204
    ESTOP = 205
    ESTOP_DISCREPANCY = 206
    INTERNAL = 299
    LIMIT_POSITION = 300
    LIMIT_VELOCITY = 301
    LIMIT_ACCELERATION = 302
    LIMIT_JERK = 303
    FOLLOWING = 304
    COLLISION = 305
    OVER_TEMPERATURE = 306
    GOAL_TOLERANCE = 307
    STOP_REQUESTED = 400
    DISARM_REQUESTED = 401
    PAUSE_REQUESTED = 402


class Refusal(enum.IntEnum):
    """Why a command was not accepted. The verdict adds joint, time, quantity, value and limit."""

    NONE = 0
    MALFORMED = 1  # magic, CRC, schema version or kind
    MODEL = 2  # model hash, limit hash, joint names or count
    STALE = 3  # boot id, epoch or sequence
    NO_LEASE = 4
    STATE = 5  # not possible in the present state
    NONFINITE = 10
    TIME = 11  # knots not rising, segment too short or too long, plan too long
    SIZE = 12  # number of knots
    START = 13  # does not start at the acknowledged reference
    NOT_AT_REST = 14
    POSITION = 20
    VELOCITY = 21
    ACCELERATION = 22
    JERK = 23
    TORQUE = 24
    COLLISION = 25
    NO_STOP_PATH = 26  # no legal on-path stop ramp exists for a segment
    LATE = 30
    SPLICE = 31
    INTERNAL = 99


NOTHING_RECORDED = "the executor records nothing; start it with --record DIR"
"""Why an executor has no recording of any plan."""
