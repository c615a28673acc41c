"""A core without a bus, plans that are easy to reason about, and the arm of the project."""

from __future__ import annotations

import functools
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from s2r_executor.admission import Admission
from s2r_executor.config import AdmissionConfig
from s2r_executor.core import QUIT, EventKind
from s2r_executor.plan import PlanRequest
from s2r_executor.quintic import sample, spline_through
from s2r_protocol.arms import load_arm
from s2r_protocol.faults import Cause, ExecutorState, Refusal
from s2r_protocol.proto import s2r_pb2 as pb

DOF = 7
RECORD = np.dtype(
    [
        ("tick", "<u8"),
        ("stamp_ns", "<i8"),
        ("lateness_ns", "<i8"),
        ("state", "<u4"),
        ("cause", "<u4"),
        ("plan_id", "<u8"),
        ("plan_t", "<f8"),
        ("speed_scale", "<f8"),
        ("q_ref", "<f8", (DOF,)),
        ("dq_ref", "<f8", (DOF,)),
        ("ddq_ref", "<f8", (DOF,)),
        ("q_meas", "<f8", (DOF,)),
        ("dq_meas", "<f8", (DOF,)),
        ("tau_meas", "<f8", (DOF,)),
    ]
)
EVENT = np.dtype(
    [
        ("tick", "<u8"),
        ("stamp_ns", "<i8"),
        ("kind", "<u4"),
        ("state", "<u4"),
        ("cause", "<u4"),
        ("joint", "<i4"),
        ("plan_id", "<u8"),
        ("value", "<f8"),
        ("limit", "<f8"),
    ]
)


def atomic(method):
    """Holds the core's lock: the front end asks from one thread while a test advances from another."""

    @functools.wraps(method)
    def held(self, *args, **kwargs):
        with self._lock:
            return method(self, *args, **kwargs)

    return held


