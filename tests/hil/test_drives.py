"""T41 to T47: what a drive or a joint can do. Real ``s2r-rt`` on the bus model, virtual time (lock-step)."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hil_bench import ARM_, DISARM, LIMITS, REJECTED, RESET, STOP_BEGUN, WATCHDOG, move

from s2r_protocol.can.drive import DriveError, DriveState
from s2r_protocol.faults import Cause, ExecutorState
from s2r_sim.bus.oracle import Stop, longest_joint_stop_s

STOP1_S = longest_joint_stop_s(LIMITS)


def stopped_by(bench, cause, joint, within, after_tick):
    """One cause, this joint, begun in time, ended in the latch; the oracle agrees."""
    bench.until(lambda s: s.state == ExecutorState.FAULT, 1500)
    bench.step(30)
    bench.one_cause(cause, joint)
    assert bench.events(STOP_BEGUN)[0]["tick"] - after_tick <= within
    bench.judge(Stop(after_tick, within, STOP1_S, off=True))


@pytest.mark.parametrize("joint", range(7))
def test_t41_a_drive_fault_stops_all_joints_in_the_next_tick(bench, joint):
    bench.moving()
    tick = bench.tick
    bench.plant.drives[joint]._fail(DriveError.OVER_CURRENT, DriveState.FAULT_REACTION)
    bench.step(2)
    assert bench.now.cause_value == DriveError.OVER_CURRENT
    stopped_by(bench, Cause.DRIVE_FAULT, joint, 2, tick)


@pytest.mark.parametrize("packing", ["fd", "classic"])
@pytest.mark.parametrize(
    "state", [DriveState.SWITCHED_ON, DriveState.READY_TO_SWITCH_ON, DriveState.NOT_READY]
)
def test_t42_a_drive_that_silently_leaves_operation_enabled_is_noticed(make_bench, packing, state):
    bench = make_bench(packing=packing)
    bench.moving(150 if packing == "classic" else 600)
    tick = bench.tick
    bench.plant.drives[2]._enter(state)
    bench.plant.drives[2]._walk = lambda: None  # obeys nobody
    bench.until(lambda s: s.state == ExecutorState.FAULT, 1500)
    bench.step(60)
    bench.one_cause(Cause.DRIVE_NOT_ENABLED, 2)
    assert bench.events(STOP_BEGUN)[0]["tick"] - tick <= 2
    if packing == "fd":
        bench.judge(Stop(tick, 2, STOP1_S, off=True))


@pytest.mark.parametrize("packing", ["fd", "classic"])
def test_t42_a_drive_that_falls_back_and_obeys_is_not_enabled_again(make_bench, packing):
    bench = make_bench(packing=packing, brake_feedback=False)
    bench.moving(150 if packing == "classic" else 600)
    drive, states = bench.plant.drives[2], []
    drive._enter(DriveState.SWITCHED_ON)
    drive._walk = lambda: None
    bench.step(3)  # a classical drive is sent "enable operation" until it has told
    del drive._walk
    bench.until(lambda s: s.state == ExecutorState.FAULT, 1500, lambda: states.append(drive.state))
    assert set(states) == {DriveState.SWITCHED_ON}
    bench.one_cause(Cause.DRIVE_NOT_ENABLED, 2)


def jump(q):
    return q + 0.1


@pytest.mark.parametrize("lie", [jump, lambda q: -q], ids=["jump", "sign flip"])
def test_t43_an_encoder_that_jumps_is_noticed_within_five_ticks(bench, lie):
    bench.moving()
    tick = bench.tick
    assert abs(bench.now.q_meas[3]) > 0.1
    bench.plant.drives[3].encoder = lie
    bench.until(lambda s: s.state in (ExecutorState.STOP1, ExecutorState.FAULT), 20)
    assert bench.now.cause in (Cause.PLAUSIBILITY, Cause.FOLLOWING)
    stopped_by(bench, bench.now.cause, 3, 5, tick)


def test_t43_an_encoder_that_sticks_is_noticed_before_the_reference_has_gone_far(bench):
    """Five ticks hold above 0.8 rad/s; slower, the bound is 4 mrad of travel of the reference."""
    bench.moving()
    tick, q = bench.tick, bench.plant.drives[4].q_meas
    start = bench.now.q_ref[4]
    bench.plant.drives[4].encoder = lambda _: q
    bench.until(lambda s: s.state in (ExecutorState.STOP1, ExecutorState.FAULT), 50)
    assert abs(bench.now.q_ref[4] - start) < 0.0065
    stopped_by(bench, Cause.PLAUSIBILITY, 4, 15, tick)


def push_away(bench, joint, rate, up_to):
    """A hand moves the joint away from its set-point, ``rate`` rad per tick, up to ``up_to`` rad."""
    advance, drive, away = bench.plant.advance, bench.plant.drives[joint], {"now": 0.0}

    def pushed(period_ns):
        advance(period_ns)
        away["now"] = min(away["now"] + rate, up_to)
        bench.plant.q[joint], bench.plant.dq[joint] = drive._q_set + away["now"], drive._dq_set
        drive.measure(bench.plant.q[joint], bench.plant.dq[joint])

    bench.plant.advance = pushed


@pytest.mark.parametrize("share", [0.97, 1.03])
def test_t44_a_following_error_just_under_and_just_over_the_window_at_rest(bench, share):
    bench.arm()
    push_away(bench, 2, 2e-4, share * 0.025)
    bench.step(300)
    if share < 1:
        assert bench.now.state == ExecutorState.HOLD
        assert bench.events(STOP_BEGUN) == []
    else:
        bench.until(lambda s: s.state == ExecutorState.FAULT, 1500)
        bench.one_cause(Cause.FOLLOWING, 2)
        begun = bench.events(STOP_BEGUN)[0]
        assert begun["limit"] == pytest.approx(0.025)
        assert begun["limit"] < begun["value"] < 1.02 * begun["limit"]
    bench.judge()


@pytest.mark.parametrize("share", [0.97, 1.03])
def test_t44_the_window_is_wider_in_motion(bench, share):
    bench.moving(560)
    limit = 0.05 * (0.5 + 0.5 * min(1.0, 0.6 / (0.25 * 3.1416)))
    push_away(bench, 0, 2e-3, share * limit)
    bench.step(60)
    speed = float(np.abs(bench.shared.records()["dq_ref"][-60:, 0]).max()) if share < 1 else 0.0
    if share < 1:
        assert speed > 0.6
        assert bench.now.state == ExecutorState.RUN
    else:
        bench.until(lambda s: s.state in (ExecutorState.STOP1, ExecutorState.FAULT, ExecutorState.RUN), 5)
        bench.until(lambda s: s.state == ExecutorState.FAULT, 2000)
        begun = bench.events(STOP_BEGUN)[0]
        assert begun["cause"] == Cause.FOLLOWING
        assert 0.025 < begun["limit"] <= 0.05
        assert begun["limit"] < begun["value"]
    bench.judge()


def test_t45_torque_far_from_the_plans_stops_the_arm_within_twenty_milliseconds(bench):
    """The measured torque is the drive's; the contact is a wall that the third joint runs into."""
    bench.arm()
    plan = move(np.asarray(bench.now.q_ref))
    zero = np.zeros_like(plan.q)
    bench.submit(plan, 1, tau_rest=zero, tau_move=zero)
    bench.step(500)
    tick, wall = bench.tick, bench.plant.q[2]
    advance = bench.plant.advance

    def against_a_wall(period_ns):
        bench.plant.dq[2] = 0.0
        bench.plant.q[2] = wall
        advance(period_ns)
        bench.plant.q[2], bench.plant.dq[2] = min(bench.plant.q[2], wall + 1e-5), 0.0

    bench.plant.advance = against_a_wall
    bench.until(lambda s: s.state in (ExecutorState.STOP1, ExecutorState.FAULT), 100)
    assert bench.now.cause == Cause.COLLISION
    assert bench.now.cause_joint == 2
    assert abs(bench.now.cause_value) > bench.now.cause_limit == pytest.approx(0.5 * 102)
    stopped_by(bench, Cause.COLLISION, 2, 20, tick)


