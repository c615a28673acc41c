"""The executor's front end in this process, in virtual time, on the bench's core process."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from hil_bench import ARM, Bench

from s2r_executor.config import load_config
from s2r_executor.front_end import FrontEnd
from s2r_executor.observations import Encoder, Timeline
from s2r_executor.plan import PlanRequest
from s2r_executor.quintic import sample, spline_through
from s2r_executor.recorder import Recorder
from s2r_protocol.codec import Address
from s2r_protocol.proto import s2r_pb2 as pb

WATCH_TICKS = 4  # the watch loop's period
BEAT_TICKS = 10  # the host's heartbeat


class Rig:
    """Front end, core and one host; time moves by :meth:`tick` alone, also while the front end waits."""

    def __init__(self, bench: Bench, **overrides: object) -> None:
        self.bench = bench
        bench.beats = bench.takes_events = False
        config = load_config(
            overrides={"bus": "unix:none", "clock": "lockstep", "host_timeout_s": 0.05, **overrides}
        )
        encoder = Encoder(ARM, Timeline(0, 1_000_000, stepped=True))
        self.recorder = Recorder(None, ARM, "/lab/xmate3pro", encoder, config.recorder, {})
        self.front_end = FrontEnd(
            ARM, config, bench.shared, self.recorder, now_s=lambda: self.ticks * 1e-3, idle=self.tick
        )
        self.ticks = 0
        self.host_lives = self.front_end_lives = True
        self.beats: list[int] = []
        self.seq = 0

    def tick(self, count: int = 1) -> None:
        """Move time."""
        for _ in range(count):
            self.ticks += 1
            if self.host_lives and self.ticks % BEAT_TICKS == 0:
                self.front_end.heartbeat(self.address())
                self.beats.append(self.bench.tick)
            if self.front_end_lives and self.ticks % WATCH_TICKS == 0:
                self.bench._events += list(self.front_end.step())
            self.bench.step()

    def until(self, condition, ticks: int = 6000):
        for _ in range(ticks):
            now = self.bench.now
            if condition(now):
                return now
            self.tick()
        raise AssertionError(f"state {now.state}, cause {now.cause} after {ticks} ticks")

    def address(self, sender: str = "host:a", epoch: int | None = None) -> Address:
        me = self.front_end.identity
        self.seq += 1
        return Address(
            sender=sender,
            boot_id=me.boot_id,
            epoch=self.bench.now.epoch if epoch is None else epoch,
            seq=self.seq,
            model_hash=me.model_hash,
            limit_hash=me.limit_hash,
        )

    def arm(self) -> None:
        self.tick(5)
        assert self.front_end.lease(self.address(), release=False).granted
        self.bench.arm_ticks.append(self.bench.tick)
        self.front_end.control(self.address(), pb.ARM, 0.0)

    def send(self, plan: PlanRequest) -> int:
        """Send a plan; returns its number."""
        address = self.address()
        self.bench.motion_ticks.append(self.bench.tick)
        self.front_end.plan(address, plan, b"")
        return address.seq


def request(t, q, dq, ddq, **more: object) -> PlanRequest:
    return PlanRequest(ARM.joint_names, t, q, dq, ddq, **more)


def move(start, distance=0.3, duration_s=2.0, knots=21, **more: object) -> PlanRequest:
    """A minimum-jerk move of all joints."""
    t = np.linspace(0.0, duration_s, knots)
    x = t / duration_s
    s, ds = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / duration_s
    dds = 60 * x * (1 - x) * (1 - 2 * x) / duration_s**2
    gains = distance * np.array([1.0, 0.7, -0.7, -0.7, 1.0, 0.7, 1.3])
    start = np.asarray(start)
    return request(t, start + s[:, None] * gains, ds[:, None] * gains, dds[:, None] * gains, **more)


def state_at(plan: PlanRequest, t: float) -> SimpleNamespace:
    """Where a plan is at its time ``t``."""
    at = sample(spline_through(plan.t, plan.q, plan.dq, plan.ddq), np.array([t]))
    return SimpleNamespace(q=at.q[0], dq=at.dq[0], ddq=at.ddq[0])


def onward(state, change, duration_s=1.2, knots=25, **more: object) -> PlanRequest:
    """From a moving state to rest, ``change`` rad away from where it would coast to."""
    zero = np.zeros(7)
    goal = state.q + state.dq * duration_s / 2 + change
    ends = spline_through(
        np.array([0.0, duration_s]),
        np.stack([state.q, goal]),
        np.stack([state.dq, zero]),
        np.stack([state.ddq, zero]),
    )
    at = sample(ends, np.linspace(0.0, duration_s, knots))
    return request(at.t, at.q, at.dq, at.ddq, **more)
