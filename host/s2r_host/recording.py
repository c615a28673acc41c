"""The run's own MCAP: what the host saw, estimated and planned, with the executor's recordings merged in.

Profile ``ros2``, CDR messages only, so that ROS 2 tools, Rerun and rosbags open it as it is. Written as the run
goes: a run that dies leaves a file that ends early, not an empty one.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple

import numpy as np
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType, Writer

from s2r_host.errors import RecordingError
from s2r_host.link_camera import Capture
from s2r_host.link_types import TimedPath
from s2r_host.log.segments import ARM_STAMP
from s2r_host.mcap_damage import DAMAGED
from s2r_protocol.arms import ArmDescription
from s2r_protocol.ros2 import nanoseconds, pack, unpack
from s2r_protocol.ros2.definitions import schema_text

JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
TEXT = "std_msgs/msg/String"
STATE = "s2r_msgs/msg/ExecutorState"
_CHUNK_BYTES = 256 * 1024


def stamp(stamp_ns: int) -> dict[str, int]:
    """Nanoseconds since the Unix epoch as a ROS time."""
    return {"sec": stamp_ns // 1_000_000_000, "nanosec": stamp_ns % 1_000_000_000}


@dataclass(frozen=True, eq=False)
class RecordedPlan:
    """One plan of a recording.

    Attributes:
        number: Counts the plans of the run from 1.
        seq: The executor's number of it, 0 when it never was accepted.
        label: E.g. "push 1".
        stamp_ns: When it was sent, Unix time.
        t, q, dq, ddq: Knots: [s], [rad], ..., shapes (n,) and (n, dof).
    """

    number: int
    seq: int
    label: str
    stamp_ns: int
    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray


class RunRecorder:
    """Writes ``run.mcap``. A context manager; leaving it finishes the file."""

    def __init__(
        self,
        path: Path,
        namespace: str,
        joint_names: tuple[str, ...],
        arm: ArmDescription | None = None,
        facts: Mapping[str, str] | None = None,
        arm_stamp_ns: Callable[[], int | None] = lambda: None,
    ) -> None:
        """Open the file.

        Args:
            path: Where to write.
            namespace: Common prefix of all topics, e.g. ``/lab/xmate3pro``.
            joint_names: In the arm's order.
            arm: Its URDF, MJCF and limits are attached, its hashes noted.
            facts: Further named values: seeds, versions, arguments.
            arm_stamp_ns: Stamp of the newest joint state, None when the executor is silent. Every note tells it: the
                arm's clock is another than the host's, and in lock-step it runs at another pace.
        """
        self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="s2r")
        self._namespace = namespace.rstrip("/")
        self._joint_names = joint_names
        self._arm_stamp_ns = arm_stamp_ns
        self._channels: dict[tuple[str, str], int] = {}
        self._schemas: dict[str, int] = {}
        self._plans = 0
        self._closed = False
        known = dict(facts or {})
        if arm is not None:
            known |= {
                "arm": arm.name,
                "model_hash": arm.model_hash.hex(),
                "limit_hash": arm.limit_hash.hex(),
            }
            self.attach(f"{arm.name}.urdf", "application/xml", arm.urdf.encode())
            self.attach(f"{arm.name}.xml", "application/xml", arm.mjcf.encode())
            self.attach("limits.yaml", "application/yaml", arm.limits_yaml.encode())
        if known:
            self._writer.add_metadata("s2r", known)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Add a file to the recording."""
        now = time.time_ns()
        self._writer.add_attachment(
            create_time=now, log_time=now, name=name, media_type=media_type, data=data
        )

    def add_capture(self, name: str, capture: Capture) -> None:
        """One depth frame as a 32-bit float image with its camera matrix and pose."""
        now = time.time_ns()
        frame = capture.frame
        height, width = frame.depth_m.shape
        header = {"stamp": stamp(now), "frame_id": f"camera_{capture.camera}"}
        image = {
            "header": header,
            "height": height,
            "width": width,
            "encoding": "32FC1",
            "is_bigendian": 0,
            "step": 4 * width,
            "data": np.frombuffer(np.ascontiguousarray(frame.depth_m, "<f4").tobytes(), np.uint8),
        }
        prefix = f"camera/{capture.camera}"
        self._put(f"{prefix}/depth/image_raw", "sensor_msgs/msg/Image", image, now)
        if frame.colour is not None:
            colour = np.ascontiguousarray(frame.colour)
            rgb = {**image, "encoding": "rgb8", "step": 3 * width, "data": colour.reshape(-1)}
            self._put(f"{prefix}/color/image_raw", "sensor_msgs/msg/Image", rgb, now)
        K = np.asarray(frame.K, float)
        P = np.hstack([K, np.zeros((3, 1))])
        info = {
            "header": header,
            "height": height,
            "width": width,
            "distortion_model": "plumb_bob",
            "d": [0.0] * 5,
            "k": K.ravel(),
            "r": np.eye(3).ravel(),
            "p": P.ravel(),
        }
        self._put(f"{prefix}/depth/camera_info", "sensor_msgs/msg/CameraInfo", info, now)
        pose = np.asarray(frame.X_base_camera, float).tolist()
        self.add_note("view", {"name": name, "camera_stamp_ns": capture.stamp_ns, "X_base_camera": pose})

    def add_plan(self, path: TimedPath, label: str, seq: int) -> int:
        """One plan with all its knots; its number in this run."""
        now = time.time_ns()
        self._plans += 1
        points = [
            {
                "positions": path.q[i],
                "velocities": path.dq[i],
                "accelerations": path.ddq[i],
                "time_from_start": stamp(round(path.t[i] * 1e9)),
            }
            for i in range(len(path.t))
        ]
        message = {
            "header": {"stamp": stamp(now), "frame_id": "base"},
            "joint_names": list(self._joint_names),
            "points": points,
        }
        self._put("plan", TRAJECTORY, message, now)
        note = {"number": self._plans, "seq": seq, "label": label, "duration_s": float(path.t[-1])}
        self.add_note("plan", note, now)
        return self._plans

    def add_note(self, kind: str, values: Mapping[str, Any], now_ns: int | None = None) -> None:
        """Anything else the run knows, as JSON text: estimates, measurements, verdicts.

        Raises:
            ValueError: A number is not finite, which JSON cannot say; None stands for what is not known.
        """
        arm_ns = self._arm_stamp_ns()
        on_arm = {} if arm_ns is None else {ARM_STAMP: arm_ns}
        text = json.dumps({"kind": kind, **on_arm, **values}, sort_keys=True, allow_nan=False)
        self._put("run", TEXT, {"data": text}, now_ns or time.time_ns())
        self._writer.flush()  # a note is what somebody may be waiting for: the console follows the growing file

    def add_stage(self, name: str, phase: str, note: str = "") -> None:
        """A stage of the run began or ended; phase is "begun", "ended" or "failed"."""
        if not self._closed:
            self.add_note("stage", {"name": name, "phase": phase, "note": note})

    def add_recording(self, mcap: bytes) -> int:
        """Merge an executor's recording; the number of messages taken over.

        Raises:
            RecordingError: The bytes are no MCAP file.
        """
        count = 0
        try:
            for schema, channel, message in _in_time(io.BytesIO(mcap)):
                key = (channel.topic, schema.name)
                if key not in self._channels:
                    if schema.name not in self._schemas:
                        self._schemas[schema.name] = self._writer.register_schema(
                            schema.name, schema.encoding, schema.data
                        )
                    self._channels[key] = self._writer.register_channel(
                        channel.topic,
                        channel.message_encoding,
                        self._schemas[schema.name],
                        dict(channel.metadata),
                    )
                self._writer.add_message(
                    self._channels[key],
                    message.log_time,
                    message.data,
                    message.publish_time,
                    message.sequence,
                )
                count += 1
        except DAMAGED as error:
            raise RecordingError(
                f"the executor's recording ({len(mcap)} bytes) cannot be read: {error}"
            ) from error
        return count

    def close(self) -> None:
        """Finish the file."""
        self._closed = True
        try:
            self._writer.finish()
        finally:
            self._file.close()

    def __enter__(self) -> RunRecorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _put(self, topic: str, type_name: str, values: Mapping[str, Any], now_ns: int) -> None:
        full = f"{self._namespace}/{topic}"
        key = (full, type_name)
        if key not in self._channels:
            if type_name not in self._schemas:
                self._schemas[type_name] = self._writer.register_schema(
                    type_name, "ros2msg", schema_text(type_name).encode()
                )
            self._channels[key] = self._writer.register_channel(full, "cdr", self._schemas[type_name])
        self._writer.add_message(self._channels[key], now_ns, pack(type_name, values), now_ns)