class FakeCore:
    """Plays plans perfectly, one tick per millisecond, but only when told to advance."""

    def __init__(self, q: np.ndarray) -> None:
        self._lock = threading.RLock()
        self.state = ExecutorState.DISARMED
        self.cause, self.epoch, self.tick = 0, 1, 0
        self.plan_id, self.plan_t, self.plan_done = 0, 0.0, False
        self.speed = 1.0
        self.q, self.dq = np.array(q, float), np.zeros(DOF)
        self.alive, self.beats, self.records_dropped = True, 0, 0
        self.commands: list[tuple[int, int, float]] = []
        self.submitted: list[SimpleNamespace] = []
        self.ring_full = self.refuses_arm = False
        self._spline = None
        self._records: list[np.void] = []
        self._events: list[np.void] = []

    def beat(self):
        self.beats += 1

    @atomic
    def submit_plan(self, plan_id, epoch, t, q, dq, ddq, stop_duration, path_tolerance, goal_tolerance, **_):
        if self.ring_full:
            return False
        self.submitted.append(
            SimpleNamespace(plan_id=plan_id, epoch=epoch, t=t, q=q, stop_duration=stop_duration)
        )
        if epoch != self.epoch:
            self._event(EventKind.REJECTED, cause=Refusal.STALE, plan_id=plan_id)
            return True
        self._spline = spline_through(t, q, dq, ddq)
        self.plan_id, self.plan_t, self.plan_done, self.state = plan_id, 0.0, False, ExecutorState.RUN
        self.cause = 0
        self._event(EventKind.PLAN_STARTED, plan_id=plan_id)
        return True

    @atomic
    def command(self, kind, epoch, value=0.0):
        if self.ring_full:
            return False
        self.commands.append((kind, epoch, value))
        if kind == pb.STOP:
            if self.state in (ExecutorState.RUN, ExecutorState.PAUSED):
                self.cause = int(value) or int(Cause.STOP_REQUESTED)
                self.state, self.dq, self._spline = ExecutorState.HOLD, np.zeros(DOF), None
                self.epoch += 1
                self._event(EventKind.STOP_BEGUN, cause=self.cause, plan_id=self.plan_id)
            return True
        if epoch != self.epoch:
            self._event(EventKind.REJECTED, cause=Refusal.STALE)
            return True
        match kind:
            case pb.ARM:
                self.epoch += 1
                self.state = ExecutorState.FAULT if self.refuses_arm else ExecutorState.HOLD
                self.cause = int(Cause.ARMING_TIMEOUT) if self.refuses_arm else 0
            case pb.SET_SPEED:
                self.speed = value
            case pb.DISARM | pb.RESET:
                self.state = ExecutorState.DISARMED
            case pb.PAUSE:
                self.state = ExecutorState.PAUSED
            case pb.RESUME:
                self.state = ExecutorState.RUN
            case _ if kind == QUIT:
                self.alive = False
        return True

    @atomic
    def advance(self, ticks: int) -> None:
        for _ in range(ticks):
            self.tick += 1
            if self.state == ExecutorState.RUN and self._spline is not None:
                self.plan_t = min(round(self.plan_t + 1e-3, 9), self._spline.duration_s)
                now = sample(self._spline, np.array([self.plan_t]))
                self.q, self.dq = now.q[0], now.dq[0]
                if self.plan_t >= self._spline.duration_s:
                    self.state, self.plan_done, self._spline = ExecutorState.HOLD, True, None
                    self._event(EventKind.PLAN_DONE, plan_id=self.plan_id)
            self._record()

    def _record(self) -> None:
        record = np.zeros((), RECORD)
        for name, value in (
            ("tick", self.tick),
            ("stamp_ns", self.tick * 1_000_000),
            ("state", self.state),
            ("cause", self.cause),
            ("plan_id", self.plan_id),
            ("plan_t", self.plan_t),
            ("speed_scale", 1.0),
            ("q_ref", self.q),
            ("dq_ref", self.dq),
            ("q_meas", self.q + 1e-4),
            ("dq_meas", self.dq),
            ("tau_meas", np.full(DOF, 2.5)),
        ):
            record[name] = value
        self._records.append(record)

    def _event(self, kind, cause=0, plan_id=0, joint=-1, value=0.0, limit=0.0):
        event = np.zeros((), EVENT)
        event["tick"], event["stamp_ns"] = self.tick, self.tick * 1_000_000
        event["kind"], event["state"], event["cause"] = kind, self.state, cause
        event["plan_id"], event["joint"], event["value"], event["limit"] = plan_id, joint, value, limit
        self._events.append(event)

    @atomic
    def records(self, max_records=8192):
        taken, self._records = self._records[:max_records], self._records[max_records:]
        return np.array(taken, RECORD)

    @atomic
    def events(self, max_events=1024):
        taken, self._events = self._events[:max_events], self._events[max_events:]
        return np.array(taken, EVENT)

    @atomic
    def snapshot(self):
        return SimpleNamespace(
            alive=self.alive,
            state=int(self.state),
            cause=int(self.cause),
            cause_joint=-1,
            cause_value=0.0,
            cause_limit=0.0,
            tick=self.tick,
            stamp_ns=self.tick * 1_000_000,
            epoch=self.epoch,
            plan_id=self.plan_id,
            plan_t=self.plan_t,
            plan_done=self.plan_done,
            speed_scale=self.speed,
            q_ref=self.q.copy(),
            dq_ref=self.dq.copy(),
            ddq_ref=np.zeros(DOF),
            q_meas=self.q + 1e-4,
            dq_meas=self.dq.copy(),
            tau_meas=np.full(DOF, 2.5),
            drive_state=np.full(DOF, 4, np.uint8),
            feedback_age=np.zeros(DOF, np.uint32),
            overruns=0,
            missed=0,
            tx_failed=0,
            crc_errors=0,
            realtime=False,
            bus_load_computed=0.68,
        )


@pytest.fixture(scope="session")
def arm():
    return load_arm("xmate3pro")


@pytest.fixture(scope="session")
def admission(arm):
    return Admission(arm, AdmissionConfig(), path_tolerance_rad=0.05, goal_tolerance_rad=0.02)


@pytest.fixture
def core(arm):
    return FakeCore(arm.q_home)


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