def torque_far_off(bench, periods):
    """The third joint's drive tells 90 % of its limit for so many periods; returns the tick before."""
    bench.arm()
    plan = move(np.asarray(bench.now.q_ref))
    zero = np.zeros_like(plan.q)
    bench.submit(plan, 1, tau_rest=zero, tau_move=zero)
    tell, left = bench.bus.nodes._process_data, [periods]

    def far_off(drive):
        if drive.node == 3:
            left[0] -= 1
            drive.tau_meas = 92.0 if left[0] >= 0 else 0.0
        return tell(drive)

    bench.step(125)
    bench.bus.nodes._process_data = far_off
    return bench.tick


@pytest.mark.parametrize("periods", [1, 8])
def test_t45_one_sample_far_off_is_no_contact(make_bench, periods):
    bench = make_bench(packing="classic")
    torque_far_off(bench, periods)
    bench.until(lambda s: s.plan_done)
    assert bench.events(STOP_BEGUN) == []


@pytest.mark.parametrize("phase", [0, 3, 7])
def test_t45_contact_on_the_classical_packing_stops_the_arm_at_its_second_sample(make_bench, phase):
    bench = make_bench(packing="classic")
    bench.step(phase)
    tick = torque_far_off(bench, 1000)
    bench.until(lambda s: s.state in (ExecutorState.STOP1, ExecutorState.FAULT), 30)
    bench.one_cause(Cause.COLLISION, 2)
    assert 9 <= bench.events(STOP_BEGUN)[0]["tick"] - tick <= 17


