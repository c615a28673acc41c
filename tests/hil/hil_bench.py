"""The bench of the HIL tests: the real ``s2r-rt`` in lock-step on the stand-in's bus model, everything else here.

One thread moves time. :meth:`Bench.step` answers the setpoint that waits and returns when the next one has come, so the
core sleeps while a test looks around, and what a test orders is taken at the next tick: the same script gives the
same bytes. Time is virtual; a busy machine only makes it slower.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from s2r_executor import _native
from s2r_executor.core_process import native_executable
from s2r_protocol.arms import load_arm
from s2r_protocol.can.frames import CanFrame, connect_unix
from s2r_protocol.can.timing import BitRate
from s2r_sim.bus import oracle
from s2r_sim.bus.bus import Bus
from s2r_sim.bus.classic_nodes import ClassicNodes
from s2r_sim.bus.fd_nodes import FdNodes
from s2r_sim.bus.hub import Client, Hub
from s2r_sim.bus.log import BusLog
from s2r_sim.bus.wire import Injection, Wire
from s2r_sim.drives_alone import DrivesAlone

ARM = load_arm("xmate3pro")
DOF = ARM.dof
LIMITS = oracle.Limits(
    ARM.limits.q_min, ARM.limits.q_max, ARM.limits.dq_max, ARM.limits.ddq_max, ARM.limits.dddq_max
)
ARM_, DISARM, STOP, PAUSE, RESUME, SET_SPEED, RESET = range(1, 8)
QUIT = 100
STATE, STARTED, DONE, REJECTED, STOP_BEGUN, STOP_DONE, GATE_TRIP, OVERRUN, WATCHDOG, DRIVE, LATCH, INFO = (
    range(1, 13)
)
DEADLINE_S = 60.0


@dataclass(frozen=True)
class Plan:
    """Knots and stops as the core wants them."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    stop_duration: np.ndarray


def move(
    start: np.ndarray, distance: float = 0.5, duration_s: float = 1.4, knots: int = 15, stop_s: float = 0.5
) -> Plan:
    """A minimum-jerk move of every joint, each by another amount, well inside the limits, stops included."""
    t = np.linspace(0.0, duration_s, knots)
    x = t / duration_s
    s, ds = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / duration_s
    dds = 60 * x * (1 - x) * (1 - 2 * x) / duration_s**2
    gains = distance * np.array([1.0, -0.7, 0.9, -0.8, 1.0, -0.9, 1.0])
    return Plan(
        t, start + s[:, None] * gains, ds[:, None] * gains, dds[:, None] * gains, np.full(knots - 1, stop_s)
    )


