"""Observations as ROS 2 messages: what is published at 100 Hz and written to recordings, the same bytes."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from s2r_executor.core import CoreSnapshot, EventKind
from s2r_executor.fault_table import FAULTS
from s2r_executor.status import ExecutorStatus, known_cause
from s2r_executor.tick_timing import EDGES_S, TickTiming
from s2r_protocol.arms import ArmDescription
from s2r_protocol.faults import ExecutorState, Refusal
from s2r_protocol.ros2 import JointStateEncoder, pack

if TYPE_CHECKING:
    from s2r_executor.plan import PlanRequest
    from s2r_executor.recorder import RecordingLoss

JOINT_STATE = "sensor_msgs/msg/JointState"
EXECUTOR_STATE = "s2r_msgs/msg/ExecutorState"
LOG = "rcl_interfaces/msg/Log"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
TICK_TIMING = "s2r_msgs/msg/TickTiming"

_INFO, _WARN, _ERROR = 20, 30, 40
_LEVEL = {
    EventKind.STATE: _INFO,
    EventKind.PLAN_STARTED: _INFO,
    EventKind.PLAN_DONE: _INFO,
    EventKind.REJECTED: _WARN,
    EventKind.STOP_BEGUN: _WARN,
    EventKind.STOP_DONE: _INFO,
    EventKind.GATE_TRIP: _ERROR,
    EventKind.OVERRUN: _WARN,
    EventKind.WATCHDOG: _WARN,
    EventKind.DRIVE: _WARN,
    EventKind.LATCH: _ERROR,
    EventKind.INFO: _INFO,
}


@dataclass(frozen=True)
class Topic:
    """A topic below the arm's namespace and its message type."""

    name: str
    type_name: str


JOINT_STATES = Topic("joint_states", JOINT_STATE)
JOINT_COMMANDS = Topic("joint_commands", JOINT_STATE)
STATE = Topic("executor_state", EXECUTOR_STATE)
EVENTS = Topic("events", LOG)
PLAN = Topic("plan", TRAJECTORY)
TIMING = Topic("timing", TICK_TIMING)
RECORDED = (JOINT_STATES, JOINT_COMMANDS, STATE, EVENTS)
TOPICS = (*RECORDED, PLAN, TIMING)


@dataclass(frozen=True)
class Timeline:
    """Maps the core's time to nanoseconds since the Unix epoch, with one constant offset per process.

    The offset is taken once, so that a wall clock that is set while we run changes nothing. With a stepped clock
    time is the tick count: a recording then shows the arm's time, not the machine's.
    """

    offset_ns: int
    tick_ns: int
    stepped: bool

    def of(self, tick: np.ndarray | int, stamp_ns: np.ndarray | int) -> np.ndarray:
        """Stamps [ns], of the shape of the arguments."""
        if self.stepped:
            return np.asarray(tick, dtype=np.int64) * self.tick_ns + self.offset_ns
        return np.asarray(stamp_ns, dtype=np.int64) + self.offset_ns


