"""The core in virtual time: watchdogs, drive faults, late wake-ups, the bus, latches and the way out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from s2r_protocol.faults import Cause, ExecutorState, Refusal

ARM, DISARM, STOP, PAUSE, RESUME, SET_SPEED, RESET = range(1, 8)
QUIT = 100
STATE, REJECTED, STOP_BEGUN, GATE_TRIP, OVERRUN, WATCHDOG, LATCH = 1, 4, 5, 7, 8, 9, 11


def causes(cell, kind: int) -> list[tuple[int, int]]:
    return [(e["cause"], e["joint"]) for e in cell.events(kind)]


@pytest.fixture
def moving(armed, plan_from):
    """In the middle of a plan, every joint but the fourth in motion."""
    armed.run_plan(plan_from(armed.state.q_ref))
    armed.step(600)
    return armed


def test_silent_front_end_stops_the_arm_on_its_path_and_holds(moving, use_of_limits):
    moving.beats = False
    moving.step(100)
    assert moving.state.state == ExecutorState.RUN
    moving.step()
    assert moving.state.state == ExecutorState.STOPPING
    assert moving.state.cause == Cause.FRONT_END_LOST
    moving.step(1000)
    assert moving.state.state == ExecutorState.HOLD
    assert list(moving.state.drive_state) == [4] * 7
    assert use_of_limits(moving.emitted()) <= 1.0


def test_front_end_pause_below_its_limit_stops_nothing(moving):
    moving.beats = False
    moving.step(90)
    moving.beats = True
    moving.step(10)
    assert moving.state.state == ExecutorState.RUN
    assert moving.events(WATCHDOG) == []


def test_plan_is_refused_while_the_front_end_is_silent(armed, plan_from):
    armed.beats = False
    armed.step(150)
    armed.submit(plan_from(armed.state.q_ref))
    armed.step(2)
    assert causes(armed, REJECTED) == [(Refusal.STATE, -1)]


def test_front_end_that_went_silent_before_arming_still_counts(cell):
    cell.step(3)
    cell.beats = False
    cell.step(150)
    cell.command(ARM)
    cell.step(3)
    assert cell.state.state == ExecutorState.DISARMED
    assert cell.state.cause == Cause.FRONT_END_LOST


@pytest.mark.parametrize("joint", range(7))
def test_lost_answers_of_one_joint_stop_all_joints_after_three_ticks(moving, use_of_limits, joint):
    moving.drives.silent.add(joint)
    moving.step(3)
    assert moving.state.state == ExecutorState.RUN
    assert causes(moving, WATCHDOG) == [(Cause.FEEDBACK_LOST, joint)]
    moving.step(1)
    snapshot = moving.state
    assert snapshot.state == ExecutorState.STOP1
    assert (snapshot.cause, snapshot.cause_joint, snapshot.cause_value) == (Cause.FEEDBACK_LOST, joint, 3.0)
    assert use_of_limits(moving.emitted()) <= 1.0


def test_two_lost_answers_are_only_a_warning(moving):
    moving.drives.silent.add(2)
    moving.step(2)
    moving.drives.silent.clear()
    moving.step(50)
    assert moving.state.state == ExecutorState.RUN
    assert causes(moving, WATCHDOG) == [(Cause.FEEDBACK_LOST, 2)]
    assert moving.state.late_answers == 2


def test_ten_lost_answers_switch_the_drives_to_their_own_quick_stop(moving):
    moving.drives.silent.add(5)
    moving.step(11)
    assert moving.state.state == ExecutorState.FAULT
    assert moving.drives.ctrl == 3
    assert moving.drives.state == [5] * 7
    moving.step(1100)
    assert moving.drives.ctrl == 0


def test_answers_that_come_back_during_the_stop_let_it_end_under_power(moving, use_of_limits):
    moving.drives.silent.add(5)
    moving.step(5)
    moving.drives.silent.clear()
    moving.until(lambda s: s.state == ExecutorState.FAULT, 700)
    sent = moving.emitted()
    moving.step(3)
    assert use_of_limits(sent) <= 1.0
    assert np.abs(sent[-1] - sent[-2]).max() * 4e-9 <= 300.0 * 1e-9 / 6  # the last tick of a full-jerk ramp
    assert moving.drives.ctrl == 0
    assert list(moving.state.drive_state) == [1] * 7


def test_stop_after_lost_tracking_is_as_short_as_the_limits_allow(moving):
    speed = np.abs(moving.state.dq_ref).max()
    moving.drives.state[1] = moving.drives.stuck[1] = 7
    moving.step(2)
    assert moving.state.state == ExecutorState.STOP1
    first = moving.state.tick
    moving.until(lambda s: s.state == ExecutorState.FAULT, 700)
    assert (moving.state.tick - first) * 1e-3 <= speed / 6.0 + 2 * 6.0 / 300.0 + 0.005


@pytest.mark.parametrize("joint", [0, 6])
def test_drive_fault_during_a_path_stop_takes_over_without_a_step(moving, use_of_limits, joint):
    moving.command(STOP)
    moving.step(250)
    assert moving.state.state == ExecutorState.STOPPING
    moving.drives.state[joint] = moving.drives.stuck[joint] = 7
    moving.step(2)
    assert moving.state.state == ExecutorState.STOP1
    moving.until(lambda s: s.state == ExecutorState.FAULT, 700)
    assert moving.events(GATE_TRIP) == []
    assert use_of_limits(moving.emitted()) <= 1.0


@pytest.mark.parametrize("joint", [0, 6])
def test_faulty_drive_stops_all_joints_in_the_next_tick(moving, use_of_limits, joint):
    moving.drives.state[joint] = moving.drives.stuck[joint] = 7
    moving.drives.error[joint] = 0x23
    moving.step(2)
    snapshot = moving.state
    assert snapshot.state == ExecutorState.STOP1
    assert (snapshot.cause, snapshot.cause_joint, snapshot.cause_value) == (Cause.DRIVE_FAULT, joint, 0x23)
    moving.until(lambda s: s.state == ExecutorState.FAULT, 700)
    assert use_of_limits(moving.emitted()) <= 1.0


@pytest.mark.parametrize("state", [0, 1, 2, 3, 5])
def test_drive_that_leaves_operation_enabled_is_noticed_in_the_next_tick(armed, state):
    armed.drives.state[3] = armed.drives.stuck[3] = state
    armed.step(2)
    events = armed.events(STOP_BEGUN)
    assert [(e["cause"], e["joint"], e["value"]) for e in events] == [(Cause.DRIVE_NOT_ENABLED, 3, state)]
    assert armed.state.state == ExecutorState.STOP1
    armed.step(3)
    assert armed.state.state == ExecutorState.FAULT


@pytest.mark.parametrize(("error", "stops"), [(0.0499, False), (0.0501, True), (-0.0501, True)])
def test_following_error_over_the_path_tolerance_stops_the_arm(make_cell, plan_from, error, stops):
    cell = make_cell(following_rest_share=1.0)
    cell.arm()
    cell.run_plan(plan_from(cell.state.q_ref))
    cell.step(600)
    for i in range(1, 21):  # no faster than a joint can move
        cell.drives.offset[2] = round(error * i / 20 / 4e-9)
        cell.step()
    cell.step()
    assert (cell.state.state == ExecutorState.STOP1) == stops
    if stops:
        snapshot = cell.state
        assert (snapshot.cause, snapshot.cause_joint, snapshot.cause_limit) == (Cause.FOLLOWING, 2, 0.05)
        assert snapshot.cause_value == pytest.approx(error, abs=1e-8)


def test_plan_may_ask_for_a_tighter_path_tolerance(armed, plan_from):
    armed.submit(plan_from(armed.state.q_ref), path_tolerance=0.01)
    armed.step(100)
    armed.drives.offset[2] = round(0.011 / 4e-9)
    armed.step(2)
    assert armed.state.cause == Cause.FOLLOWING


def pressed_away(cell, plan, error, **tolerances):
    """Play a plan while contact holds the first joint back, in the end by ``error`` rad."""
    cell.submit(plan, 1, **tolerances)
    drift(cell, 0.0, error)
    return cell


def drift(cell, begin, end, ticks=500):
    """The first joint's measured position moves aside, from one offset [rad] to another."""
    for i in range(ticks):
        cell.drives.offset[0] = round((begin + (end - begin) * i / ticks) / 4e-9)
        cell.step()


