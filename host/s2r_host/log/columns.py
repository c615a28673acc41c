"""A topic as a table: columns of numbers and texts, one row per message; of plans one per knot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from s2r_host.errors import RecordingError
from s2r_host.log.tables import EXECUTOR_STATE, IMAGE, JOINT_STATE, TRAJECTORY, Topic, joints_of
from s2r_protocol.ros2 import CdrError, nanoseconds, unpack
from s2r_protocol.ros2.definitions import UnknownMessageTypeError, message_type

Columns = dict[str, np.ndarray | list[str]]

_MAX_ARRAY = 64  # longer arrays are blobs (images, clouds), not columns
# What a state that is published tells and the executor's recorder, which sees ticks only, does not.
_NEVER_RECORDED = (
    *("why_not_moving", "plan_done", "drive_state", "feedback_age", "realtime"),
    *("overruns", "missed", "tx_failed", "crc_errors", "bus_load"),
)


@dataclass(frozen=True, eq=False)
class Table:
    """Columns by name, all of one length. ``left_out``: names of arrays too long to be columns."""

    columns: Columns
    left_out: list[str]


def table_of(topic: Topic, who: str, arm_time_ns: np.ndarray | None = None) -> Table | None:
    """A topic as a table; None when its messages are blobs (images) or of a type we have no definition of.

    Args:
        topic: With messages.
        who: Named in errors.
        arm_time_ns: Time of each message on the clock of the joint states [ns], a column of that name; None: not known.

    Raises:
        RecordingError: A message cannot be decoded, or a plan's knots are not of its joints.
    """
    if topic.type_name == JOINT_STATE:
        return Table(_joint_columns(topic, who), [])
    try:
        message_type(topic.type_name)
    except (UnknownMessageTypeError, ValueError):
        return None
    if topic.type_name == IMAGE:
        return None
    try:
        bodies: list[Mapping[str, Any]] = [unpack(topic.type_name, data) for data in topic.messages]
    except CdrError as error:
        raise RecordingError(f"{who}: a message of {topic.name} cannot be decoded: {error}") from error
    if topic.type_name == TRAJECTORY:
        return Table(_plan_columns(bodies, f"{who}: {topic.name}", arm_time_ns), [])
    if topic.type_name == EXECUTOR_STATE:
        bodies = [_told(body) for body in bodies]
    return _message_table(topic, bodies, arm_time_ns)


def _message_table(
    topic: Topic, bodies: Sequence[Mapping[str, Any]], arm_time_ns: np.ndarray | None
) -> Table:
    """One row per message, whatever its type."""
    left_out: dict[str, None] = {}
    rows = [_flat(body, left_out) for body in bodies]
    columns: Columns = {"log_time_ns": np.array(topic.stamp_ns, np.int64)}
    if arm_time_ns is not None:
        columns["arm_time_ns"] = arm_time_ns
    for name in dict.fromkeys(key for row in rows for key in row):
        values = [row.get(name) for row in rows]
        if any(isinstance(v, str) for v in values):
            columns[name] = ["" if v is None else str(v) for v in values]
        else:
            columns[name] = np.array([np.nan if v is None else v for v in values])
    return Table(columns, list(left_out))


def _joint_columns(topic: Topic, who: str) -> Columns:
    joints = joints_of(topic, who)
    columns: Columns = {"stamp_ns": joints.stamp_ns, "t_s": joints.t}
    for label, values in (("q_rad", joints.q), ("dq_rad_s", joints.dq), ("tau_Nm", joints.tau)):
        if values is not None:
            for i, name in enumerate(joints.names):
                columns[f"{label}.{name}"] = values[:, i]
    return columns


def _plan_columns(bodies: Sequence[Mapping[str, Any]], who: str, arm_time_ns: np.ndarray | None) -> Columns:
    """One row per knot: ``plan`` counts from 1, ``stamp_ns`` is when the plan was sent, ``t_s`` the plan's own time.

    Raises:
        RecordingError: A knot has another number of values than the plan has joints.
    """
    names = list(dict.fromkeys(name for body in bodies for name in body["joint_names"]))
    points = [point for body in bodies for point in body["points"]]
    knots = [len(body["points"]) for body in bodies]
    columns: Columns = {
        "plan": np.repeat(np.arange(1, len(bodies) + 1), knots),
        "stamp_ns": np.repeat(
            np.array([nanoseconds(body["header"]["stamp"]) for body in bodies], np.int64), knots
        ),
        "t_s": np.array([nanoseconds(point["time_from_start"]) * 1e-9 for point in points]),
    }
    if arm_time_ns is not None:
        columns["arm_time_ns"] = np.repeat(arm_time_ns, knots)
    own = [[names.index(name) for name in body["joint_names"]] for body in bodies for _ in body["points"]]
    for label, key in (
        ("q_rad", "positions"),
        ("dq_rad_s", "velocities"),
        ("ddq_rad_s2", "accelerations"),
        ("tau_Nm", "effort"),
    ):
        if not any(len(point[key]) for point in points):
            continue
        values = np.full((len(points), len(names)), np.nan)
        for row, joints, point in zip(values, own, points, strict=True):
            if len(point[key]) not in (0, len(joints)):
                raise RecordingError(f"{who}: a knot has {len(point[key])} {key} for {len(joints)} joints")
            if len(point[key]):
                row[joints] = point[key]
        columns |= {f"{label}.{name}": values[:, i] for i, name in enumerate(names)}
    return columns


def _told(state: Mapping[str, Any]) -> Mapping[str, Any]:
    """What an executor's state tells: one from a recorder has no drives, and zeros where nothing was measured."""
    if len(state["drive_state"]):
        return state
    return {key: value for key, value in state.items() if key not in _NEVER_RECORDED}


def _flat(values: Mapping[str, Any], left_out: dict[str, None], prefix: str = "") -> dict[str, Any]:
    """Nested values as dotted names; a stamp becomes nanoseconds; names of long arrays go to ``left_out``."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            if set(value) == {"sec", "nanosec"}:
                found[f"{name}_ns"] = nanoseconds(value)
            else:
                found.update(_flat(value, left_out, f"{name}."))
        elif isinstance(value, (str, int, float, bool, np.generic)):
            found[name] = value
        elif len(value) > _MAX_ARRAY:
            left_out[name] = None
        else:
            for i, item in enumerate(value):
                label = f"{name}[{i}]"
                found.update(
                    _flat(item, left_out, f"{label}.") if isinstance(item, Mapping) else {label: item}
                )
    return found
