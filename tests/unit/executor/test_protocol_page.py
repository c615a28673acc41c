"""docs/protocol.md names what the code has: keys, refusals, states, topics and type hashes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from s2r_executor.observations import TOPICS
from s2r_protocol.can.identifiers import FRAMES
from s2r_protocol.faults import ExecutorState, Refusal
from s2r_protocol.keys import ArmKeys
from s2r_protocol.ros2 import topic_key, type_hash

PAGE = (Path(__file__).parents[3] / "docs" / "protocol.md").read_text(encoding="utf-8")
ROWS = [
    tuple(cell.strip() for cell in line.strip("|").split("|"))
    for line in PAGE.splitlines()
    if line.startswith("|")
]


@pytest.mark.parametrize("enum", [Refusal, ExecutorState])
def test_every_number_has_its_row_and_no_other_number_has_one(enum):
    named = {(row[0], row[1]) for row in ROWS if len(row) == 3 and re.fullmatch(r"\d+", row[0])}
    expected = {(str(int(member)), member.name) for member in enum}
    assert expected <= named
    both = {(str(int(m)), m.name) for e in (Refusal, ExecutorState) for m in e}
    assert named == both


def test_every_command_key_has_a_row():
    keys = ArmKeys("{cell}".strip("{}"), "{arm}".strip("{}"))
    rows = {row[0].strip("`").replace("{", "").replace("}", "") for row in ROWS}
    for key in (keys.hello, keys.lease, keys.plan, keys.control, keys.recording, keys.heartbeat):
        assert key in rows


@pytest.mark.parametrize("topic", TOPICS)
def test_every_topic_has_a_row_with_its_type_and_hash(topic):
    row = next(row for row in ROWS if row[0] == f"`/{{cell}}/{{arm}}/{topic.name}`")
    assert row[1].strip("`") == topic.type_name
    assert row[-1].strip("`") == type_hash(topic.type_name)


def test_the_example_key_is_the_real_one():
    assert topic_key("/lab/xmate3pro/joint_states", "sensor_msgs/msg/JointState") in PAGE


@pytest.mark.parametrize("packing", FRAMES)
def test_every_frame_of_a_packing_has_a_row_in_its_table(packing):
    table = PAGE.split(f"`--packing {packing}`")[1].split("\n\n")[1]
    rows = [tuple(cell.strip() for cell in line.strip("|").split("|")) for line in table.splitlines()[2:]]
    named = {(row[0].strip("`"), row[1], row[2]) for row in rows}
    assert named == {
        (f"{frame.base:#05x}" + (" + n" if frame.per_drive else ""), frame.name, frame.sender)
        for frame in FRAMES[packing]
    }
