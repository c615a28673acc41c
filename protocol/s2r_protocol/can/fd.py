"""The CAN FD packing: one 64-byte SET for all drives, one 16-byte STAT from each (1/5 Mbit/s, 1 kHz).

SET (0x080) is also the SYNC. Its CRC-32 covers bytes 0..3 and 8..63; STAT's CRC-16/CCITT-FALSE covers bytes
0..13 and one byte node number, so that a frame under the wrong identifier is noticed. Both are little endian.
"""

from __future__ import annotations

import struct
import zlib
from binascii import crc_hqx
from collections.abc import Sequence
from dataclasses import dataclass

from s2r_protocol.can.drive import BRAKE_RELEASED, FOLLOWING_WARNING, DriveState
from s2r_protocol.can.frames import CanFrame, FrameRefusedError
from s2r_protocol.can.units import (
    COUNTS_PER_RAD,
    TORQUE_UNIT,
    VELOCITY_UNIT,
    position_counts,
    torque_counts,
    velocity_counts,
)

SET_ID = 0x080
STAT_ID = 0x180  # + node
SLOTS = 7
TICK_NS = 1_000_000
SET = struct.Struct("<BBHI" + SLOTS * "ihh")
STAT_BODY = struct.Struct("<BBihhHBB")
STAT = struct.Struct("<BBihhHBBH")


@dataclass(frozen=True)
class SetPoint:
    """Contents of a SET frame, SI units; slots beyond the arm's joints are zero.

    Attributes:
        seq: Counter, one more per frame, modulo 256.
        control: :class:`~s2r_protocol.can.drive.Control`.
        tick: Executor tick modulo 65536.
        q, dq, tau_ff: Target [rad], velocity [rad/s], torque feed-forward [N·m], one per slot.
    """

    seq: int
    control: int
    tick: int
    q: tuple[float, ...]
    dq: tuple[float, ...]
    tau_ff: tuple[float, ...]


@dataclass(frozen=True)
class Status:
    """Contents of a STAT frame, SI units.

    Attributes:
        node: 1 for the first joint.
        seq, tick: Echoed from the SET that is answered.
        state: CiA 402 state.
        brake_released, following_warning: Flags.
        q_meas, dq_meas, tau_meas: Measured [rad, rad/s, N·m].
        error: :class:`~s2r_protocol.can.drive.DriveError`, 0 if none.
        temp_C: Motor temperature.
    """

    node: int
    seq: int
    tick: int
    state: DriveState
    brake_released: bool
    following_warning: bool
    q_meas: float
    dq_meas: float
    tau_meas: float
    error: int
    temp_C: int


def pack_set(
    seq: int,
    control: int,
    tick: int,
    q: Sequence[float],
    dq: Sequence[float] | None = None,
    tau_ff: Sequence[float] | None = None,
) -> bytes:
    """Payload of a SET frame for up to seven joints.

    Raises:
        FrameRefusedError: More joints than slots, or a value its field cannot hold.
    """
    if len(q) > SLOTS:
        raise FrameRefusedError(f"{len(q)} joints do not fit the {SLOTS} slots of a SET frame")
    dq = dq if dq is not None else [0.0] * len(q)
    tau_ff = tau_ff if tau_ff is not None else [0.0] * len(q)
    slots: list[int] = []
    for p, v, t in zip(q, dq, tau_ff, strict=True):
        slots += (position_counts(p), velocity_counts(v), torque_counts(t))
    slots += [0] * (3 * SLOTS - len(slots))
    blank = SET.pack(seq & 0xFF, control & 0xFF, tick & 0xFFFF, 0, *slots)
    return blank[:4] + struct.pack("<I", set_crc(blank)) + blank[8:]


def set_crc(payload: bytes) -> int:
    """CRC-32 of a SET payload: bytes 0..3 followed by 8..63."""
    return zlib.crc32(payload[8:], zlib.crc32(payload[:4]))


def unpack_set(payload: bytes) -> SetPoint:
    """Read a SET payload.

    Raises:
        FrameRefusedError: Wrong length or checksum.
    """
    if len(payload) != SET.size:
        raise FrameRefusedError(f"SET payload of {len(payload)} bytes, expected {SET.size}")
    seq, control, tick, crc, *slots = SET.unpack(payload)
    if crc != set_crc(payload):
        raise FrameRefusedError(f"SET with counter {seq}: CRC-32 {crc:#010x} does not match its contents")
    return SetPoint(
        seq,
        control,
        tick,
        tuple(p / COUNTS_PER_RAD for p in slots[0::3]),
        tuple(v * VELOCITY_UNIT for v in slots[1::3]),
        tuple(t * TORQUE_UNIT for t in slots[2::3]),
    )


def stat_crc(body: bytes, node: int) -> int:
    """CRC-16/CCITT-FALSE of STAT bytes 0..13 and the node number."""
    return crc_hqx(bytes((node,)), crc_hqx(body[:14], 0xFFFF))


def pack_stat(status: Status) -> bytes:
    """Payload of a STAT frame."""
    state = int(status.state)
    state |= BRAKE_RELEASED if status.brake_released else 0
    state |= FOLLOWING_WARNING if status.following_warning else 0
    body = STAT_BODY.pack(
        status.seq,
        state,
        position_counts(status.q_meas),
        velocity_counts(status.dq_meas),
        torque_counts(status.tau_meas),
        status.tick,
        status.error,
        status.temp_C,
    )
    return body + struct.pack("<H", stat_crc(body, status.node))


def unpack_stat(payload: bytes, node: int) -> Status:
    """Read a STAT payload that came under identifier 0x180 + ``node``.

    Raises:
        FrameRefusedError: Wrong length, checksum or node.
    """
    if len(payload) != STAT.size:
        raise FrameRefusedError(f"STAT of node {node}: {len(payload)} bytes, expected {STAT.size}")
    seq, state, position, velocity, torque, tick, error, temp_C, crc = STAT.unpack(payload)
    if crc != stat_crc(payload, node):
        raise FrameRefusedError(f"STAT of node {node}: CRC-16 {crc:#06x} does not match contents and node")
    if state & 0x0F > DriveState.FAULT:
        raise FrameRefusedError(f"STAT of node {node}: state nibble {state & 0x0F} is none of CiA 402's")
    return Status(
        node=node,
        seq=seq,
        tick=tick,
        state=DriveState(state & 0x0F),
        brake_released=bool(state & BRAKE_RELEASED),
        following_warning=bool(state & FOLLOWING_WARNING),
        q_meas=position / COUNTS_PER_RAD,
        dq_meas=velocity * VELOCITY_UNIT,
        tau_meas=torque * TORQUE_UNIT,
        error=error,
        temp_C=temp_C,
    )


def set_frame(payload: bytes) -> CanFrame:
    """The SET frame around its payload."""
    return CanFrame(SET_ID, payload, is_fd=True, brs=True)


def stat_frame(payload: bytes, node: int) -> CanFrame:
    """The STAT frame around its payload."""
    return CanFrame(STAT_ID + node, payload, is_fd=True, brs=True)