@pytest.mark.parametrize(
    ("goal_tolerance", "stop", "cause"),
    [(0.1, False, Cause.NONE), (0.02, False, Cause.GOAL_TOLERANCE), (0.1, True, Cause.STOP_REQUESTED)],
    ids=["plan done", "goal missed", "stopped"],
)
def test_the_end_of_a_plan_is_held_within_its_own_path_tolerance(
    armed, plan_from, goal_tolerance, stop, cause
):
    plan = plan_from(armed.state.q_ref)
    pressed_away(armed, plan, 0.06, path_tolerance=0.2, goal_tolerance=goal_tolerance)
    if stop:
        armed.command(STOP)
    armed.step(5000)
    assert (armed.state.state, armed.state.cause) == (ExecutorState.HOLD, cause)
    drift(armed, 0.06, 0.11)
    assert armed.state.cause == Cause.FOLLOWING
    assert armed.state.cause_limit == pytest.approx(0.1, rel=1e-3)


def test_an_arming_forgets_the_path_tolerance_of_the_last_plan(armed, plan_from):
    pressed_away(armed, plan_from(armed.state.q_ref), 0.0, path_tolerance=0.2)
    armed.until(lambda s: s.plan_done)
    armed.step(500)
    armed.command(DISARM)
    armed.until(lambda s: s.state == ExecutorState.DISARMED, 50)
    armed.arm()
    drift(armed, 0.0, 0.03, ticks=20)
    assert armed.state.cause == Cause.FOLLOWING
    assert armed.state.cause_limit == pytest.approx(0.025, rel=1e-3)