class Bench:
    """One executor core process, its bus and its drives."""

    def __init__(
        self, folder: Path, packing: str = "fd", env: dict[str, str] | None = None, **config: object
    ) -> None:
        self.packing = packing
        self.plant = DrivesAlone(ARM)
        nodes = (FdNodes if packing == "fd" else ClassicNodes)(self.plant.drives)
        self.address = f"unix:{folder}/bus-{len(list(folder.glob('bus-*')))}"
        self.hub = Hub(self.address)
        self.wire = Wire(nodes.tick_ns, BitRate())
        self.bus = Bus(self.hub, self.wire, nodes, self.plant)
        self.bus.announces_periods = True
        self.log = BusLog()
        self.bus.taps.append(self.log)
        self.settings = {
            "dof": DOF,
            "tick_ns": nodes.tick_ns,
            "packing": packing,
            "bus": self.address,
            "clock": "lockstep",
            "pace": 0.0,
            "answer_timeout_s": DEADLINE_S,
            **ARM.limits.as_dict(),
            **config,
        }
        self.beats = self.takes_events = True
        self.arm_ticks: list[int] = []
        self.motion_ticks: list[int] = []
        self.orders: list[tuple] = []  # everything ordered, for replays
        self._env = env
        self._waiting: deque[tuple[Client, bytes]] = deque()
        self._events: list = []
        self._others: list[socket.socket] = []
        self._other_numbers: set[int] = set()
        self.start()

    def start(self) -> None:
        """Start a core; time begins with its first setpoint."""
        self.master = 0  # its number as a client of the bus
        self.shared = _native.Shared.create(self.settings)
        self.child = subprocess.Popen(
            [native_executable(), "--shm-fd", str(self.shared.fd)],
            pass_fds=[self.shared.fd],
            stderr=subprocess.PIPE,
            env={**os.environ, **(self._env or {})},
        )
        self.shared.beat()
        self._receive()

    # -- time -----------------------------------------------------------------------------------------

    @property
    def tick(self) -> int:
        """Of the setpoint that waits for its answers."""
        return self.shared.snapshot().tick

    @property
    def now(self):
        """The core's snapshot; its tick's setpoint has left, its answers have not come."""
        return self.shared.snapshot()

    def _receive(self) -> None:
        """Until the master's next SET or SYNC has come; it stays unanswered."""
        deadline = time.monotonic() + DEADLINE_S
        while not self._waiting:
            for client, packet in self.hub.receive(0.5):
                self._take(client, packet)
            if not self._waiting and self.child.poll() is not None:
                return
            assert time.monotonic() < deadline, "the core sends nothing"
        # The setpoint leaves before the state is published.
        counter = self.bus.nodes.counter_of(self._waiting[-1][1])
        while self._behind(int.from_bytes(counter, "little")):
            assert time.monotonic() < deadline, "the core publishes nothing"

    def _behind(self, counter: int) -> bool:
        """The published tick is older than this counter on the wire."""
        tick = self.shared.snapshot().tick
        ahead, modulo = (tick - counter, 1 << 16) if self.packing == "fd" else (1 + tick - counter, 240)
        return ahead % modulo > modulo // 2

    def _take(self, client: Client, packet: bytes | None) -> None:
        if packet is None:
            self.bus._master_left(client)
            return
        if client.number in self._other_numbers or not self.bus._begins_period(packet):
            self.bus.take(client, packet)
            return
        self.master = self.master or client.number
        self._waiting.append((client, packet))

    def step(self, ticks: int = 1, each: Callable[[], None] | None = None) -> None:
        """Answer setpoints; ``each`` runs before every tick."""
        for _ in range(ticks):
            if each is not None:
                each()
            if self.beats:
                self.shared.beat()
            if not self._waiting:
                self._receive()
            if not self._waiting:
                return  # the core has ended
            self.bus.take(*self._waiting.popleft())
            self._receive()
            if self.takes_events:
                self._events += list(self.shared.events())

    def until(self, condition: Callable, ticks: int = 6000, each: Callable[[], None] | None = None):
        """Step until the condition of a snapshot holds."""
        for _ in range(ticks):
            snapshot = self.now
            if condition(snapshot):
                return snapshot
            self.step(1, each)
        raise AssertionError(f"state {snapshot.state}, cause {snapshot.cause} after {ticks} ticks")

    # -- orders ---------------------------------------------------------------------------------------

    def command(self, kind: int, value: float = 0.0, epoch: int | None = None) -> None:
        now = self.now
        if kind == ARM_:
            self.arm_ticks.append(now.tick)
        if kind in (RESUME, SET_SPEED):
            self.motion_ticks.append(now.tick)
        epoch = now.epoch if epoch is None else epoch
        self.orders.append((now.tick, "command", kind, epoch, value))
        assert self.shared.command(kind, epoch, value)

    def submit(self, plan: Plan, plan_id: int = 1, epoch: int | None = None, **more: object) -> None:
        now = self.now
        self.motion_ticks.append(now.tick)
        epoch = now.epoch if epoch is None else epoch
        self.orders.append((now.tick, "plan", plan, plan_id, epoch, more))
        assert self.shared.submit_plan(
            plan_id, epoch, plan.t, plan.q, plan.dq, plan.ddq, plan.stop_duration, 0.0, 0.0, **more
        )

    def arm(self) -> None:
        """DISARMED to HOLD."""
        self.step(3)
        self.command(ARM_)
        self.until(lambda s: s.state == 3, 2500)

    def run(self, plan: Plan | None = None, plan_id: int = 1) -> Plan:
        """Start a plan from HOLD."""
        plan = plan or move(np.asarray(self.now.q_ref))
        self.submit(plan, plan_id)
        self.step(2)
        assert self.now.state == 4, self.events()
        return plan

    def moving(self, ticks: int = 600) -> Plan:
        """In the middle of a plan."""
        self.arm()
        plan = self.run()
        self.step(ticks)
        return plan

    # -- faults ---------------------------------------------------------------------------------------

    def inject(self, text: str) -> None:
        """Disturb the wire; ticks are the bus's."""
        self.wire._injections.append(Injection.parse(text))

    def lose(self, can_id: int | str, periods: int, action: str = "drop") -> None:
        """Disturb one identifier for the coming periods."""
        first = self.bus.ticks
        self.inject(
            f"{action}:{can_id if isinstance(can_id, str) else hex(can_id)}@{first}-{first + periods - 1}"
        )

    def join(self) -> socket.socket:
        """One more node on the bus."""
        known = {c.number for c in self.hub.clients}
        node = connect_unix(self.address)
        self._others.append(node)
        while not (new := {c.number for c in self.hub.clients} - known):
            for client, packet in self.hub.receive(0.5):
                self._take(client, packet)
        self._other_numbers |= new
        return node

    def say(self, frame: CanFrame) -> None:
        """The bus's controller tells everybody: error frames."""
        self.hub.broadcast(frame.pack())

    # -- what happened --------------------------------------------------------------------------------

    def events(self, kind: int | None = None) -> list:
        """So far, oldest first."""
        if self.takes_events:
            self._events += list(self.shared.events())
        return [e for e in self._events if kind is None or e["kind"] == kind]

    def trace(self, master: int | None = None) -> oracle.Trace:
        """What the core has put on the bus."""
        return oracle.read_fd(self.log.frames(), DOF, self.master if master is None else master)

    def judge(
        self, stop: oracle.Stop | None = None, gaps_allowed: bool = False, master: int | None = None
    ) -> oracle.Report:
        """The oracle's verdict so far; fails the test on a violation."""
        report = oracle.judge(
            self.trace(master), LIMITS, stop, self.arm_ticks, self.motion_ticks, gaps_allowed=gaps_allowed
        )
        assert not report.violations, str(report)
        return report

    def one_cause(self, cause: int, joint: int | None = None) -> None:
        """I4: exactly one stop was begun, for this cause."""
        begun = [(int(e["cause"]), int(e["joint"])) for e in self.events(STOP_BEGUN)]
        assert [c for c, _ in begun] == [cause], begun
        if joint is not None:
            assert begun[0][1] == joint

    def close(self) -> None:
        """End everything."""
        if self.child.poll() is None:
            self.child.send_signal(signal.SIGKILL)
        self.child.wait()
        self.child.stderr.close()
        for node in self._others:
            node.close()
        self.hub.close()