def without_health(bench, node, periods):
    """A drive's TPDO2 stays away for so many periods; returns the tick before."""
    tell, left = bench.bus.nodes._process_data, [periods]

    def silent(drive):
        frames = tell(drive)
        if drive.node == node:
            left[0] -= 1
            return frames[:1] if left[0] >= 0 else frames
        return frames

    bench.bus.nodes._process_data = silent
    return bench.tick


def test_t45_a_classical_drive_that_tells_no_torque_any_more_stops_the_arm(make_bench):
    """Contact and heat of that joint would be watched by nobody but the drive."""
    bench = make_bench(packing="classic")
    bench.moving(150)
    tick = without_health(bench, 3, 100_000)
    bench.until(lambda s: s.state == ExecutorState.FAULT, 1500)
    bench.one_cause(Cause.FEEDBACK_LOST, 2)
    assert (bench.now.cause_value, bench.now.cause_limit) == (24, 24)
    assert 16 <= bench.events(STOP_BEGUN)[0]["tick"] - tick <= 25


def test_t45_two_lost_torques_of_a_classical_drive_are_no_reason_to_stop(make_bench):
    bench = make_bench(packing="classic")
    bench.arm()
    bench.submit(move(np.asarray(bench.now.q_ref)), 1)
    bench.step(120)
    without_health(bench, 3, 16)
    bench.until(lambda s: s.plan_done)
    assert bench.events(STOP_BEGUN) == []


def test_a_torque_that_dawdles_on_its_way_is_waited_for(make_bench, monkeypatch):
    """A loaded machine may hand over the TPDO2 well after all TPDO1: the period is not over before."""
    bench = make_bench(packing="classic")
    bench.step(20)
    send, ticks = bench.hub.send, []

    def dawdling(client, packet):
        if int.from_bytes(packet[:4], "little") == 0x283:
            before = bench.tick
            time.sleep(0.02)
            ticks.append(bench.tick - before)
        return send(client, packet)

    monkeypatch.setattr(bench.hub, "send", dawdling)
    bench.step(40)
    assert ticks == [0] * 5


def test_t45_a_classical_drive_that_never_told_its_torque_is_not_armed(make_bench):
    bench = make_bench(packing="classic")
    without_health(bench, 3, 100_000)
    bench.step(100)
    bench.command(ARM_)
    bench.step(5)
    (refused,) = bench.events(REJECTED)
    assert (refused["joint"], refused["limit"]) == (2, 80)
    assert bench.now.state == ExecutorState.DISARMED


def test_t45_the_planned_torque_is_no_collision(bench):
    bench.arm()
    plan = move(np.asarray(bench.now.q_ref))
    zero = np.zeros_like(plan.q)
    bench.submit(plan, 1, tau_rest=zero, tau_move=zero)
    bench.until(lambda s: s.plan_done)
    assert bench.events(STOP_BEGUN) == []


@pytest.mark.parametrize("sign", ["heat", "under-voltage"])
def test_t46_a_warning_slows_the_plan_down_and_then_lets_it_go_on(bench, sign):
    bench.moving(300)
    drive = bench.plant.drives[5]
    bench.motion_ticks.append(bench.tick)
    if sign == "heat":
        drive.temp_C = 75
    else:
        drive.error = DriveError.COMMUNICATION  # an error number without a fault is a warning
    bench.step(600)
    assert bench.now.speed_scale == pytest.approx(0.5)
    assert bench.now.state == ExecutorState.RUN
    assert bench.events(WATCHDOG)[-1]["joint"] == 5
    drive.temp_C, drive.error = 30, DriveError.NONE
    bench.step(550)
    assert bench.now.speed_scale == 1.0
    bench.until(lambda s: s.plan_done)
    bench.judge()