def test_the_next_plan_brings_its_own_path_tolerance(armed, plan_from):
    pressed_away(armed, plan_from(armed.state.q_ref), 0.0, path_tolerance=0.2)
    armed.until(lambda s: s.plan_done)
    armed.submit(plan_from(armed.state.q_ref, distance=0.01), 2)
    armed.until(lambda s: s.plan_done and s.plan_id == 2)
    armed.step(500)
    drift(armed, 0.0, 0.03, ticks=20)
    assert armed.state.cause_limit == pytest.approx(0.025, rel=1e-3)


def test_following_error_stop_is_anchored_on_the_reference(armed, plan_from, use_of_limits):
    armed.run_plan(plan_from(armed.state.q_ref))
    armed.step(600)
    armed.drives.offset[0] = round(0.06 / 4e-9)
    armed.until(lambda s: s.state == ExecutorState.FAULT, 700)
    assert use_of_limits(armed.emitted()) <= 1.0


def overshooting(plan):
    """Legal at its knots; between the last two the spline swings out at 9 rad/s2 and more."""
    q = plan.q.copy()
    q[-1] = q[-2] + 0.35
    return dataclasses.replace(plan, q=q)


def test_gate_stops_what_is_only_legal_at_the_knots(armed, plan_from, use_of_limits):
    armed.run_plan(overshooting(plan_from(armed.state.q_ref)))
    armed.until(lambda s: s.state != ExecutorState.RUN, 1500)
    assert armed.state.state == ExecutorState.STOP1
    trips = armed.events(GATE_TRIP)
    assert len(trips) == 1
    assert trips[0]["cause"] in (Cause.LIMIT_VELOCITY, Cause.LIMIT_ACCELERATION, Cause.LIMIT_JERK)
    assert abs(trips[0]["value"]) > trips[0]["limit"]
    armed.until(lambda s: s.state == ExecutorState.FAULT, 1000)
    assert use_of_limits(armed.emitted()) <= 1.02  # the refused setpoint never left


def test_setpoint_follows_the_gate_trip_in_the_same_tick(armed, plan_from):
    armed.run_plan(overshooting(plan_from(armed.state.q_ref)))
    armed.until(lambda s: s.state != ExecutorState.RUN, 1500)
    ticks = [tick for tick, _, _ in armed.drives.setpoints]
    assert ticks == list(range(len(ticks)))


def test_damaged_answers_are_dropped_and_counted(moving):
    moving.drives.damage = lambda joint, data: (
        bytes([data[0], data[1], data[2] ^ 1]) + data[3:] if joint == 1 else data
    )
    moving.step(2)
    moving.drives.damage = None
    moving.step(2)
    assert moving.state.crc_errors == 2
    assert moving.state.state == ExecutorState.RUN