def stamp_of(stamp_ns: int) -> dict[str, int]:
    """A builtin_interfaces/Time."""
    return {"sec": stamp_ns // 1_000_000_000, "nanosec": stamp_ns % 1_000_000_000}


class Encoder:
    """Packs one arm's observations."""

    def __init__(self, arm: ArmDescription, timeline: Timeline) -> None:
        self.timeline = timeline
        self._joint_names = arm.joint_names
        self._states = JointStateEncoder(arm.joint_names, frame_id=arm.source.base, has_effort=True)
        self._commands = JointStateEncoder(arm.joint_names, frame_id=arm.source.base, has_effort=False)

    def joint_states(self, records: np.ndarray, stamps_ns: np.ndarray) -> list[bytes]:
        """Measured positions, velocities and torques, one message per record."""
        return self._states.block(stamps_ns, records["q_meas"], records["dq_meas"], records["tau_meas"])

    def joint_commands(self, records: np.ndarray, stamps_ns: np.ndarray) -> list[bytes]:
        """References, one message per record."""
        return self._commands.block(stamps_ns, records["q_ref"], records["dq_ref"])

    def snapshot(self, status: ExecutorStatus) -> list[tuple[Topic, bytes]]:
        """Joint states, joint commands and executor state of one snapshot."""
        core = status.core
        stamp = self.timeline.of(np.array([core.tick]), np.array([core.stamp_ns]))
        rows = [
            np.asarray(a)[None] for a in (core.q_meas, core.dq_meas, core.tau_meas, core.q_ref, core.dq_ref)
        ]
        return [
            (JOINT_STATES, self._states.block(stamp, *rows[:3])[0]),
            (JOINT_COMMANDS, self._commands.block(stamp, *rows[3:])[0]),
            (STATE, self.executor_state(status, int(stamp[0]))),
        ]

    def executor_state(self, status: ExecutorStatus, stamp_ns: int) -> bytes:
        """The full state message."""
        core = status.core
        return pack(
            EXECUTOR_STATE,
            {
                **_common(core.state, core.cause, core.tick, core.plan_t, core.speed_scale, stamp_ns),
                "epoch": core.epoch,
                "why_not_moving": status.why_not_moving,
                "lease_holder": status.lease_holder,
                "plan_seq": status.plan_seq,
                "plan_done": bool(core.plan_done),
                "drive_state": np.asarray(core.drive_state),
                "feedback_age": np.asarray(core.feedback_age),
                **_counters(core),
            },
        )

    def recorded_state(self, record: np.void, stamp_ns: int, plan_seq: int, epoch: int, holder: str) -> bytes:
        """The state message of one tick; what the record does not hold stays zero or empty."""
        return pack(
            EXECUTOR_STATE,
            {
                **_common(
                    int(record["state"]),
                    int(record["cause"]),
                    int(record["tick"]),
                    float(record["plan_t"]),
                    float(record["speed_scale"]),
                    stamp_ns,
                ),
                "plan_seq": plan_seq,
                "epoch": epoch,
                "lease_holder": holder,
            },
        )

    def plan(self, request: PlanRequest) -> tuple[int, bytes]:
        """Wall-clock stamp [ns] and message of a plan that was accepted just now; the label is its frame id."""
        stamp_ns = time.time_ns()
        points = [
            {
                "positions": request.q[i],
                "velocities": request.dq[i],
                "accelerations": request.ddq[i],
                "time_from_start": stamp_of(round(float(request.t[i]) * 1e9)),
            }
            for i in range(len(request.t))
        ]
        header = {"stamp": stamp_of(stamp_ns), "frame_id": request.label}
        body = {"header": header, "joint_names": list(request.joint_names), "points": points}
        return stamp_ns, pack(TRAJECTORY, body)

    def timing(self, timing: TickTiming, records_dropped: int, loss: RecordingLoss) -> tuple[int, bytes]:
        """Wall-clock stamp [ns] and message of the loop's punctuality so far."""
        stamp_ns = time.time_ns()
        count, worst_s = timing.read()
        return stamp_ns, pack(
            TICK_TIMING,
            {
                "header": {"stamp": stamp_of(stamp_ns)},
                "ticks": int(count.sum()),
                "edge_s": EDGES_S,
                "count": count.astype(np.uint64),
                "worst_s": worst_s,
                "records_dropped": records_dropped,
                "recording_lost_ticks": loss.ticks,
                "recording_problem": loss.reason,
            },
        )

    def event(self, event: np.void) -> tuple[int, bytes]:
        """Stamp [ns] and the log message of one event."""
        stamp_ns = int(self.timeline.of(int(event["tick"]), int(event["stamp_ns"])))
        kind = _known_kind(int(event["kind"]))
        return stamp_ns, pack(
            LOG,
            {
                "stamp": stamp_of(stamp_ns),
                "level": _LEVEL[kind],
                "name": "s2r-rt",
                "msg": event_text(event, self._joint_names),
                "function": kind.name,
            },
        )


def event_text(event: np.void, joint_names: tuple[str, ...]) -> str:
    """One sentence with the numbers of an event."""
    kind = _known_kind(int(event["kind"]))
    state = ExecutorState(int(event["state"])).name
    number, joint = int(event["cause"]), int(event["joint"])
    if kind is EventKind.REJECTED:
        why = Refusal(number).name if number in Refusal._value2member_map_ else f"code {number}"
        what = f"plan {event['plan_id']}" if event["plan_id"] else "command"
        return f"tick {event['tick']}: {kind.name} {what}: {why}, in {state}"
    text = f"tick {event['tick']}: {kind.name}, in {state}"
    if int(event["plan_id"]):
        text += f", plan {event['plan_id']}"
    if number:
        cause = known_cause(number)
        text += f", cause {number} {cause.name}: {FAULTS[cause].meaning}"
    if 0 <= joint < len(joint_names):
        text += f", joint '{joint_names[joint]}'"
    value, limit = float(event["value"]), float(event["limit"])
    if kind is EventKind.DRIVE and not number:
        text += ", its error is gone"
    elif kind is EventKind.PLAN_STARTED:
        text += f", {value:.2f} s long"
    elif kind is EventKind.PLAN_DONE:
        text += f", {1e3 * value:.2f} mrad from its goal, tolerance {1e3 * limit:.3g} mrad"
    elif limit != 0.0 or value != 0.0:
        unit = f" {FAULTS[known_cause(number)].unit}".rstrip()
        text += f", value {value:.6g}{unit}, limit {limit:.6g}{unit}"
    return text


def _known_kind(number: int) -> EventKind:
    """An unknown kind is still worth a line."""
    return EventKind(number) if number in EventKind._value2member_map_ else EventKind.INFO


def _common(
    state: int, cause: int, tick: int, plan_t: float, speed_scale: float, stamp_ns: int
) -> dict[str, object]:
    return {
        "header": {"stamp": stamp_of(stamp_ns)},
        "tick": tick,
        "state": state,
        "cause": cause,
        "plan_t": plan_t,
        "speed_scale": speed_scale,
    }


def _counters(core: CoreSnapshot) -> dict[str, object]:
    return {
        "realtime": bool(core.realtime),
        "overruns": core.overruns,
        "missed": core.missed,
        "tx_failed": core.tx_failed,
        "crc_errors": core.crc_errors,
        "bus_load": core.bus_load_computed,
    }
