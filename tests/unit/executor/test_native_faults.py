"""The core's numbers are the protocol's numbers."""

from __future__ import annotations

import pytest

from s2r_protocol.faults import Cause, ExecutorState, Refusal, StopCategory

_native = pytest.importorskip("s2r_executor._native", reason="the native core is not built")


@pytest.mark.parametrize(
    ("table", "enum"),
    [
        ("EXECUTOR_STATES", ExecutorState),
        ("STOP_CATEGORIES", StopCategory),
        ("CAUSES", Cause),
        ("REFUSALS", Refusal),
    ],
)
def test_numbers_of_core_and_protocol_agree(table, enum):
    assert getattr(_native, table) == {member.name: member.value for member in enum}


CATEGORY_2 = {
    "HOST_LOST",
    "FRONT_END_LOST",
    "GOAL_TOLERANCE",
    "STOP_REQUESTED",
    "DISARM_REQUESTED",
    "PAUSE_REQUESTED",
}
CATEGORY_0 = {"ARMING_TIMEOUT", "BRAKE", "ESTOP", "ESTOP_DISCREPANCY"}


@pytest.mark.parametrize("cause", sorted(set(Cause.__members__) - {"NONE"}))
def test_every_cause_has_its_stop_category(cause):
    expected = 2 if cause in CATEGORY_2 else 0 if cause in CATEGORY_0 else 1
    assert _native.CAUSE_CATEGORIES[cause] == expected


def test_no_cause_needs_no_stop():
    assert _native.CAUSE_CATEGORIES["NONE"] == StopCategory.NONE
