"""Seven CANopen drives behind the classical packing: RPDO1 and SYNC in; TPDO1, TPDO2, EMCY, heartbeat out.

The drives start themselves (0x1F80 bit 2 clear): after boot-up they are operational; NMT commands are obeyed.
"""

from __future__ import annotations

from s2r_protocol.can import classic
from s2r_protocol.can.drive import (
    CW_FAULT_RESET,
    STATUSWORD,
    SW_BRAKE_RELEASED,
    SW_ESTOP_1,
    SW_ESTOP_2,
    SW_FOLLOWING_ERROR,
    SW_FOLLOWS,
    SW_REMOTE,
    SW_WARNING,
    DriveCommand,
    DriveError,
    DriveState,
    command_of,
    emergency_code,
)
from s2r_protocol.can.frames import CAN_SFF_MASK, CanFrame
from s2r_sim.drives import Drive

_NMT = {
    classic.NMT_START: classic.HEARTBEAT_OPERATIONAL,
    classic.NMT_STOP: classic.HEARTBEAT_STOPPED,
    classic.NMT_PRE_OPERATIONAL: classic.HEARTBEAT_PRE_OPERATIONAL,
    classic.NMT_RESET_NODE: classic.HEARTBEAT_OPERATIONAL,
}


class ClassicNodes:
    """Frames in, frames out. RPDO1 is latched at the SYNC, as transmission type 1 asks.

    Attributes:
        sync_id: The frame that begins a period.
        answers_by_identifier: Answers come by rising identifier.
        refused: Frames ignored because of their length.
    """

    sync_id = classic.SYNC_ID
    answers_by_identifier = False
    tick_ns = classic.TICK_NS

    def __init__(self, drives: list[Drive]) -> None:
        self.drives = drives
        self.refused = 0
        self.master_tick = 0  # SYNCs seen
        self._nmt = [classic.HEARTBEAT_OPERATIONAL] * len(drives)
        self._latched: list[bytes | None] = [None] * len(drives)
        self._periods = 0
        self._answer_due = False
        self._outbox = [self._boot_up(drive) for drive in drives]

    def receive(self, can_id: int, packet: bytes) -> None:
        """Take a frame off the wire."""
        payload = packet[8 : 8 + packet[4]]
        if can_id == classic.SYNC_ID:
            self._sync()
        elif can_id == classic.NMT_ID:
            self._network(payload)
        elif classic.RPDO1_ID < can_id <= classic.RPDO1_ID + len(self.drives):
            if len(payload) == classic.RPDO1.size:
                self._latched[(can_id & CAN_SFF_MASK) - classic.RPDO1_ID - 1] = payload
            else:
                self.refused += 1

    @staticmethod
    def counter_of(packet: bytes) -> bytes:
        """The counter in a SYNC frame."""
        return packet[8:9]

    def forget_master(self) -> None:
        """Nothing is remembered of a master but its SYNCs."""

    def answers(self) -> list[bytes]:
        """Frames the drives send in this period."""
        self._periods += 1
        if self._periods % (classic.HEARTBEAT_NS // classic.TICK_NS) == 0:
            self._outbox += [
                self._frame(classic.HEARTBEAT_ID + d.node, bytes([nmt]))
                for d, nmt in zip(self.drives, self._nmt, strict=True)
            ]
        for drive in self.drives:
            self._outbox += [self._emergency(drive, error) for error in drive.emergencies]
            drive.emergencies.clear()
        if self._answer_due:
            self._answer_due = False
            for drive, nmt in zip(self.drives, self._nmt, strict=True):
                if nmt == classic.HEARTBEAT_OPERATIONAL:
                    self._outbox += self._process_data(drive)
        outbox, self._outbox = self._outbox, []
        return outbox

    def _sync(self) -> None:
        self.master_tick += 1
        self._answer_due = True
        for i, (drive, payload) in enumerate(zip(self.drives, self._latched, strict=True)):
            self._latched[i] = None
            if payload is None or self._nmt[i] != classic.HEARTBEAT_OPERATIONAL:
                continue
            command = classic.unpack_rpdo1(payload)
            drive.command(command_of(command.controlword), bool(command.controlword & CW_FAULT_RESET))
            drive.set_point(command.q, command.dq, 0.0)

    def _network(self, payload: bytes) -> None:
        if len(payload) != 2:
            self.refused += 1
            return
        command, node = payload
        state = _NMT.get(command)
        for i, drive in enumerate(self.drives):
            if state is None or node not in (0, drive.node):
                continue
            self._nmt[i] = state
            if command == classic.NMT_RESET_NODE:
                drive.restart()
                self._outbox.append(self._boot_up(drive))
            elif state != classic.HEARTBEAT_OPERATIONAL:
                drive.command(DriveCommand.DISABLE_VOLTAGE)

    def _boot_up(self, drive: Drive) -> bytes:
        return self._frame(classic.HEARTBEAT_ID + drive.node, bytes([classic.HEARTBEAT_BOOT]))

    def _process_data(self, drive: Drive) -> list[bytes]:
        position = classic.pack_tpdo1(
            classic.Position(_statusword(drive), drive.q_meas, drive.following_error)
        )
        frames = [self._frame(classic.TPDO1_ID + drive.node, position)]
        if self.master_tick % classic.TPDO2_EVERY == 0:
            health = classic.Health(drive.tau_meas, emergency_code(drive.error), drive.temp_C)
            frames.append(self._frame(classic.TPDO2_ID + drive.node, classic.pack_tpdo2(health)))
        return frames

    def _emergency(self, drive: Drive, error: DriveError) -> bytes:
        payload = classic.EMCY.pack(emergency_code(error), 0x01, bytes(5))
        return self._frame(classic.EMCY_ID + drive.node, payload)

    @staticmethod
    def _frame(can_id: int, payload: bytes) -> bytes:
        return CanFrame(can_id, payload).pack()


def _statusword(drive: Drive) -> int:
    word = STATUSWORD[drive.state] | SW_REMOTE
    if drive.brake_released:
        word |= SW_BRAKE_RELEASED
    if drive.following_warning:
        word |= SW_WARNING | SW_FOLLOWING_ERROR
    if drive.state == DriveState.OPERATION_ENABLED:
        word |= SW_FOLLOWS
    word |= (SW_ESTOP_1 if drive.estop_open & 1 else 0) | (SW_ESTOP_2 if drive.estop_open & 2 else 0)
    if drive.error == DriveError.FOLLOWING:
        word |= SW_FOLLOWING_ERROR
    return word