class Stepped:
    """The same core class and drives in this process, without sockets: for late wake-ups, wraps and long sweeps."""

    def __init__(self, first_tick: int = 0, **config: object) -> None:
        self.plant = DrivesAlone(ARM)
        self.nodes = FdNodes(self.plant.drives)
        settings = {
            "dof": DOF,
            "tick_ns": 1_000_000,
            "packing": "fd",
            "bus": "unix:/none",
            "clock": "lockstep",
        }
        self.shared = _native.Shared.create({**settings, **ARM.limits.as_dict(), **config})
        self.core = _native.Core(self.shared, first_tick)
        self._offset = (first_tick & 0xFFFF) - first_tick  # a trace counts from what it sees first, 16 bits
        self.now_ns = 0
        self.beats = True
        self.arm_ticks: list[int] = []
        self.motion_ticks: list[int] = []
        self.drive_setpoints: list[list[float]] = []
        self._rows: list[tuple[int, int, bytes]] = []
        self._answers: list[tuple[int, bytes, bool]] = []
        self._events: list = []

    @property
    def now(self):
        """The core's snapshot."""
        return self.shared.snapshot()

    def step(self, ticks: int = 1, skipped: int = 0, send_fails: bool = False) -> None:
        """Time goes on; ``skipped`` ticks are lost before each of these."""
        for _ in range(ticks):
            if self.beats:
                self.shared.beat()
            for _ in range(skipped):
                self._period()
            self.now_ns += 1_000_000 * (1 + skipped)
            for can_id, data, fd in self.core.step(self._answers, self.now_ns, skipped, send_fails):
                packet = CanFrame(can_id, data, is_fd=fd, brs=True).pack()
                self._rows.append((self.now_ns, 1, packet))
                self.nodes.receive(can_id, packet)
            self._answers = []
            self._period()
            if len(self._events) < 100_000:
                self._events += list(self.shared.events())
                self.shared.records()

    def _period(self) -> None:
        self.plant.advance(1_000_000)
        self.drive_setpoints.append([d._q_to for d in self.plant.drives])
        for packet in self.nodes.answers():
            self._rows.append((self.now_ns, 0, packet))
            frame = CanFrame.unpack(packet)
            self._answers.append((frame.can_id, frame.data, frame.is_fd))

    def until(self, condition: Callable, ticks: int = 6000):
        for _ in range(ticks):
            snapshot = self.now
            if condition(snapshot):
                return snapshot
            self.step()
        raise AssertionError(f"state {snapshot.state}, cause {snapshot.cause} after {ticks} ticks")

    def command(self, kind: int, value: float = 0.0) -> None:
        now = self.now
        if kind == ARM_:
            self.arm_ticks.append(now.tick)
        if kind in (RESUME, SET_SPEED):
            self.motion_ticks.append(now.tick)
        assert self.shared.command(kind, now.epoch, value)

    def submit(self, plan: Plan, plan_id: int = 1, **more: object) -> bool:
        now = self.now
        self.motion_ticks.append(now.tick)
        return self.shared.submit_plan(
            plan_id, now.epoch, plan.t, plan.q, plan.dq, plan.ddq, plan.stop_duration, 0.0, 0.0, **more
        )

    def moving(self, ticks: int = 600, plan: Plan | None = None) -> Plan:
        """Armed, and in the middle of a plan."""
        self.step(3)
        self.command(ARM_)
        self.until(lambda s: s.state == 3, 200)
        plan = plan or move(np.asarray(self.now.q_ref))
        assert self.submit(plan)
        self.step(1 + ticks)
        return plan

    def events(self, kind: int | None = None) -> list:
        self._events += list(self.shared.events())
        return [e for e in self._events if kind is None or e["kind"] == kind]

    def trace(self) -> oracle.Trace:
        log = BusLog()
        log._rows = self._rows
        return oracle.read_fd(log.frames(), DOF)

    def judge(self, stop: oracle.Stop | None = None, gaps_allowed: bool = False) -> oracle.Report:
        arms, motions = ([t + self._offset for t in ticks] for ticks in (self.arm_ticks, self.motion_ticks))
        report = oracle.judge(self.trace(), LIMITS, stop, arms, motions, gaps_allowed=gaps_allowed)
        assert not report.violations, str(report)
        return report
