"""The core in virtual time, plans that are easy to reason about, and the arm of the project."""

from __future__ import annotations

import functools
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from s2r_executor.admission import Admission
from s2r_executor.config import AdmissionConfig, CoreConfig, load_config
from s2r_executor.core_process import core_settings
from s2r_executor.plan import PlanRequest
from s2r_protocol.arms import load_arm
from s2r_protocol.can.frames import CanFrame
from s2r_protocol.faults import ExecutorState
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_sim.bus.fd_nodes import FdNodes
from s2r_sim.drives_alone import DrivesAlone

TICK_NS = 1_000_000


def atomic(method):
    """Holds the core's lock: the front end asks from one thread while a test advances from another."""

    @functools.wraps(method)
    def held(self, *args, **kwargs):
        with self._lock:
            return method(self, *args, **kwargs)

    return held


class SteppedCore:
    """The native core on the stand-in's drives; time moves, a tick per millisecond, only when told to advance.

    What the front end asks of it is passed on and remembered. A full ring is the only thing that is made up here.
    """

    def __init__(self, arm) -> None:
        from s2r_executor import _native

        config = load_config(
            overrides={"bus": "unix:none", "clock": "lockstep", "core.collision_share": 10.0}
        )
        self._lock = threading.RLock()
        self._shared = _native.Shared.create(core_settings(config, arm))
        self._core = _native.Core(self._shared)
        self._plant = DrivesAlone(arm)
        self._nodes = FdNodes(self._plant.drives)
        self._answers: list[tuple[int, bytes, bool]] = []
        self._now_ns = 0
        self.drives = self._plant.drives
        self.beats = 0
        self.commands: list[tuple[int, int, float]] = []
        self.submitted: list[SimpleNamespace] = []
        self.ring_full = False
        self.advance(3)

    # -- what tests do with it ------------------------------------------------------------------------

    @atomic
    def advance(self, ticks: int = 1) -> None:
        """Time goes on; the front end's process lives all the while."""
        for _ in range(ticks if self._core is not None else 0):
            self._shared.beat()
            self._now_ns += TICK_NS
            for can_id, data, fd in self._core.step(self._answers, self._now_ns):
                self._nodes.receive(can_id, CanFrame(can_id, data, is_fd=fd, brs=True).pack())
            self._plant.advance(TICK_NS)
            answers = (CanFrame.unpack(packet) for packet in self._nodes.answers())
            self._answers = [(frame.can_id, frame.data, frame.is_fd) for frame in answers]

    def until(self, *states: ExecutorState, ticks: int = 5000) -> None:
        """Advance to one of these states."""
        for _ in range(ticks):
            if self.state in states:
                return
            self.advance()
        raise AssertionError(f"{self.state.name} after {ticks} ticks")

    def arm(self) -> None:
        """From DISARMED to HOLD, without a front end."""
        self._shared.command(pb.ARM, self.epoch)
        self.until(ExecutorState.HOLD)

    @atomic
    def die(self) -> None:
        """The process ends."""
        self._core = None

    @property
    def state(self) -> ExecutorState:
        return ExecutorState(self.snapshot().state)

    @property
    def q(self) -> np.ndarray:
        return np.asarray(self.snapshot().q_ref)

    def __getattr__(self, name):
        """Fields of the snapshot: epoch, cause, tick, plan_id, plan_t, plan_done, speed_set."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.snapshot(), name)

    # -- what the front end does with it --------------------------------------------------------------

    @property
    def records_dropped(self) -> int:
        return self._shared.records_dropped

    @atomic
    def beat(self):
        self.beats += 1
        self._shared.beat()

    @atomic
    def submit_plan(self, plan_id, epoch, *arrays, **more):
        if self.ring_full:
            return False
        self.submitted.append(SimpleNamespace(plan_id=plan_id, epoch=epoch, stop_duration=arrays[4], **more))
        return self._shared.submit_plan(plan_id, epoch, *arrays, **more)

    @atomic
    def command(self, kind, epoch, value=0.0):
        if self.ring_full:
            return False
        self.commands.append((kind, epoch, value))
        return self._shared.command(kind, epoch, value)

    @atomic
    def records(self, max_records=8192):
        return self._shared.records(max_records)

    @atomic
    def events(self, max_events=1024):
        return self._shared.events(max_events)

    @atomic
    def snapshot(self):
        return self._shared.snapshot()


@pytest.fixture(scope="session")
def arm():
    return load_arm("xmate3pro")


@pytest.fixture(scope="session")
def admission(arm):
    return Admission(arm, AdmissionConfig(), CoreConfig())


@pytest.fixture
def core(arm):
    return SteppedCore(arm)


@pytest.fixture(scope="session")
def smooth_plan(arm):
    """Factory of minimum-jerk moves from home."""

    def make(step=(0.3, 0.2, -0.2, -0.2, 0.3, 0.2, 0.4), duration_s=2.0, knots=12, start=None, **more):
        t = np.linspace(0.0, duration_s, knots)
        x = t / duration_s
        delta = np.array(step, float)
        s, ds = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / duration_s
        dds = 60 * x * (1 - x) * (1 - 2 * x) / duration_s**2
        q0 = arm.q_home if start is None else start
        return PlanRequest(
            arm.joint_names,
            t,
            q0 + s[:, None] * delta,
            ds[:, None] * delta,
            dds[:, None] * delta,
            **more,
        )

    return make
