"""MCAP files of this project: JointState messages in CDR, measured and commanded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from s2r_host.gap.errors import GapRecordingError
from s2r_protocol.ros2 import unpack

JOINT_STATE = "sensor_msgs/msg/JointState"
MEASURED = {"position": "q", "velocity": "dq", "effort": "tau"}
COMMANDED = {"position": "q_cmd", "velocity": "dq_cmd", "effort": "tau_ff"}


def read_mcap(path: Path) -> dict[str, np.ndarray]:
    """Columns of the contract from the topics ``.../joint_states`` and ``.../joint_commands``.

    Raises:
        GapRecordingError: Not an MCAP, or no joint states in it.
    """
    tracks: dict[str, list[tuple[float, dict]]] = {"joint_states": [], "joint_commands": []}
    try:
        with path.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages():
                topic = channel.topic.rsplit("/", 1)[-1]
                if schema is not None and schema.name == JOINT_STATE and topic in tracks:
                    values = unpack(JOINT_STATE, message.data)
                    stamp = values["header"]["stamp"]
                    tracks[topic].append((stamp["sec"] + 1e-9 * stamp["nanosec"], values))
    except (OSError, McapError, ValueError, KeyError, EOFError) as error:
        raise GapRecordingError(f"{path.name}: not a readable MCAP of this project ({error})") from error
    if not tracks["joint_states"]:
        raise GapRecordingError(f"{path.name}: no topic '.../joint_states' with {JOINT_STATE} messages")
    start = tracks["joint_states"][0][0]
    t, measured = _columns(tracks["joint_states"], MEASURED, start)
    table = {"t": t, **measured}
    if len(tracks["joint_commands"]) > 1:
        t_cmd, commanded = _columns(tracks["joint_commands"], COMMANDED, start)
        order = np.argsort(t_cmd)
        for name, values in commanded.items():
            table[name] = np.interp(t, t_cmd[order], values[order])
    return table


def _columns(
    messages: list[tuple[float, dict]], names: dict[str, str], start: float
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    t = np.array([stamp - start for stamp, _ in messages])
    joints = list(messages[0][1]["name"])
    table: dict[str, np.ndarray] = {}
    for field, kind in names.items():
        if any(len(values[field]) != len(joints) for _, values in messages):
            continue
        block = np.array([np.asarray(values[field], dtype=float) for _, values in messages])
        for i, joint in enumerate(joints):
            table[f"{kind}.{joint}"] = block[:, i]
    return t, table
