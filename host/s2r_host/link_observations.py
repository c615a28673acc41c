"""What the executor publishes unasked: its state and the joints, as ROS 2 messages at about 100 Hz."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from s2r_protocol.faults import Cause, ExecutorState
from s2r_protocol.ros2 import CdrError, nanoseconds, topic_key, unpack

if TYPE_CHECKING:
    import zenoh

logger = logging.getLogger(__name__)

STATE = "s2r_msgs/msg/ExecutorState"
JOINTS = "sensor_msgs/msg/JointState"


@dataclass(frozen=True)
class StateSample:
    """One published state; the fields mean what they mean in ``ExecutorStatus``."""

    state: ExecutorState
    cause: Cause
    why_not_moving: str
    tick: int
    epoch: int
    plan_seq: int
    plan_t: float
    plan_done: bool


@dataclass(frozen=True, eq=False)
class JointSample:
    """One published joint state: ``q`` [rad], ``dq`` [rad/s], shape (dof,)."""

    stamp_ns: int
    q: np.ndarray
    dq: np.ndarray


class ObservationFeed:
    """Keeps the newest message of each topic. Samples are ``None`` when older than ``fresh_s``."""

    def __init__(self, session: zenoh.Session, namespace: str, fresh_s: float = 0.2) -> None:
        """Subscribe.

        Args:
            session: Stays the caller's.
            namespace: Of the topics, e.g. ``/lab/xmate3pro``.
            fresh_s: Age after which a message no longer counts [s].
        """
        self._fresh_s = fresh_s
        self._lock = threading.Lock()
        self._newest: dict[str, tuple[float, bytes]] = {}
        self._subscribers = [
            session.declare_subscriber(topic_key(f"{namespace}/{topic}", name), self._keeper(topic))
            for topic, name in (
                ("executor_state", STATE),
                ("joint_states", JOINTS),
                ("joint_commands", JOINTS),
            )
        ]

    def state(self) -> StateSample | None:
        """The newest state."""
        body = self._body("executor_state", STATE)
        if body is None:
            return None
        return StateSample(
            state=ExecutorState(int(body["state"])),
            cause=Cause(int(body["cause"])),
            why_not_moving=body["why_not_moving"],
            tick=int(body["tick"]),
            epoch=int(body["epoch"]),
            plan_seq=int(body["plan_seq"]),
            plan_t=float(body["plan_t"]),
            plan_done=bool(body["plan_done"]),
        )

    def joints(self, topic: str = "joint_states") -> JointSample | None:
        """The newest measured joints, or with ``joint_commands`` the newest reference."""
        body = self._body(topic, JOINTS)
        if body is None:
            return None
        stamp_ns = nanoseconds(body["header"]["stamp"])
        return JointSample(stamp_ns, np.asarray(body["position"]), np.asarray(body["velocity"]))

    def heard_within(self, seconds: float) -> bool:
        """Whether anything was published in the last ``seconds``."""
        with self._lock:
            newest_s = max((received_s for received_s, _ in self._newest.values()), default=float("-inf"))
        return time.monotonic() - newest_s <= seconds

    def close(self) -> None:
        """Unsubscribe."""
        for subscriber in self._subscribers:
            subscriber.undeclare()

    def _keeper(self, topic: str):  # noqa: ANN202 - zenoh's callback type
        def keep(sample: zenoh.Sample) -> None:
            with self._lock:
                self._newest[topic] = (time.monotonic(), sample.payload.to_bytes())

        return keep

    def _body(self, topic: str, name: str) -> Mapping[str, Any] | None:
        with self._lock:
            received_s, wire = self._newest.get(topic, (float("-inf"), b""))
        if time.monotonic() - received_s > self._fresh_s:
            return None
        try:
            return unpack(name, wire)
        except CdrError as error:
            logger.warning("message on %s cannot be read: %s", topic, error)
            return None
