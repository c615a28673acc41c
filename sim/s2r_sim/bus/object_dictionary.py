"""The emulated drives' object dictionaries, read by SDO: identity, limits and watchdogs as they really are here.

Every value is taken from what the emulated drive does (its torque limit, ramp, following window, missed set-points),
except 0x607D: the emulated drive reports the arm's position limits and leaves acting on them to the brake.
All entries are read only.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

from s2r_protocol.arms import ArmDescription
from s2r_protocol.can import sdo
from s2r_protocol.can.drive import error_register
from s2r_protocol.can.frames import CanFrame
from s2r_protocol.can.units import COUNTS_PER_RAD, VELOCITY_UNIT
from s2r_sim.drives import EXTRAPOLATED_PERIODS, FOLLOWING_FAULT_RAD, FOLLOWING_FAULT_S, Drive

VENDOR_ID = 0x0000_0000  # none: this is a simulation
PRODUCT_CODE = 0x5332_5244  # "S2RD"
POSITION_MARGIN_RAD = 0.01  # the drive's own limits lie just outside the planner's
SPEED_OVER_LIMIT = 1.1

Entries = dict[tuple[int, int], bytes]


def entries(drive: Drive, arm: ArmDescription, tick_ns: int) -> Entries:
    """One drive's dictionary: (index, subindex) to the bytes on the wire."""
    i = drive.node - 1
    low = round((float(arm.limits.q_min[i]) - POSITION_MARGIN_RAD) * COUNTS_PER_RAD)
    high = round((float(arm.limits.q_max[i]) + POSITION_MARGIN_RAD) * COUNTS_PER_RAD)
    speed = round(SPEED_OVER_LIMIT * float(arm.limits.dq_max[i]) / VELOCITY_UNIT)
    p = drive.parameters
    return {
        (0x1000, 0): _u32(0x0002_0192),  # CiA 402 servo drive
        (0x1001, 0): _u8(error_register(drive.error, drive.pdo_error)),
        (0x1008, 0): f"s2r stand-in drive, joint {drive.node}".encode(),
        (0x1017, 0): _u16(100),  # producer heartbeat [ms]
        (0x1018, 0): _u8(4),
        (0x1018, 1): _u32(VENDOR_ID),
        (0x1018, 2): _u32(PRODUCT_CODE),
        (0x1018, 3): _u32(0x0001_0000),
        (0x1018, 4): _u32(1000 + drive.node),
        (0x2010, 0): _u8(EXTRAPOLATED_PERIODS),  # missed set-points bridged before the quick stop
        (0x6007, 0): _i16(3),  # lost communication: quick stop
        (0x605A, 0): _i16(6),  # quick stop: its own ramp, then stay in quick stop active
        (0x6060, 0): _i8(8),  # cyclic synchronous position
        (0x6061, 0): _i8(8),
        (0x6065, 0): _u32(round(FOLLOWING_FAULT_RAD * COUNTS_PER_RAD)),
        (0x6066, 0): _u16(round(FOLLOWING_FAULT_S * 1e3)),
        (0x6072, 0): _u16(1000),  # maximum torque [permille of rated]
        (0x6076, 0): _u32(round(p.tau_max * 1e3)),  # rated torque [mN·m]
        (0x607D, 0): _u8(2),
        (0x607D, 1): _i32(low),
        (0x607D, 2): _i32(high),
        (0x6080, 0): _u32(speed),  # maximum speed, in the units of the bus
        (0x6085, 0): _u32(round(p.quick_stop_deceleration / VELOCITY_UNIT)),
        (0x60C2, 0): _u8(2),
        (0x60C2, 1): _u8(tick_ns // 1_000_000),
        (0x60C2, 2): _i8(-3),
        (0x6502, 0): _u32(1 << 7),  # offers CSP
    }


class SdoServers:
    """Answers SDO requests for all drives; one transfer at a time per drive, as CiA 301 has it."""

    def __init__(
        self,
        drives: Sequence[Drive],
        arm: ArmDescription,
        tick_ns: int,
        is_stopped: Callable[[int], bool] = lambda node: False,
    ) -> None:
        """Serve ``drives``, which keep being read at every request, except nodes that the network has stopped."""
        self._is_stopped = is_stopped
        self.changes: dict[int, Entries] = {}  # node -> entries that differ, for tests and trials
        self._drives = {drive.node: drive for drive in drives}
        self._arm, self._tick_ns = arm, tick_ns
        # node -> rest of a segmented value, expected toggle, its entry
        self._left: dict[int, tuple[bytes, int, tuple[int, int]]] = {}

    def answer(self, can_id: int, packet: bytes) -> list[bytes]:
        """The answer to one frame off the wire; empty if it is none of ours."""
        node = can_id - sdo.REQUEST_ID
        payload = packet[8 : 8 + packet[4]]
        if node not in self._drives or len(payload) != 8 or self._is_stopped(node):
            return []
        if payload[0] & 0xE0 == sdo.ABORT:  # of the client, confirmed by nobody (CiA 301, abort SDO transfer)
            self._left.pop(node, None)
            return []
        return [CanFrame(sdo.RESPONSE_ID + node, self._reply(node, payload)).pack()]

    def _reply(self, node: int, payload: bytes) -> bytes:
        command, index, subindex, _ = sdo.unpack_head(payload)
        kind = command & 0xE0
        if kind == sdo.UPLOAD:
            return self._upload(node, index, subindex)
        if kind == sdo.UPLOAD_SEGMENT:
            return self._segment(node, command & sdo.TOGGLE)
        code = sdo.READ_ONLY if kind == sdo.DOWNLOAD else sdo.BAD_COMMAND
        return _abort(index, subindex, code)

    def _upload(self, node: int, index: int, subindex: int) -> bytes:
        self._left.pop(node, None)
        known = entries(self._drives[node], self._arm, self._tick_ns) | self.changes.get(node, {})
        value = known.get((index, subindex))
        if value is None:
            exists = any(i == index for i, _ in known)
            return _abort(index, subindex, sdo.NO_SUBINDEX if exists else sdo.NO_OBJECT)
        if len(value) > 4:
            self._left[node] = (value, 0, (index, subindex))
        return sdo.upload_response(index, subindex, value)

    def _segment(self, node: int, toggle: int) -> bytes:
        left = self._left.pop(node, None)
        if left is None:
            return _abort(0, 0, sdo.BAD_COMMAND)
        rest, expected, entry = left
        if toggle != expected:
            return _abort(*entry, sdo.BAD_TOGGLE)
        part, rest = rest[:7], rest[7:]
        if rest:
            self._left[node] = (rest, toggle ^ sdo.TOGGLE, entry)
        return sdo.segment(toggle, part, not rest)


def _abort(index: int, subindex: int, code: int) -> bytes:
    return sdo.pack_head(sdo.ABORT, index, subindex, _u32(code))


def _u8(value: int) -> bytes:
    return struct.pack("<B", value)


def _i8(value: int) -> bytes:
    return struct.pack("<b", value)


def _u16(value: int) -> bytes:
    return struct.pack("<H", value)


def _i16(value: int) -> bytes:
    return struct.pack("<h", value)


def _u32(value: int) -> bytes:
    return struct.pack("<I", value)


def _i32(value: int) -> bytes:
    return struct.pack("<i", value)