def read_plans(path: Path) -> list[RecordedPlan]:
    """All plans of a run's recording, in the order they were sent.

    Raises:
        RecordingError: The file is missing, damaged or holds no plan.
    """
    trajectories = [found.unpack() for found in _read(path, TRAJECTORY)]
    notes = [note for note in read_notes(path) if note["kind"] == "plan"]
    if not trajectories:
        raise RecordingError(f"{path} holds no plan; was the run stopped before the first motion?")
    return [_recorded_plan(body, note) for body, note in zip(trajectories, notes, strict=True)]


def read_notes(path: Path) -> list[dict[str, Any]]:
    """The host's notes, in order.

    Raises:
        RecordingError: The file is missing or damaged.
    """
    return [json.loads(found.unpack()["data"]) for found in _read(path, TEXT) if found.topic.endswith("/run")]


@dataclass(frozen=True, eq=False)
class JointTrack:
    """One topic of JointState over time: ``stamp_ns`` (n,), ``q`` [rad] and ``dq`` [rad/s] (n, dof).

    ``t`` (n,) is the time since its start [s]; of a plan the plan's own, see :func:`plan_time`.
    """

    stamp_ns: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    t: np.ndarray


def joint_track(recording: Path | bytes, topic_end: str = "joint_states") -> JointTrack:
    """Measured joints (``joint_states``) or references (``joint_commands``) of a recording.

    Raises:
        RecordingError: The recording is damaged or has no such topic.
    """
    return _track(_read(recording, JOINT_STATE), topic_end)


