"""A stand-in in a thread and a small bus master in Python, both on a real local socket."""

from __future__ import annotations

import threading
from contextlib import contextmanager

import pytest

from s2r_protocol.arms import load_arm
from s2r_protocol.can import classic, fd
from s2r_protocol.can.drive import CW_FAULT_RESET, Control, DriveCommand, DriveState
from s2r_protocol.can.frames import CanFrame, connect_unix
from s2r_protocol.can.timing import BitRate
from s2r_sim.bus.bus import Bus
from s2r_sim.bus.classic_nodes import ClassicNodes
from s2r_sim.bus.fd_nodes import FdNodes
from s2r_sim.bus.hub import Hub
from s2r_sim.bus.wire import Injection, Wire
from s2r_sim.plant import Plant
from s2r_sim.truth import TruthLog
from s2r_sim.world import draw_world

SEED = 7


@pytest.fixture(scope="session")
def arm():
    return load_arm("xmate3pro")


@pytest.fixture(scope="session")
def world():
    return draw_world(SEED, salt="test")


class FdMaster:
    """Speaks the FD packing in lock-step: one SET out, up to seven STATs in."""

    def __init__(self, address):
        self.socket = connect_unix(address)
        self.socket.settimeout(5.0)
        self.tick = 0
        self.q = [0.0] * 7

    def send(self, control, q=None, dq=None):
        self.tick += 1
        payload = fd.pack_set(self.tick, control, self.tick, self.q if q is None else q, dq)
        self.socket.send(fd.set_frame(payload).pack())

    def receive(self, count=7):
        frames = [self.next_frame() for _ in range(count)]
        return [fd.unpack_stat(f.data, f.can_id - fd.STAT_ID) for f in frames]

    def next_frame(self):
        """The next frame but the stand-in's word that a period is over."""
        while True:
            frame = CanFrame.unpack(self.socket.recv(128))
            if not (frame.is_error and frame.can_id == 0):
                return frame

    def cycle(self, control, q=None, dq=None):
        self.send(control, q, dq)
        return self.receive()

    def enable(self):
        self.q = [s.q_meas for s in self.cycle(Control.DISABLE)]
        for _ in range(3):
            self.cycle(Control.SWITCH_ON)
        for _ in range(100):
            answers = self.cycle(Control.ENABLE)
            if all(s.state == DriveState.OPERATION_ENABLED and s.brake_released for s in answers):
                return answers
        raise AssertionError(f"drives did not enable: {answers}")


class ClassicMaster:
    """Speaks the classical packing in lock-step: seven RPDO1 and a SYNC out, whatever comes in."""

    def __init__(self, address):
        self.socket = connect_unix(address)
        self.socket.settimeout(5.0)
        self.count = 0
        self.emergencies = []
        self.heartbeats = []
        self.health = {}

    def cycle(self, command, q, dq=None, fault_reset=False):
        word = int(command) | (CW_FAULT_RESET if fault_reset else 0)
        for i in range(7):
            payload = classic.pack_rpdo1(classic.Command(word, q[i], dq[i] if dq else 0.0))
            self.socket.send(CanFrame(classic.RPDO1_ID + i + 1, payload).pack())
        self.sync()
        answers = {}
        while len(answers) < 7:
            frame = CanFrame.unpack(self.socket.recv(128))
            base, node = frame.can_id & ~0x7F, frame.can_id & 0x7F
            if base == classic.TPDO1_ID:
                answers[node] = classic.unpack_tpdo1(frame.data)
            elif base == classic.TPDO2_ID:
                self.health[node] = classic.unpack_tpdo2(frame.data)
            elif base == classic.EMCY_ID:
                self.emergencies.append((node, classic.EMCY.unpack(frame.data)[0]))
            elif base == classic.HEARTBEAT_ID:
                self.heartbeats.append((node, frame.data[0]))
        return [answers[node] for node in range(1, 8)]

    def sync(self):
        self.count += 1
        self.socket.send(CanFrame(classic.SYNC_ID, bytes([1 + self.count % 240])).pack())

    def enable(self, q):
        for command in [DriveCommand.SHUTDOWN, DriveCommand.SWITCH_ON, *[DriveCommand.ENABLE_OPERATION] * 15]:
            answers = self.cycle(command, q)
        assert {a.state for a in answers} == {DriveState.OPERATION_ENABLED}
        return answers


@pytest.fixture
def stand_in(arm, world, tmp_path):
    """Start a stand-in: ``with stand_in(...) as bus`` yields the running bus; ``bus.address`` is where to join."""

    @contextmanager
    def start(packing="fd", clock="lockstep", pace=0.0, truth=None, injections=()):
        plant = Plant(arm, world)
        log = TruthLog(truth, plant) if truth is not None else None
        if log is not None:
            plant.observers.append(log)
        nodes = {"fd": FdNodes, "classic": ClassicNodes}[packing](plant.drives)
        address = f"unix:{tmp_path}/{packing}.sock"
        hub = Hub(address)
        wire = Wire(nodes.tick_ns, BitRate(), [Injection.parse(text) for text in injections])
        bus = Bus(hub, wire, nodes, plant)
        bus.address = address
        run = bus.run_lockstep if clock == "lockstep" else bus.run_real
        thread = threading.Thread(target=run, args=(pace,), daemon=True)
        thread.start()
        try:
            yield bus
        finally:
            bus.stop()
            thread.join(10.0)
            assert not thread.is_alive()
            hub.close()
            if log is not None:
                log.close()

    return start


@pytest.fixture
def fd_master():
    return FdMaster


@pytest.fixture
def classic_master():
    return ClassicMaster
