"""All states against all triggers: what is not in this table must not happen."""

from __future__ import annotations

import pytest

from s2r_protocol.faults import ExecutorState as S

_native = pytest.importorskip("s2r_executor._native", reason="the native core is not built")

ALLOWED = {
    (S.BOOT, "BOOTED"): S.DISARMED,
    (S.BOOT, "STOP_CAT0"): S.FAULT,
    (S.DISARMED, "ARM"): S.ARMING,
    (S.ARMING, "DRIVES_ENABLED"): S.HOLD,
    (S.ARMING, "DISARM"): S.DISARMED,
    (S.ARMING, "STOP_CAT2"): S.DISARMED,
    (S.ARMING, "STOP_CAT1"): S.FAULT,
    (S.ARMING, "STOP_CAT0"): S.FAULT,
    (S.HOLD, "PLAN_ACCEPTED"): S.RUN,
    (S.HOLD, "DISARM"): S.DISARMED,
    (S.HOLD, "STOP_CAT1"): S.STOP1,
    (S.HOLD, "STOP_CAT0"): S.FAULT,
    (S.RUN, "PLAN_ENDED"): S.HOLD,
    (S.RUN, "PATH_HALTED"): S.PAUSED,
    (S.RUN, "STOP_CAT2"): S.STOPPING,
    (S.RUN, "STOP_CAT1"): S.STOP1,
    (S.RUN, "STOP_CAT0"): S.FAULT,
    (S.PAUSED, "RESUME"): S.RUN,
    (S.PAUSED, "STOP_CAT2"): S.STOPPING,
    (S.PAUSED, "STOP_CAT1"): S.STOP1,
    (S.PAUSED, "STOP_CAT0"): S.FAULT,
    (S.STOPPING, "AT_REST"): S.HOLD,
    (S.STOPPING, "STOP_CAT1"): S.STOP1,
    (S.STOPPING, "STOP_CAT0"): S.FAULT,
    (S.STOP1, "AT_REST"): S.FAULT,
    (S.STOP1, "STOP_CAT0"): S.FAULT,
    (S.FAULT, "RESET"): S.DISARMED,
    (S.ESTOP, "RESET"): S.DISARMED,
}


@pytest.mark.parametrize("state", list(S))
@pytest.mark.parametrize("trigger", list(_native.TRIGGERS))
def test_only_the_listed_transitions_exist(state, trigger):
    expected = S.ESTOP if trigger == "ESTOP_OPEN" else ALLOWED.get((state, trigger), state)
    assert _native.next_state(state, _native.TRIGGERS[trigger]) == expected


@pytest.mark.parametrize("state", [S.ARMING, S.HOLD, S.RUN, S.PAUSED, S.STOPPING])
def test_a_powered_arm_can_always_be_stopped_in_one_step(state):
    for trigger in ("STOP_CAT1", "STOP_CAT0", "ESTOP_OPEN"):
        assert _native.next_state(state, _native.TRIGGERS[trigger]) in (S.STOP1, S.FAULT, S.ESTOP)


def test_motion_is_entered_only_by_a_plan_or_a_resume():
    into_run = [
        (state, name)
        for state in S
        for name, trigger in _native.TRIGGERS.items()
        if state != S.RUN and _native.next_state(state, trigger) == S.RUN
    ]
    assert into_run == [(S.HOLD, "PLAN_ACCEPTED"), (S.PAUSED, "RESUME")]


def test_a_latch_is_left_only_by_a_reset_and_never_into_power():
    for state in (S.FAULT, S.ESTOP):
        for name, trigger in _native.TRIGGERS.items():
            after = _native.next_state(state, trigger)
            assert after in (state, S.ESTOP) or (name == "RESET" and after == S.DISARMED)