def plan_track(recording: Path | bytes, plan_seq: int, topic_end: str = "joint_states") -> JointTrack:
    """The part of a recording during which one plan ran and its end was held.

    Raises:
        RecordingError: The recording is damaged or that plan is not in it.
    """
    messages = _read(recording, STATE, JOINT_STATE)
    during = _plan_times(messages, plan_seq)
    whole = _track(messages, topic_end)
    return during_plan(whole.stamp_ns, whole.q, whole.dq, during)


def during_plan(
    stamp_ns: np.ndarray, q: np.ndarray, dq: np.ndarray, during: Sequence[tuple[int, float]]
) -> JointTrack:
    """Those of the rows (n,) and (n, dof) that were recorded during a plan, with its own time; ``during`` as below."""
    inside = (stamp_ns >= during[0][0]) & (stamp_ns <= during[-1][0])
    return JointTrack(stamp_ns[inside], q[inside], dq[inside], plan_time(during, stamp_ns[inside]))


def plan_time(during: Sequence[tuple[int, float]], stamp_ns: np.ndarray) -> np.ndarray:
    """The plan's own time [s] at moments (n,): a pause stops it and another speed slows it, while the clock goes on.

    After the plan's end, or the stop that ended it, it goes on with the clock.

    Args:
        during: Stamp [ns] and plan time [s] of the executor's states during the plan, in order, at least one.
        stamp_ns: Unix time.
    """
    stamps, t = np.array([stamp for stamp, _ in during]), np.array([t for _, t in during])
    ended = stamps[np.argmax(t >= t[-1])]
    at = np.interp(stamp_ns - stamps[0], stamps - stamps[0], t)
    return at + 1e-9 * np.maximum(0, stamp_ns - ended)


class _Found(NamedTuple):
    """A message of a recording."""

    type_name: str
    topic: str
    data: bytes

    def unpack(self) -> dict[str, Any]:
        return unpack(self.type_name, self.data)


def _track(messages: Sequence[_Found], topic_end: str) -> JointTrack:
    """Joints over time.

    Raises:
        RecordingError: There is no such topic.
    """
    rows = [
        found.unpack()
        for found in messages
        if found.type_name == JOINT_STATE and found.topic.endswith("/" + topic_end)
    ]
    if not rows:
        raise RecordingError(f"the recording has no messages on a topic that ends with '{topic_end}'")
    stamps = np.array([_stamp_ns(body) for body in rows])
    order = np.argsort(stamps, kind="stable")
    q = np.array([body["position"] for body in rows])
    dq = np.array([body["velocity"] for body in rows])
    return JointTrack(stamps[order], q[order], dq[order], (stamps[order] - stamps[order[0]]) * 1e-9)


def _plan_times(messages: Sequence[_Found], plan_seq: int) -> list[tuple[int, float]]:
    """(stamp [ns], plan time [s]) of every state during a plan, in order, at least one.

    Raises:
        RecordingError: There is none.
    """
    during = [
        (_stamp_ns(body), float(body["plan_t"]))
        for body in (found.unpack() for found in messages if found.type_name == STATE)
        if int(body["plan_seq"]) == plan_seq
    ]
    if not during:
        raise RecordingError(f"the recording has no state of the executor during plan {plan_seq}")
    return sorted(during)


def _stamp_ns(body: Mapping[str, Any]) -> int:
    return nanoseconds(body["header"]["stamp"])


def _read(recording: Path | bytes, *type_names: str) -> list[_Found]:
    """Messages of these types in the order of their times.

    Raises:
        RecordingError: The recording is missing or damaged.
    """
    try:
        stream = io.BytesIO(recording) if isinstance(recording, bytes) else recording.open("rb")
    except OSError as error:
        raise RecordingError(f"recording {recording}: {error.strerror}") from error
    with stream:
        try:
            return [
                _Found(schema.name, channel.topic, message.data)
                for schema, channel, message in _in_time(stream, type_names)
            ]
        except DAMAGED as error:
            name = "recording" if isinstance(recording, bytes) else str(recording)
            raise RecordingError(f"{name} is damaged: {error}; mend it with 's2r log recover'") from error


def _in_time(stream: IO[bytes], type_names: Sequence[str] = ()) -> list[tuple[Schema, Channel, Message]]:
    """Messages of these types, or all that have one, in the order of their times.

    Sorted here: the library's own order is kept by a queue that compares in Python, at more than the cost of reading.
    """
    found = [
        (schema, channel, message)
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages(
            log_time_order=False
        )
        if schema is not None and (not type_names or schema.name in type_names)
    ]
    return sorted(found, key=lambda one: one[2].log_time)


def _recorded_plan(body: Mapping[str, Any], note: Mapping[str, Any]) -> RecordedPlan:
    points = body["points"]

    def column(name: str) -> np.ndarray:
        return np.array([point[name] for point in points], float)

    t = np.array([p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points])
    return RecordedPlan(
        note["number"],
        note["seq"],
        note["label"],
        _stamp_ns(body),
        t,
        column("positions"),
        column("velocities"),
        column("accelerations"),
    )
