"""What the operator reads: one sentence for every state and cause, and a page that matches the code."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from s2r_executor.fault_table import FAULTS, markdown
from s2r_executor.status import describe_cause, known_cause, silent_joints, why_not_moving
from s2r_protocol.faults import Cause, ExecutorState

NAMES = tuple(f"joint{i}" for i in range(1, 8))
PAGE = Path(__file__).parents[3] / "docs" / "faults" / "README.md"


def snapshot(state=ExecutorState.HOLD, cause=Cause.NONE, **more):
    values = {
        "alive": True,
        "state": int(state),
        "cause": int(cause),
        "cause_joint": -1,
        "cause_value": 0.0,
        "cause_limit": 0.0,
        "feedback_age": [0] * len(NAMES),
    }
    return SimpleNamespace(**{**values, "plan_t": 1.5, "speed_scale": 1.0, **more})


@pytest.mark.parametrize("cause", Cause)
@pytest.mark.parametrize("state", ExecutorState)
@pytest.mark.parametrize("holder", ["", "host:1"])
def test_every_state_and_cause_has_sentences_that_end(state, cause, holder):
    text = why_not_moving(snapshot(state, cause), NAMES, holder)
    assert text[0].isupper()
    assert text.endswith(".")
    assert ".." not in text


@pytest.mark.parametrize("cause", Cause)
def test_every_cause_has_a_row(cause):
    fault = FAULTS[cause]
    assert not fault.meaning.endswith(".")
    assert fault.reaction.endswith(".")
    assert fault.recover.endswith(".")


def test_channels_that_disagree_are_to_be_repaired_and_not_released():
    text = why_not_moving(snapshot(ExecutorState.ESTOP, Cause.ESTOP_DISCREPANCY), NAMES, "")
    assert "the two channels of the emergency stop disagree; have the chain repaired" in text
    assert "release" not in text
    assert "release it" in why_not_moving(snapshot(ExecutorState.ESTOP, Cause.ESTOP), NAMES, "")


def test_joint_value_and_limit_are_named():
    text = describe_cause(
        snapshot(cause=Cause.FOLLOWING, cause_joint=1, cause_value=0.0612, cause_limit=0.05), NAMES
    )
    assert text == "joint 'joint2': a joint does not follow its reference (0.0612 rad, limit 0.05 rad)"


def test_lost_answers_name_their_joint_and_count_in_ticks():
    core = snapshot(cause=Cause.FEEDBACK_LOST, cause_joint=3, cause_value=6, cause_limit=5)
    text = describe_cause(core, NAMES)
    assert text == "joint 'joint4': a joint's answers are missing on the bus (6 ticks, limit 5 ticks)"


def test_a_torque_is_told_with_its_unit():
    core = snapshot(cause=Cause.COLLISION, cause_joint=1, cause_value=-16.55, cause_limit=14.5)
    assert describe_cause(core, NAMES).endswith("(-16.55 N·m, limit 14.5 N·m)")


@pytest.mark.parametrize(
    ("cause", "value", "limit", "said"),
    [
        (Cause.DRIVE_FAULT, 0x8611, 0.0, "(error 0x8611)"),
        (Cause.ARMING_TIMEOUT, 3.0, 4.0, "(it is switched on)"),
        (Cause.DRIVE_NOT_ENABLED, 12.0, 4.0, "(it is in state 12)"),
    ],
)
def test_what_a_drive_reports_is_told_in_its_words(cause, value, limit, said):
    core = snapshot(cause=cause, cause_joint=0, cause_value=value, cause_limit=limit)
    assert describe_cause(core, NAMES).endswith(said)


def test_a_brake_has_no_numbers_to_tell():
    core = snapshot(cause=Cause.BRAKE, cause_joint=1, cause_value=0.0, cause_limit=1.0)
    assert describe_cause(core, NAMES) == "joint 'joint2': a brake is not where its drive wants it"


def test_an_arm_that_a_stop_leaves_under_power_is_to_be_supported():
    text = why_not_moving(snapshot(ExecutorState.STOP1, Cause.BRAKE, cause_joint=1), NAMES, "")
    assert "stays under power: joint 'joint2': a brake is not where its drive wants it. Support it" in text
    assert "coming to a stop" in why_not_moving(snapshot(ExecutorState.STOP1, Cause.FOLLOWING), NAMES, "")


def test_drives_that_have_never_answered_are_named_before_anything_else():
    ages = [0, 3, 65_535, 0, 65_535, 0, 0]
    core = snapshot(ExecutorState.DISARMED, feedback_age=ages)
    assert silent_joints(core, NAMES) == ("joint3", "joint5")
    assert "the drives of joint3, joint5" in why_not_moving(core, NAMES, "")
    assert "send ARM" in why_not_moving(snapshot(ExecutorState.DISARMED), NAMES, "")


def test_an_unknown_cause_number_counts_as_internal():
    assert known_cause(777) is Cause.INTERNAL


def test_the_page_matches_the_table():
    assert PAGE.read_text(encoding="utf-8") == markdown(), (
        "docs/faults/README.md is out of date: python -m s2r_executor.fault_table > docs/faults/README.md"
    )
