"""Seven CANopen drives behind the classical packing: RPDO1 and SYNC in; TPDO1, TPDO2, EMCY, heartbeat out.

The drives start themselves (0x1F80 bit 2 clear): after boot-up they are operational; NMT commands are obeyed. One that
is stopped makes a quick stop (0x6007) and keeps its newest emergency for later; one that is pre-operational hears no
set-points any more, which its own watchdog notices.
"""

from __future__ import annotations

from s2r_protocol.can import classic
from s2r_protocol.can.drive import (
    CW_FAULT_RESET,
    PDO_TOO_LONG,
    PDO_TOO_SHORT,
    STATUSWORD,
    SW_BRAKE_RELEASED,
    SW_ESTOP_1,
    SW_ESTOP_2,
    SW_FOLLOWING_ERROR,
    SW_FOLLOWS,
    SW_REMOTE,
    SW_WARNING,
    DriveError,
    DriveState,
    command_of,
    emergency_code,
    error_register,
)
from s2r_protocol.can.frames import CAN_SFF_MASK, CanFrame
from s2r_sim.drives import Drive

_NMT = {
    classic.NMT_START: classic.HEARTBEAT_OPERATIONAL,
    classic.NMT_STOP: classic.HEARTBEAT_STOPPED,
    classic.NMT_PRE_OPERATIONAL: classic.HEARTBEAT_PRE_OPERATIONAL,
    classic.NMT_RESET_NODE: classic.HEARTBEAT_OPERATIONAL,
    classic.NMT_RESET_COMMUNICATION: classic.HEARTBEAT_OPERATIONAL,
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
        self.master_tick = 0  # SYNCs of the newest master
        self._another_master = False
        self._nmt = [classic.HEARTBEAT_OPERATIONAL] * len(drives)
        self._latched: list[bytes | None] = [None] * len(drives)
        self._emergencies: list[list[int]] = [[] for _ in drives]  # error codes that are not sent yet
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
            self._targets((can_id & CAN_SFF_MASK) - classic.RPDO1_ID - 1, payload)

    def is_stopped(self, node: int) -> bool:
        """Whether a node speaks of nothing but its heartbeat."""
        return self._nmt[node - 1] == classic.HEARTBEAT_STOPPED

    def _targets(self, i: int, payload: bytes) -> None:
        """Take RPDO1. One that is too short is not processed, of a longer one the first bytes are (CiA 301)."""
        if self._nmt[i] != classic.HEARTBEAT_OPERATIONAL:
            return
        size, drive = classic.RPDO1.size, self.drives[i]
        wrong = PDO_TOO_SHORT if len(payload) < size else PDO_TOO_LONG if len(payload) > size else 0
        self.refused += wrong == PDO_TOO_SHORT
        if wrong != PDO_TOO_SHORT:
            self._latched[i] = payload[:size]
        if wrong != drive.pdo_error:
            drive.pdo_error = wrong
            self._emergencies[i].append(wrong)

    @staticmethod
    def counter_of(packet: bytes) -> bytes:
        """The counter in a SYNC frame."""
        return packet[8:9]

    def forget_master(self) -> None:
        """The next SYNC is another master's first."""
        self._another_master = True

    def answers(self) -> list[bytes]:
        """Frames the drives send in this period."""
        self._periods += 1
        if self._periods % (classic.HEARTBEAT_NS // classic.TICK_NS) == 0:
            self._outbox += [
                self._frame(classic.HEARTBEAT_ID + d.node, bytes([nmt]))
                for d, nmt in zip(self.drives, self._nmt, strict=True)
            ]
        for i, drive in enumerate(self.drives):
            self._tell_emergencies(i, drive)
        if self._answer_due:
            self._answer_due = False
            for drive, nmt in zip(self.drives, self._nmt, strict=True):
                if nmt == classic.HEARTBEAT_OPERATIONAL:
                    self._outbox += self._process_data(drive)
        outbox, self._outbox = self._outbox, []
        return outbox

    def _sync(self) -> None:
        if self._another_master:
            self.master_tick, self._another_master = 0, False
        self.master_tick += 1
        self._answer_due = True
        for i, (drive, payload) in enumerate(zip(self.drives, self._latched, strict=True)):
            self._latched[i] = None
            if payload is None:
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
            if state != classic.HEARTBEAT_OPERATIONAL or command != classic.NMT_START:
                self._latched[i] = None
            if command == classic.NMT_RESET_NODE:
                drive.restart()
                self._emergencies[i].clear()
            elif command in (classic.NMT_STOP, classic.NMT_RESET_COMMUNICATION):
                drive.lose_master()
            if command in (classic.NMT_RESET_NODE, classic.NMT_RESET_COMMUNICATION):
                self._outbox.append(self._boot_up(drive))

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

    def _tell_emergencies(self, i: int, drive: Drive) -> None:
        waiting = self._emergencies[i]
        waiting += [emergency_code(error) for error in drive.emergencies]
        drive.emergencies.clear()
        if self._nmt[i] == classic.HEARTBEAT_STOPPED:
            del waiting[:-1]
            return
        register = error_register(drive.error, drive.pdo_error)
        self._outbox += [
            self._frame(classic.EMCY_ID + drive.node, classic.EMCY.pack(code, register, bytes(5)))
            for code in waiting
        ]
        waiting.clear()

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
