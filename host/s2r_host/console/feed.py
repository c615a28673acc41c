"""What the console knows of the arm: the executor's published messages, newest and recent.

Messages are kept as they come and decoded when a screen wants them: 300 a second arrive, few are looked at.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from s2r_host.log.tables import EXECUTOR_STATE, JOINT_STATE, LOG, TRAJECTORY, Joints, Topic, joints_of
from s2r_protocol.ros2 import topic_key, unpack

if TYPE_CHECKING:
    import zenoh

TICK_TIMING = "s2r_msgs/msg/TickTiming"
SILENT_S = 0.5
AWAY_S = 2.0  # an executor that is heard again after so long may be another one, whose clock began anew
KEPT_S = 20.0
_RATE_HZ = 100
_TOPICS = {
    "joint_states": JOINT_STATE,
    "joint_commands": JOINT_STATE,
    "executor_state": EXECUTOR_STATE,
    "events": LOG,
    "plan": TRAJECTORY,
    "timing": TICK_TIMING,
}
_TIMED = ("joint_states", "joint_commands")
_KEPT = {"joint_states": int(KEPT_S * _RATE_HZ), "joint_commands": int(KEPT_S * _RATE_HZ), "events": 200}


@dataclass(frozen=True)
class Health:
    """The link: rate of state messages over the last 2 s [1/s], age of the newest [s] (infinite before any)."""

    rate_hz: float
    age_s: float

    @property
    def alive(self) -> bool:
        """Something arrived lately."""
        return self.age_s < SILENT_S


@dataclass(frozen=True, eq=False)
class LivePlan:
    """The plan the executor accepted last: knots ``t`` (n,) [s], ``q`` (n, dof) [rad]; ``received_s`` monotonic."""

    label: str
    t: np.ndarray
    q: np.ndarray
    received_s: float


class Feed:
    """Subscribed to everything the executor publishes; thread-safe."""

    def __init__(
        self, session: zenoh.Session, namespace: str, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._now_s = now_s
        self._lock = threading.Lock()
        self._messages = {name: deque[tuple[float, bytes]](maxlen=_KEPT.get(name, 1)) for name in _TOPICS}
        self._state_times: deque[float] = deque(maxlen=4 * _RATE_HZ)
        self._subscribers = [
            session.declare_subscriber(self.key(name, namespace), self._keeper(name)) for name in _TOPICS
        ]

    @staticmethod
    def key(topic: str, namespace: str) -> str:
        """Zenoh key of one of the executor's topics below a namespace such as ``/lab/xmate3pro``."""
        return topic_key(f"{namespace}/{topic}", _TOPICS[topic])

    def keep(self, topic: str, message: bytes) -> None:
        """Take one message in."""
        now = self._now_s()
        with self._lock:
            kept = self._messages[topic]
            if topic in _TIMED and kept and now - kept[-1][0] > AWAY_S:
                kept.clear()
            kept.append((now, message))
            if topic == "executor_state":
                self._state_times.append(now)

    def _keeper(self, topic: str) -> Callable[[zenoh.Sample], None]:
        return lambda sample: self.keep(topic, sample.payload.to_bytes())

    def health(self) -> Health:
        """Of the link."""
        now = self._now_s()
        with self._lock:
            times = list(self._state_times)
        recent = sum(now - t < 2.0 for t in times)
        return Health(recent / 2.0, now - times[-1] if times else float("inf"))

    def state(self) -> Mapping[str, Any] | None:
        """The newest executor state, however old; None before the first."""
        return self._newest("executor_state")

    def timing(self) -> Mapping[str, Any] | None:
        """The newest tick timing."""
        return self._newest("timing")

    def q(self, topic: str = "joint_states") -> np.ndarray | None:
        """Newest measured joints, or references with ``joint_commands`` [rad]."""
        body = self._newest(topic)
        return None if body is None else np.asarray(body["position"], float)

    def newest_joints(self, topic: str = "joint_states") -> Mapping[str, Any] | None:
        """The newest joint message."""
        return self._newest(topic)

    def recent(self, topic: str = "joint_states") -> Joints | None:
        """The last 20 s; None before the first message."""
        with self._lock:
            messages = [message for _, message in self._messages[topic]]
        return joints_of(Topic(topic, JOINT_STATE, "cdr", [], messages), "live") if messages else None

    def plan(self) -> LivePlan | None:
        """The plan accepted last, since the console listens, by the executor that is heard now."""
        state = self.state()
        if state is not None and not state["plan_seq"]:  # it was started again
            return None
        with self._lock:
            kept = self._messages["plan"]
            if not kept:
                return None
            received_s, message = kept[-1]
        body = unpack(TRAJECTORY, message)
        t = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in body["points"]]
        q = np.array([p["positions"] for p in body["points"]], float)
        return LivePlan(body["header"]["frame_id"], np.array(t), q, received_s)

    def events(self, count: int) -> list[Mapping[str, Any]]:
        """The newest events, newest first."""
        with self._lock:
            kept = list(self._messages["events"])[-count:]
        return [unpack(LOG, message) for _, message in reversed(kept)]

    def now_s(self) -> float:
        """The clock ages are told by."""
        return self._now_s()

    def close(self) -> None:
        """Unsubscribe."""
        for subscriber in self._subscribers:
            subscriber.undeclare()

    def _newest(self, topic: str) -> Mapping[str, Any] | None:
        with self._lock:
            kept = self._messages[topic]
            if not kept:
                return None
            _, message = kept[-1]
        return unpack(_TOPICS[topic], message)
