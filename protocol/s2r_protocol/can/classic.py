"""The classical CAN packing for real CiA 402 drives (1 Mbit/s, 250 Hz): SYNC, PDOs, heartbeat, EMCY, NMT.

Order in one cycle: RPDO1 of every node, then SYNC; the drives latch their target at the SYNC and answer with TPDO1.
Every eighth SYNC they add TPDO2. All fields are little endian.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from s2r_protocol.can.drive import DriveState, state_of
from s2r_protocol.can.frames import FrameRefusedError
from s2r_protocol.can.units import (
    COUNTS_PER_RAD,
    FOLLOWING_UNIT,
    TORQUE_UNIT,
    VELOCITY_UNIT,
    position_counts,
    saturated_i16,
    torque_counts,
    velocity_counts,
)

NMT_ID = 0x000
SYNC_ID = 0x080
EMCY_ID = 0x080  # + node
TPDO1_ID = 0x180  # + node
RPDO1_ID = 0x200  # + node
TPDO2_ID = 0x280  # + node
HEARTBEAT_ID = 0x700  # + node
TICK_NS = 4_000_000
HEARTBEAT_NS = 100_000_000
TPDO2_EVERY = 8  # SYNCs

RPDO1 = struct.Struct("<Hih")
TPDO1 = struct.Struct("<Hih")
TPDO2 = struct.Struct("<hHB")
EMCY = struct.Struct("<HB5s")

NMT_START, NMT_STOP, NMT_PRE_OPERATIONAL, NMT_RESET_NODE, NMT_RESET_COMMUNICATION = (
    0x01,
    0x02,
    0x80,
    0x81,
    0x82,
)
HEARTBEAT_BOOT, HEARTBEAT_STOPPED, HEARTBEAT_OPERATIONAL, HEARTBEAT_PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F


@dataclass(frozen=True)
class Command:
    """RPDO1: controlword, target [rad] and velocity offset [rad/s] of one drive."""

    controlword: int
    q: float
    dq: float


@dataclass(frozen=True)
class Position:
    """TPDO1: statusword, measured position [rad] and following error [rad, saturating at ±0.327]."""

    statusword: int
    q_meas: float
    following_error: float

    @property
    def state(self) -> DriveState:
        """The CiA 402 state in the statusword."""
        return state_of(self.statusword)


@dataclass(frozen=True)
class Health:
    """TPDO2: torque [N·m], emergency error code (0 = none), temperature [°C]."""

    tau_meas: float
    error_code: int
    temp_C: int


def pack_rpdo1(command: Command) -> bytes:
    """Payload of RPDO1.

    Raises:
        FrameRefusedError: A value does not fit its field.
    """
    return RPDO1.pack(command.controlword, position_counts(command.q), velocity_counts(command.dq))


def unpack_rpdo1(payload: bytes) -> Command:
    """Read RPDO1.

    Raises:
        FrameRefusedError: Wrong length.
    """
    controlword, position, velocity = _unpack("RPDO1", RPDO1, payload)
    return Command(controlword, position / COUNTS_PER_RAD, velocity * VELOCITY_UNIT)


def pack_tpdo1(position: Position) -> bytes:
    """Payload of TPDO1."""
    following = saturated_i16(position.following_error / FOLLOWING_UNIT)
    return TPDO1.pack(position.statusword, position_counts(position.q_meas), following)


def unpack_tpdo1(payload: bytes) -> Position:
    """Read TPDO1.

    Raises:
        FrameRefusedError: Wrong length.
    """
    statusword, position, following = _unpack("TPDO1", TPDO1, payload)
    return Position(statusword, position / COUNTS_PER_RAD, following * FOLLOWING_UNIT)


def pack_tpdo2(health: Health) -> bytes:
    """Payload of TPDO2."""
    return TPDO2.pack(torque_counts(health.tau_meas), health.error_code, health.temp_C)


def unpack_tpdo2(payload: bytes) -> Health:
    """Read TPDO2.

    Raises:
        FrameRefusedError: Wrong length.
    """
    torque, error_code, temp_C = _unpack("TPDO2", TPDO2, payload)
    return Health(torque * TORQUE_UNIT, error_code, temp_C)


def _unpack(name: str, layout: struct.Struct, payload: bytes) -> tuple[int, ...]:
    if len(payload) != layout.size:
        raise FrameRefusedError(f"{name} payload of {len(payload)} bytes, expected {layout.size}")
    return layout.unpack(payload)