@pytest.mark.parametrize("bit", range(128))
def test_no_flipped_bit_of_an_answer_passes(armed, bit):
    def flip(joint: int, data: bytes) -> bytes:
        return (
            bytes(b ^ (1 << bit % 8) if i == bit // 8 else b for i, b in enumerate(data))
            if joint == 0
            else data
        )

    before = armed.state
    armed.drives.damage = flip
    armed.step(2)
    assert armed.state.crc_errors == before.crc_errors + 1
    assert armed.state.q_meas[0] == before.q_meas[0]


@pytest.mark.parametrize("length", [0, 8, 15, 17, 64])
def test_answer_of_another_length_is_dropped(armed, length):
    armed.step(1, extra=((0x181, bytes(length), True),))
    assert armed.state.crc_errors == 1


def test_frozen_answer_ages_although_its_checksum_is_right(moving):
    frozen: dict[int, bytes] = {}
    moving.drives.damage = lambda joint, data: frozen.setdefault(joint, data) if joint == 3 else data
    moving.step(6)
    assert moving.state.state == ExecutorState.STOP1
    assert moving.state.cause == Cause.FEEDBACK_LOST
    assert moving.state.cause_joint == 3


def test_one_to_three_lost_ticks_are_bridged_in_time(moving, plan_from, use_of_limits):
    for lost in (1, 3):
        before = moving.state
        moving.step(skipped=lost)
        assert moving.state.plan_t - before.plan_t == pytest.approx((1 + lost) * 1e-3)
        assert moving.state.tick - before.tick == 1 + lost
        moving.step(200)
    assert moving.state.state == ExecutorState.RUN
    assert (moving.state.overruns, moving.state.missed) == (2, 4)
    assert [e["value"] for e in moving.events(OVERRUN)] == [1, 3]


def test_gap_longer_than_drives_bridge_freezes_path_time_and_stops(moving):
    before = moving.state
    moving.step(skipped=4)
    snapshot = moving.state
    assert snapshot.state == ExecutorState.STOP1
    assert (snapshot.cause, snapshot.cause_value, snapshot.cause_limit) == (Cause.OVERRUN, 4, 3)
    assert snapshot.plan_t == before.plan_t
    assert snapshot.tick == before.tick + 5
    assert np.abs(snapshot.q_ref - before.q_ref).max() < 1.1e-3 * np.abs(before.dq_ref).max()


def test_path_time_freezes_over_every_gap_when_drives_do_not_extrapolate(make_cell, plan_from):
    cell = make_cell(drive_extrapolation_ticks=0)
    cell.arm()
    cell.run_plan(plan_from(cell.state.q_ref))
    cell.step(300)
    before = cell.state
    cell.step(skipped=1)
    assert cell.state.plan_t == before.plan_t
    assert cell.state.cause == Cause.OVERRUN


def test_third_overrun_within_a_second_stops_the_arm(moving):
    moving.step(skipped=1)
    moving.step(100)
    moving.step(skipped=1)
    moving.step(100)
    assert moving.state.state == ExecutorState.RUN
    moving.step(skipped=1)
    assert moving.state.state == ExecutorState.STOP1
    assert moving.state.cause == Cause.OVERRUN


def test_three_overruns_in_more_than_a_second_stop_nothing(armed):
    for _ in range(4):
        armed.step(skipped=1)
        armed.step(600)
    assert armed.state.state == ExecutorState.HOLD


def test_three_setpoints_that_do_not_leave_are_bridged(moving, use_of_limits):
    moving.step(3, send_fails=True)
    moving.step(5)
    assert moving.state.state == ExecutorState.RUN
    assert moving.state.tx_failed == 3


def test_fourth_setpoint_in_a_row_that_does_not_leave_stops_the_arm(moving):
    moving.step(5, send_fails=True)
    assert moving.state.state == ExecutorState.STOP1
    assert moving.state.cause == Cause.TX_FAILED


def test_second_master_on_the_bus_stops_the_arm(moving):
    moving.step(extra=((0x080, bytes(64), True),))
    assert moving.state.state == ExecutorState.STOP1
    assert moving.state.cause == Cause.FOREIGN_MASTER


FOREIGN_SET = ((0x080, bytes(64), True),)
BUS_OFF_FRAME = ((0x2000_0040, bytes(8), False),)


def test_forgotten_core_switches_its_drives_off_and_gives_way_to_a_new_master(armed):
    armed.beats = False
    armed.step(150)
    armed.step(50, extra=FOREIGN_SET)
    assert armed.core.finished
    assert armed.drives.setpoints[-1][1] == 0
    assert armed.drives.state == [1] * 7


def test_one_stray_frame_does_not_end_a_forgotten_core(armed):
    armed.beats = False
    armed.step(150)
    armed.step(extra=((0x000, b"\x01\x00", False),))
    armed.step(50)
    assert not armed.core.finished
    assert (armed.state.state, armed.state.cause) == (ExecutorState.FAULT, Cause.FOREIGN_MASTER)
    assert armed.drives.state == [1] * 7


def test_forgotten_core_does_not_leave_while_its_drives_still_brake(moving):
    moving.step(5, extra=FOREIGN_SET)
    moving.drives.silent.add(5)
    moving.until(lambda s: s.state == ExecutorState.FAULT, 20)
    assert moving.drives.ctrl == 3
    moving.beats = False
    moving.step(300, extra=FOREIGN_SET)
    assert not moving.core.finished
    moving.step(800, extra=FOREIGN_SET)
    assert moving.core.finished
    assert moving.drives.setpoints[-1][1] == 0


def arming(cell):
    """One drive takes its time."""
    cell.step(3)
    cell.drives.stuck[3] = 3
    cell.command(ARM)
    cell.step(5)
    assert cell.state.state == ExecutorState.ARMING
    return cell


@pytest.mark.parametrize(
    ("happens", "ticks", "cause"),
    [
        ({"extra": FOREIGN_SET}, 1, Cause.FOREIGN_MASTER),
        ({"extra": BUS_OFF_FRAME}, 1, Cause.BUS_OFF),
        ({"send_fails": True}, 5, Cause.TX_FAILED),
        ({"extra": 8 * ((0x001, bytes(8), False),)}, 10, Cause.BUS_LOAD),
    ],
    ids=["second master", "bus-off", "setpoints do not leave", "flooded"],
)
def test_what_is_wrong_with_the_bus_ends_an_arming(cell, happens, ticks, cause):
    arming(cell).step(ticks, **happens)
    assert (cell.state.state, cell.state.cause) == (ExecutorState.FAULT, cause)
    cell.step(2)
    assert cell.drives.ctrl == 0


def test_arming_is_refused_while_another_master_is_heard(cell):
    cell.step(3)
    cell.step(extra=FOREIGN_SET)
    cell.step(95)
    cell.command(ARM)
    cell.step()
    (refused,) = cell.events(REJECTED)
    assert (refused["cause"], refused["value"], refused["limit"]) == (
        Refusal.STATE,
        Cause.FOREIGN_MASTER,
        0,
    )
    assert {ctrl for _, ctrl, _ in cell.drives.setpoints} == {0}
    cell.step(5)
    cell.command(ARM)
    cell.until(lambda s: s.state == ExecutorState.HOLD, 20)


def test_arming_is_refused_while_setpoints_do_not_leave(cell):
    cell.step(3)
    cell.step(4, send_fails=True)
    cell.command(ARM)
    cell.step(send_fails=True)
    assert [e["value"] for e in cell.events(REJECTED)] == [Cause.TX_FAILED]
    assert cell.state.state == ExecutorState.DISARMED


def test_a_bus_off_without_power_is_told_and_over_when_all_drives_answer_again(cell):
    cell.step(3)
    cell.step(extra=BUS_OFF_FRAME)
    assert causes(cell, WATCHDOG) == [(Cause.BUS_OFF, -1)]
    cell.step(3)
    cell.arm()
    cell.step(100)
    assert cell.state.state == ExecutorState.HOLD
    assert cell.events(STOP_BEGUN) == []


def test_arming_is_refused_until_all_drives_have_answered_after_a_bus_off(cell):
    cell.step(3)
    cell.drives.silent.add(4)
    cell.step(extra=BUS_OFF_FRAME)
    cell.step(5, extra=BUS_OFF_FRAME)
    cell.command(ARM)
    cell.step()
    assert [e["value"] for e in cell.events(REJECTED)] == [Cause.BUS_OFF]
    assert causes(cell, WATCHDOG) == [(Cause.BUS_OFF, -1)]  # once
    cell.drives.silent.clear()
    cell.step(2)
    cell.command(ARM)
    cell.until(lambda s: s.state == ExecutorState.HOLD, 20)


def test_bus_off_latches(armed):
    armed.step(extra=((0x2000_0040, bytes(8), False),))
    assert armed.state.state == ExecutorState.FAULT
    assert armed.state.cause == Cause.BUS_OFF


def test_bus_error_frames_that_are_not_bus_off_stop_nothing(armed):
    armed.step(20, extra=((0x2000_0004, bytes(8), False),))
    assert armed.state.state == ExecutorState.HOLD


def test_closed_bus_ends_the_core(armed):
    armed.core.close_bus()
    armed.step(2)
    assert armed.core.finished


def test_arming_with_a_faulty_drive_latches_and_names_it(cell):
    cell.drives.state[2] = 7
    cell.step(3)
    cell.command(ARM)
    cell.step(2)
    assert cell.state.state == ExecutorState.FAULT
    assert (cell.state.cause, cell.state.cause_joint) == (Cause.DRIVE_FAULT, 2)


def test_arming_that_takes_too_long_latches_and_names_the_joint(make_cell):
    cell = make_cell(arming_timeout_s=0.1)
    cell.drives.stuck[4] = 3
    cell.step(3)
    cell.command(ARM)
    cell.step(105)
    assert cell.state.state == ExecutorState.FAULT
    assert (cell.state.cause, cell.state.cause_joint) == (Cause.ARMING_TIMEOUT, 4)


def test_arming_without_answers_is_refused(cell):
    cell.drives.silent.update(range(7))
    cell.step(3)
    cell.command(ARM)
    cell.step()
    assert causes(cell, REJECTED) == [(Refusal.STATE, 0)]
    assert cell.state.state == ExecutorState.DISARMED


def test_arming_outside_the_position_limits_is_refused(cell):
    cell.drives.counts[6] = round(2.95 / 4e-9)
    cell.step(3)
    cell.command(ARM)
    cell.step()
    assert causes(cell, REJECTED) == [(Refusal.POSITION, 6)]


def test_stop_while_arming_disarms(cell):
    cell.drives.stuck[1] = 2
    cell.step(3)
    cell.command(ARM)
    cell.step(5)
    cell.command(STOP)
    cell.step(2)
    assert cell.state.state == ExecutorState.DISARMED
    assert cell.drives.ctrl == 0


def test_latch_stays_until_a_reset_after_the_cause_is_gone(armed, plan_from):
    armed.drives.state[0] = armed.drives.stuck[0] = 7
    armed.step(5)
    assert armed.state.state == ExecutorState.FAULT
    assert causes(armed, LATCH) == [(Cause.DRIVE_FAULT, 0)]

    armed.command(ARM)
    armed.submit(plan_from(armed.state.q_ref))
    armed.step(2)
    assert causes(armed, REJECTED) == [(Refusal.STATE, -1)] * 2

    armed.command(RESET)  # the drive does not recover
    armed.step(520)
    assert armed.state.state == ExecutorState.FAULT
    assert causes(armed, REJECTED)[-1] == (Refusal.STATE, 0)

    armed.drives.stuck.clear()  # it would now, but nobody asks
    armed.step(50)
    assert armed.state.state == ExecutorState.FAULT

    armed.command(RESET)
    armed.step(5)
    assert armed.state.state == ExecutorState.DISARMED
    assert armed.drives.state == [1] * 7
    armed.command(ARM)
    armed.until(lambda s: s.state == ExecutorState.HOLD, 20)


def test_every_stop_and_every_arming_makes_a_new_epoch(armed):
    epochs = [armed.state.epoch]
    armed.command(STOP)
    armed.step(2)
    epochs.append(armed.state.epoch)
    armed.drives.state[0] = 7
    armed.step(3)
    epochs.append(armed.state.epoch)
    armed.command(RESET)
    armed.step(5)
    armed.command(ARM)
    armed.step(20)
    epochs.append(armed.state.epoch)
    assert epochs == list(range(epochs[0], epochs[0] + 4))


@pytest.mark.parametrize("how", ["signal", "command"])
def test_quit_stops_on_the_path_disables_and_finishes(moving, use_of_limits, how):
    if how == "signal":
        moving.core.request_quit()
    else:
        moving.command(QUIT, epoch=0)
    moving.step()
    assert moving.state.state == ExecutorState.STOPPING
    for _ in range(1000):
        if moving.core.finished:
            break
        moving.step()
    assert moving.core.finished
    assert use_of_limits(moving.emitted()) <= 1.0
    assert moving.drives.state == [1] * 7
    assert [ctrl for _, ctrl, _ in moving.drives.setpoints[-3:]] == [0, 0, 0]


def reenabling(cell):
    """A brake has not closed: the drives are being enabled again, one of them takes its time."""
    cell.drives.brake_stuck[1] = True
    cell.command(DISARM)
    cell.step(50)
    cell.drives.stuck[4] = 3
    cell.until(lambda s: s.cause == Cause.BRAKE, 400)
    cell.step(10)
    assert cell.drives.ctrl == 2
    return cell


@pytest.mark.parametrize("kind", [DISARM, QUIT])
def test_while_drives_are_enabled_again_after_a_stuck_brake_nothing_takes_the_power(armed, kind):
    reenabling(armed)
    armed.command(kind)
    armed.step(100)
    assert armed.drives.ctrl == 2
    if kind == DISARM:
        assert causes(armed, REJECTED)[-1] == (Refusal.STATE, 4)
    armed.drives.stuck.clear()
    armed.drives.brake_stuck.clear()
    armed.step(5)
    if kind == DISARM:
        armed.step(2000)
        assert armed.state.state == ExecutorState.HOLD
        armed.command(DISARM)
    armed.until(lambda s: s.state == ExecutorState.DISARMED, 100)
    assert armed.events(STOP_BEGUN) == []


def controls(cell, since: int = 0) -> list[int]:
    """What the drives were asked for from a tick on, without repetitions."""
    asked = [ctrl for tick, ctrl, _ in cell.drives.setpoints if tick >= since]
    return [ctrl for i, ctrl in enumerate(asked) if i == 0 or ctrl != asked[i - 1]]


def overheat(cell, joint: int = 3) -> int:
    """An ordinary category 1; returns the tick."""
    cell.drives.temperature[joint] = 90
    return cell.state.tick


@pytest.mark.parametrize("in_motion", [False, True], ids=["from HOLD", "from RUN"])
def test_a_joint_space_stop_closes_the_brakes_before_it_cuts_the_power(armed, plan_from, in_motion):
    if in_motion:
        armed.run_plan(plan_from(armed.state.q_ref))
        armed.step(600)
    tick = overheat(armed)
    armed.until(lambda s: s.state == ExecutorState.FAULT, 700)
    armed.step(3)
    assert controls(armed, tick) == [2, 5, 0]
    assert armed.state.cause == Cause.OVER_TEMPERATURE
    assert armed.drives.state == [1] * 7


def test_a_joint_space_stop_of_drives_that_do_not_tell_their_brakes_just_switches_them_off(make_cell):
    cell = make_cell(brake_feedback=False)
    cell.arm()
    tick = overheat(cell)
    cell.step(4)
    assert controls(cell, tick) == [2, 0]


@pytest.mark.parametrize("in_motion", [False, True], ids=["from HOLD", "from RUN"])
def test_a_brake_that_does_not_close_after_a_joint_space_stop_keeps_the_power(armed, plan_from, in_motion):
    if in_motion:
        armed.run_plan(plan_from(armed.state.q_ref))
        armed.step(600)
    armed.drives.brake_stuck[0] = True
    tick = overheat(armed)
    armed.step(3000)
    assert armed.state.state == ExecutorState.STOP1
    assert controls(armed, tick) == [2, 5]
    assert causes(armed, WATCHDOG)[-1] == (Cause.BRAKE, 0)
    assert causes(armed, WATCHDOG).count((Cause.BRAKE, 0)) == 1
    assert causes(armed, STOP_BEGUN) == [(Cause.OVER_TEMPERATURE, 3)]
    assert (armed.state.cause, armed.state.cause_joint) == (Cause.BRAKE, 0)
    armed.drives.brake_stuck.clear()
    armed.step(3)
    assert armed.state.state == ExecutorState.FAULT
    assert controls(armed, tick) == [2, 5, 0]


def test_a_brake_that_closes_late_is_waited_for_without_an_alarm(armed):
    armed.drives.brake_stuck[0] = True
    tick = overheat(armed)
    armed.step(290)
    assert controls(armed, tick) == [2, 5]
    armed.drives.brake_stuck.clear()
    armed.step(3)
    assert armed.state.state == ExecutorState.FAULT
    assert Cause.BRAKE not in {cause for cause, _ in causes(armed, WATCHDOG)}


def kept_under_power(cell):
    """After a joint-space stop, a brake has not closed."""
    cell.drives.brake_stuck[0] = True
    overheat(cell)
    cell.step(400)
    assert (cell.state.state, cell.state.cause) == (ExecutorState.STOP1, Cause.BRAKE)
    return cell


@pytest.mark.parametrize("kind", [ARM, DISARM, STOP, RESUME, RESET, QUIT])
def test_no_command_takes_the_power_from_a_joint_without_its_brake(armed, kind):
    kept_under_power(armed)
    armed.command(kind)
    armed.step(500)
    assert armed.drives.ctrl == 5
    assert not armed.core.finished


def test_an_emergency_stop_ends_a_joint_space_stop_that_waits_for_its_brake(armed):
    kept_under_power(armed)
    armed.drives.estop = 3
    armed.step(2)
    assert armed.state.state == ExecutorState.ESTOP
    assert armed.drives.ctrl == 0


def test_quitting_goes_on_when_the_brake_has_closed(armed):
    kept_under_power(armed)
    armed.command(QUIT)
    armed.step(50)
    armed.drives.brake_stuck.clear()
    armed.step(10)
    assert armed.core.finished
    assert controls(armed)[-2:] == [5, 0]


@pytest.mark.parametrize("state", [0, 1, 2, 5, 6, 7])
def test_a_drive_that_is_off_in_fault_or_stopping_by_itself_is_not_waited_for(armed, state):
    """Power for the others would not hold it, and its own quick stop ends with "disable" alone."""
    armed.drives.state[2] = armed.drives.stuck[2] = state
    armed.drives.brake_stuck[2] = True
    armed.step(8)
    assert armed.state.state == ExecutorState.FAULT
    assert armed.drives.ctrl == 0


def test_a_drive_that_stays_enabled_behind_its_closed_brake_is_switched_off(armed):
    overheat(armed)
    armed.step(2)
    armed.drives.stuck[2], armed.drives.brake_stuck[2] = 4, False
    armed.step(200)
    assert armed.state.state == ExecutorState.STOP1
    armed.step(110)
    assert armed.state.state == ExecutorState.FAULT
    assert armed.state.cause == Cause.OVER_TEMPERATURE


@pytest.mark.parametrize("how", ["bus-off", "setpoints do not leave"])
def test_brakes_are_not_waited_for_where_nothing_reaches_the_drives(armed, how):
    armed.drives.brake_stuck[0] = True
    if how == "bus-off":
        armed.step(extra=((0x2000_0040, bytes(8), False),))
    else:
        armed.step(7, send_fails=True)
    assert armed.state.state == ExecutorState.FAULT


def test_a_joint_that_is_not_believed_is_not_held_when_its_brake_stays_open(armed):
    armed.drives.brake_stuck[2] = True
    armed.drives.offset[2] = round(0.02 / 4e-9)
    tick = armed.state.tick
    armed.step(250)
    assert (armed.state.state, armed.state.cause) == (ExecutorState.STOP1, Cause.PLAUSIBILITY)
    assert controls(armed, tick) == [2, 5]
    armed.step(60)
    assert (armed.state.state, armed.state.cause) == (ExecutorState.FAULT, Cause.PLAUSIBILITY)
    assert (Cause.BRAKE, 2) in causes(armed, WATCHDOG)


def test_state_events_tell_the_whole_story(moving):
    moving.command(STOP)
    moving.step(700)
    assert [e["state"] for e in moving.events(STATE)] == [
        ExecutorState.DISARMED,
        ExecutorState.ARMING,
        ExecutorState.HOLD,
        ExecutorState.RUN,
        ExecutorState.STOPPING,
        ExecutorState.HOLD,
    ]


def test_tick_counter_of_the_wire_may_wrap_during_a_plan(make_cell, plan_from, use_of_limits):
    cell = make_cell()
    cell.step(3)
    cell.step(skipped=64_900)
    cell.arm()
    cell.run_plan(plan_from(cell.state.q_ref))
    cell.until(lambda s: s.plan_done, 1500)
    assert cell.state.tick > 65_536
    assert cell.state.crc_errors == 0
    assert use_of_limits(cell.emitted()) < 0.5