def test_t46_heat_beyond_its_limit_stops_the_arm(bench):
    bench.moving()
    bench.plant.drives[5].temp_C = 75
    bench.step(100)
    tick = bench.tick
    bench.plant.drives[5].temp_C = 86
    bench.step(2)
    assert (bench.now.cause_value, bench.now.cause_limit) == (86, 85)
    stopped_by(bench, Cause.OVER_TEMPERATURE, 5, 2, tick)


def test_t47_a_brake_that_does_not_open_refuses_the_arming(bench):
    bench.plant.drives[1].brake_stuck = False
    bench.step(3)
    bench.command(ARM_)
    bench.until(lambda s: s.state not in (ExecutorState.DISARMED, ExecutorState.ARMING), 1500)
    assert bench.now.state == ExecutorState.FAULT
    bench.one_cause(Cause.BRAKE, 1)
    bench.judge()


def test_t47_a_brake_that_does_not_close_keeps_the_arm_powered_and_alarms(bench):
    bench.arm()
    q = np.array(bench.plant.q)
    bench.plant.drives[1].brake_stuck = True
    bench.command(DISARM)
    bench.step(700)
    assert bench.now.state == ExecutorState.HOLD
    assert list(bench.now.drive_state) == [DriveState.OPERATION_ENABLED] * 7
    alarms = [(e["cause"], e["joint"]) for e in bench.events(WATCHDOG)]
    assert alarms == [(Cause.BRAKE, 1)]
    assert bench.events(REJECTED)[-1]["joint"] == 1
    np.testing.assert_allclose(bench.plant.q, q, atol=1e-3)
    bench.plant.drives[1].brake_stuck = None
    bench.command(DISARM)
    bench.until(lambda s: s.state == ExecutorState.DISARMED, 500)


@pytest.mark.parametrize("in_motion", [False, True], ids=["from HOLD", "from RUN"])
@pytest.mark.parametrize("packing", ["fd", "classic"])
def test_t47_a_brake_that_does_not_close_after_a_stop_keeps_its_joint_under_power(
    make_bench, packing, in_motion
):
    bench = make_bench(packing=packing)
    bench.moving(150 if packing == "classic" else 600) if in_motion else bench.arm()
    stuck, hot = bench.plant.drives[1], bench.plant.drives[5]
    stuck.brake_stuck = True
    hot.temp_C = 90
    bench.until(lambda s: s.cause == Cause.BRAKE, 1500)
    q = np.array(bench.plant.q)
    bench.step(500)
    assert bench.now.state == ExecutorState.STOP1
    assert [(e["cause"], e["joint"]) for e in bench.events(WATCHDOG) if e["cause"] == Cause.BRAKE] == [
        (Cause.BRAKE, 1)
    ]
    bench.one_cause(Cause.OVER_TEMPERATURE, 5)
    assert [d.state for d in bench.plant.drives] == [DriveState.SWITCHED_ON] * 7
    assert [d.brake_released for d in bench.plant.drives] == [j == 1 for j in range(7)]
    assert stuck.tau_meas != 0.0
    np.testing.assert_allclose(bench.plant.q, q, atol=1e-3)
    stuck.brake_stuck = None
    stuck._close_brake()
    bench.until(lambda s: s.state == ExecutorState.FAULT, 20)
    bench.step(5)
    assert {d.state for d in bench.plant.drives} == {DriveState.SWITCH_ON_DISABLED}


def test_t47_a_brake_that_falls_in_during_motion_cuts_the_power(bench):
    bench.moving()
    tick = bench.tick
    drive = bench.plant.drives[1]
    drive.brake_released, drive.brake_stuck = False, False
    bench.until(lambda s: s.state == ExecutorState.FAULT, 10)
    bench.one_cause(Cause.BRAKE, 1)
    assert bench.events(STOP_BEGUN)[0]["tick"] - tick <= 2
    drive.brake_stuck = None
    bench.step(1200)
    bench.command(RESET)
    bench.until(lambda s: s.state == ExecutorState.DISARMED, 600)
    bench.judge()
