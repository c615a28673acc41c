"""Seven drives behind the CAN FD packing: one SET in, one STAT from each out."""

from __future__ import annotations

import struct
from binascii import crc_hqx
from itertools import product

from s2r_protocol.can import fd
from s2r_protocol.can.drive import (
    BRAKE_RELEASED,
    ESTOP_SHIFT,
    FOLLOWING_WARNING,
    Control,
    DriveCommand,
    DriveState,
)
from s2r_protocol.can.frames import CANFD_BRS, CANFD_FDF, FD_BYTES
from s2r_protocol.can.units import COUNTS_PER_RAD, TORQUE_UNIT, VELOCITY_UNIT, saturated_i16
from s2r_sim.drives import Drive

_HEADER = struct.Struct("<IBBBB")
_TAIL = struct.Struct(f"<H{FD_BYTES - _HEADER.size - fd.STAT.size}x")  # checksum, padding
_NODE = [bytes((node,)) for node in range(256)]
_CONTROLS = frozenset(Control)
_SWITCHED_ON = frozenset({DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED})
_STAY = {
    DriveState.READY_TO_SWITCH_ON: DriveCommand.SHUTDOWN,
    DriveState.QUICK_STOP_ACTIVE: DriveCommand.QUICK_STOP,
}  # the command that leaves a drive where it is; DISABLE_VOLTAGE in the others


def _command(control: Control, rising: bool, state: DriveState) -> DriveCommand:
    """What a control asks of a drive in this state; ``rising``: the SET before had another one."""
    match control:
        case Control.SWITCH_ON:  # includes the step that the state machine wants first
            off = state == DriveState.SWITCH_ON_DISABLED
            return DriveCommand.SHUTDOWN if off else DriveCommand.SWITCH_ON
        case Control.ENABLE if state == DriveState.OPERATION_ENABLED or (
            state == DriveState.SWITCHED_ON and rising
        ):
            return DriveCommand.ENABLE_OPERATION
        case Control.ENABLE | Control.DISABLE_OPERATION if state in _SWITCHED_ON:
            return DriveCommand.SWITCH_ON
        case Control.ENABLE | Control.DISABLE_OPERATION:
            return _STAY.get(state, DriveCommand.DISABLE_VOLTAGE)
        case Control.QUICK_STOP:
            return DriveCommand.QUICK_STOP
        case Control.DISABLE | Control.FAULT_RESET:
            return DriveCommand.DISABLE_VOLTAGE


_COMMANDS = {key: _command(*key) for key in product(Control, (False, True), DriveState)}


class FdNodes:
    """Frames in, frames out. A damaged or repeated SET is ignored: the watchdog then counts it as missing.

    Attributes:
        sync_id: The frame that begins a period.
        answers_by_identifier: Answers come by rising identifier.
        refused: SET frames ignored because of length, checksum, command or counter.
    """

    sync_id = fd.SET_ID
    answers_by_identifier = True
    tick_ns = fd.TICK_NS

    def __init__(self, drives: list[Drive]) -> None:
        self.drives = drives
        self.refused = 0
        self.master_tick = 0  # unwrapped from the 16 bits on the wire
        self._seq: int | None = None
        self._tick = 0
        self._control = Control.DISABLE
        self._answer_due = False
        self._headers = [
            _HEADER.pack(fd.STAT_ID + drive.node, fd.STAT.size, CANFD_FDF | CANFD_BRS, 0, 0)
            for drive in drives
        ]

    def receive(self, can_id: int, packet: bytes) -> None:
        """Take a frame off the wire."""
        if can_id != fd.SET_ID:
            return
        payload = packet[8 : 8 + packet[4]]
        if len(packet) != FD_BYTES or len(payload) != fd.SET.size:
            self.refused += 1
            return
        seq, ctrl, tick, crc, *slots = fd.SET.unpack(payload)
        if crc != fd.set_crc(payload) or ctrl not in _CONTROLS or seq == self._seq:
            self.refused += 1
            return
        if self._seq is None:
            self.master_tick = tick  # of a master that begins
        self._seq, self._tick = seq, tick
        self.master_tick += (tick - self.master_tick) & 0xFFFF
        self._answer_due = True
        control = Control(ctrl)
        rising, self._control = control != self._control, control
        for i, drive in enumerate(self.drives):
            drive.command(_COMMANDS[control, rising, drive.state], control == Control.FAULT_RESET)
            drive.set_point(
                slots[3 * i] / COUNTS_PER_RAD,
                slots[3 * i + 1] * VELOCITY_UNIT,
                slots[3 * i + 2] * TORQUE_UNIT,
            )

    @staticmethod
    def is_stopped(node: int) -> bool:
        """Never: this packing has no network management."""
        return False

    @staticmethod
    def counter_of(packet: bytes) -> bytes:
        """The counter in a SET frame as it came: bytes 2 and 3 of its payload."""
        return packet[10:12]

    def forget_master(self) -> None:
        """The next SET is another master's, and may carry any counter."""
        self._seq = None

    def answers(self) -> list[bytes]:
        """Frames the drives send after the period they were asked about."""
        if not self._answer_due:
            return []
        self._answer_due = False
        return [self._stat(drive, header) for drive, header in zip(self.drives, self._headers, strict=True)]

    def _stat(self, drive: Drive, header: bytes) -> bytes:
        state = int(drive.state)
        if drive.brake_released:
            state |= BRAKE_RELEASED
        if drive.following_warning:
            state |= FOLLOWING_WARNING
        state |= drive.estop_open << ESTOP_SHIFT
        body = fd.STAT_BODY.pack(
            self._seq or 0,
            state,
            round(drive.q_meas * COUNTS_PER_RAD),
            saturated_i16(drive.dq_meas / VELOCITY_UNIT),
            saturated_i16(drive.tau_meas / TORQUE_UNIT),
            self._tick,
            drive.error,
            drive.temp_C,
        )
        crc = crc_hqx(_NODE[drive.node], crc_hqx(body, 0xFFFF))
        return header + body + _TAIL.pack(crc)
