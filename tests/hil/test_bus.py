"""T32 to T40: what can happen on the wire. Real ``s2r-rt`` on the bus model, virtual time (lock-step)."""

from __future__ import annotations

import pytest
from hil_bench import (
    ARM_,
    INFO,
    LATCH,
    LIMITS,
    REJECTED,
    RESET,
    STOP_BEGUN,
    WATCHDOG,
    Stepped,
)

from s2r_protocol.can import fd
from s2r_protocol.can.drive import Control, DriveState
from s2r_protocol.can.frames import CAN_ERR_BUSOFF, CAN_ERR_CRTL, CanFrame
from s2r_protocol.faults import Cause, ExecutorState
from s2r_sim.bus.oracle import Stop, longest_joint_stop_s

ENABLED = DriveState.OPERATION_ENABLED
STOP1_S = longest_joint_stop_s(LIMITS)


def latched(bench, cause, joint=None):
    """The one stop that began has this cause, and it ended in the latch."""
    bench.until(lambda s: s.state == ExecutorState.FAULT, 1500)
    bench.step(60)
    bench.one_cause(cause, joint)
    assert bench.now.cause == cause
    assert bench.child.poll() is None


@pytest.mark.parametrize("lost", [1, 2])
def test_t32_one_or_two_lost_setpoints_are_bridged_by_the_drives(bench, lost):
    bench.moving()
    bench.lose(0x080, lost)
    bench.until(lambda s: s.plan_done)
    assert [d.state for d in bench.plant.drives] == [ENABLED] * 7
    assert bench.events(STOP_BEGUN) == []
    bench.judge()


def test_t32_three_lost_setpoints_are_bridged_and_stop_the_arm_since_all_answers_fail(bench):
    bench.moving()
    tick = bench.tick
    bench.lose(0x080, 3)
    bench.step(4)
    assert [d.state for d in bench.plant.drives] == [ENABLED] * 7  # none of them has stopped by itself
    latched(bench, Cause.FEEDBACK_LOST)
    bench.judge(Stop(tick, 4, STOP1_S, off=True))


def test_t33_four_lost_setpoints_make_the_drives_stop_and_the_executor_learns_it(bench):
    bench.moving()
    tick = bench.tick
    bench.lose(0x080, 5)
    bench.step(5)
    assert [d.state for d in bench.plant.drives] == [DriveState.QUICK_STOP_ACTIVE] * 7
    assert bench.now.state == ExecutorState.STOP1
    latched(bench, Cause.FEEDBACK_LOST)
    bench.judge(Stop(tick, 4, STOP1_S, off=True))


def test_t34_one_lost_answer_warns(bench):
    bench.moving()
    bench.lose(0x183, 1)
    bench.until(lambda s: s.plan_done)
    assert [(e["cause"], e["joint"]) for e in bench.events(WATCHDOG)] == [(Cause.FEEDBACK_LOST, 2)]
    bench.judge()


@pytest.mark.parametrize("joint", range(7))
def test_t34_three_lost_answers_of_one_joint_stop_all_joints_in_the_same_tick(bench, joint):
    bench.moving()
    tick = bench.tick
    bench.lose(0x181 + joint, 3)
    bench.step(4)
    assert bench.now.state == ExecutorState.STOP1
    latched(bench, Cause.FEEDBACK_LOST, joint)
    bench.judge(Stop(tick, 4, STOP1_S, off=True))


def test_t34_ten_lost_answers_leave_the_braking_to_the_drives(bench):
    bench.moving()
    bench.lose(0x183, 60)
    bench.step(11)
    assert bench.now.state == ExecutorState.FAULT
    bench.step(600)
    assert all(d.stopped for d in bench.plant.drives)
    bench.one_cause(Cause.FEEDBACK_LOST, 2)
    bench.judge()


def test_t35_answers_one_period_late_are_known_as_late_by_their_echo(bench):
    bench.moving()
    bench.lose(0x183, 40, action="delay")
    bench.step(40)
    assert bench.now.state == ExecutorState.RUN
    assert bench.now.feedback_age[2] == 1
    assert [(e["cause"], e["joint"], e["value"]) for e in bench.events(WATCHDOG)] == [
        (Cause.FEEDBACK_LOST, 2, 1.0)
    ]
    bench.judge()


def test_t35_a_frozen_position_with_a_live_counter_is_noticed_within_a_tenth_of_a_second(bench):
    bench.moving()
    tick = bench.tick
    stuck = bench.plant.drives[3].q_meas
    bench.plant.drives[3].encoder = lambda _: stuck
    latched(bench, Cause.PLAUSIBILITY, 3)
    bench.judge(Stop(tick, 100, STOP1_S, off=True))


def test_t36_damaged_answers_are_counted_and_age(bench):
    bench.moving()
    tick = bench.tick
    before = bench.now.crc_errors
    bench.lose(0x183, 2, action="corrupt")
    bench.step(3)
    assert bench.now.crc_errors == before + 2
    assert bench.now.state == ExecutorState.RUN
    bench.step(3)
    tick = bench.tick
    bench.lose(0x183, 3, action="corrupt")
    latched(bench, Cause.FEEDBACK_LOST, 2)
    bench.judge(Stop(tick, 4, STOP1_S, off=True))


def wrong_frames():
    good = bytes(16)
    yield "wrong checksum", CanFrame(0x183, good, is_fd=True, brs=True)
    yield "wrong length", CanFrame(0x183, bytes(12), is_fd=True, brs=True)
    yield "classical", CanFrame(0x183, bytes(8))
    yield "unknown identifier", CanFrame(0x2F0, bytes(8))
    yield "node that is not there", CanFrame(0x188, good, is_fd=True, brs=True)
    yield "extended identifier", CanFrame(0x183, bytes(8), extended=True)
    status = fd.Status(3, 200, 40_000, ENABLED, True, False, 1.5, 0.0, 0.0, 0, 30)
    yield "counter of another time", fd.stat_frame(fd.pack_stat(status), 3)


@pytest.mark.parametrize("frame", [pytest.param(f, id=n) for n, f in wrong_frames()])
def test_t36_a_wrong_frame_changes_nothing(bench, frame):
    bench.moving()
    other = bench.join()
    q = bench.now.q_meas[2]
    other.send(frame.pack())
    bench.step(3)
    assert abs(bench.now.q_meas[2] - q) < 0.01
    bench.until(lambda s: s.plan_done)
    bench.judge()


def test_t37_a_babbling_node_is_named_and_the_drives_stop_by_themselves(bench):
    bench.moving()
    other, tick = bench.join(), bench.tick
    flood = CanFrame(0x001, bytes(8)).pack()
    bench.step(10, each=lambda: [other.send(flood) for _ in range(8)])
    assert [d.state for d in bench.plant.drives] == [DriveState.QUICK_STOP_ACTIVE] * 7
    bench.step(20, each=lambda: [other.send(flood) for _ in range(8)])
    latched(bench, Cause.BUS_LOAD)
    (begun,) = bench.events(STOP_BEGUN)
    assert begun["tick"] - tick <= 10
    assert begun["value"] > begun["limit"]
    bench.judge()


def stays_off(bench, ticks=300):
    """No setpoint with "enable" leaves, whatever time brings."""
    tick = bench.tick
    bench.step(ticks)
    trace = bench.trace()
    assert not (trace.control[trace.tick > tick] == Control.ENABLE).any()


def test_t38_bus_off_latches_and_nothing_is_enabled_again_by_itself(bench):
    bench.moving()
    bench.say(CanFrame(CAN_ERR_BUSOFF, bytes(8), is_error=True))
    bench.step(2)
    assert bench.now.state == ExecutorState.FAULT
    bench.one_cause(Cause.BUS_OFF)
    bench.step(1200)
    stays_off(bench)
    bench.command(RESET)
    bench.until(lambda s: s.state == ExecutorState.DISARMED, 600)
    stays_off(bench)
    bench.command(ARM_)
    bench.until(lambda s: s.state == ExecutorState.HOLD, 300)
    bench.judge()


def test_t38_error_passive_alone_stops_nothing(bench):
    bench.moving()
    bench.say(CanFrame(CAN_ERR_CRTL, bytes([0, 0x20, 0, 0, 0, 0, 0, 0]), is_error=True))
    bench.until(lambda s: s.plan_done)
    bench.judge()


def test_t38_a_cut_cable_latches_and_its_return_enables_nothing(bench):
    bench.moving()
    bench.lose("*", 400)
    bench.step(400)
    assert bench.now.state == ExecutorState.FAULT
    assert all(d.stopped for d in bench.plant.drives)
    bench.step(1000)
    stays_off(bench)
    bench.one_cause(Cause.FEEDBACK_LOST)
    assert len(bench.events(LATCH)) == 1


@pytest.mark.parametrize("frame", ["set", "nmt"])
def test_t39_a_second_master_stops_the_arm_within_two_ticks(bench, frame):
    bench.moving()
    other, tick = bench.join(), bench.tick
    if frame == "set":
        payload = fd.pack_set(77, Control.ENABLE, 12345, [d.q_meas for d in bench.plant.drives])
        other.send(fd.set_frame(payload).pack())
    else:
        other.send(CanFrame(0x000, bytes([2, 0])).pack())
    bench.step(2)
    bench.step(1)
    assert bench.events(STOP_BEGUN)[0]["tick"] - tick <= 2
    latched(bench, Cause.FOREIGN_MASTER)


@pytest.mark.parametrize(
    "frame", [CanFrame(0x080, b"\x05"), CanFrame(0x203, bytes(8)), CanFrame(0x000, b"\x02\x00")]
)
def test_t39_a_second_master_on_the_classical_bus_stops_the_arm(make_bench, frame):
    bench = make_bench(packing="classic")
    bench.arm()
    bench.run()
    bench.step(100)
    other, tick = bench.join(), bench.tick
    other.send(frame.pack())
    bench.step(3)
    assert bench.events(STOP_BEGUN)[0]["cause"] == Cause.FOREIGN_MASTER
    assert bench.events(STOP_BEGUN)[0]["tick"] - tick <= 2


STRAY = CanFrame(0x000, b"\x01\x63")  # network management of a node that nobody is: a master speaks


@pytest.mark.parametrize("packing", ["fd", "classic"])
def test_t39_beside_a_second_master_no_arming_begins(make_bench, packing):
    bench = make_bench(packing=packing)
    bench.step(20)
    other = bench.join()
    bench.step(20, each=lambda: other.send(STRAY.pack()))
    bench.command(ARM_)
    bench.step(20, each=lambda: other.send(STRAY.pack()))
    assert [e["value"] for e in bench.events(REJECTED)] == [Cause.FOREIGN_MASTER]
    assert bench.now.state == ExecutorState.DISARMED
    assert {d.state for d in bench.plant.drives} == {DriveState.SWITCH_ON_DISABLED}


@pytest.mark.parametrize("packing", ["fd", "classic"])
@pytest.mark.parametrize("cause", [Cause.FOREIGN_MASTER, Cause.BUS_OFF], ids=lambda cause: cause.name)
def test_t39_the_bus_is_watched_while_the_drives_are_switched_on(make_bench, packing, cause):
    bench = make_bench(packing=packing)
    bench.step(20)
    bench.plant.drives[3].brake_stuck = False  # opens late
    bench.command(ARM_)
    bench.until(lambda s: s.drive_state[0] == DriveState.OPERATION_ENABLED, 20)
    assert bench.now.state == ExecutorState.ARMING
    tick = bench.tick
    if cause == Cause.FOREIGN_MASTER:
        bench.join().send(STRAY.pack())
    else:
        bench.say(CanFrame(CAN_ERR_BUSOFF, bytes(8), is_error=True))
    bench.step(3)
    assert bench.now.state == ExecutorState.FAULT
    bench.one_cause(cause)
    assert bench.events(STOP_BEGUN)[0]["tick"] - tick <= 2


@pytest.mark.parametrize("packing", ["fd", "classic"])
def test_t38_a_bus_off_before_arming_does_not_come_back_at_it(make_bench, packing):
    bench = make_bench(packing=packing)
    bench.step(20)
    bench.say(CanFrame(CAN_ERR_BUSOFF, bytes(8), is_error=True))
    bench.step(100)
    assert [e["cause"] for e in bench.events(WATCHDOG)] == [Cause.BUS_OFF]
    bench.arm()
    bench.step(20)
    assert bench.now.state == ExecutorState.HOLD


def test_t40_a_full_transmit_queue_blocks_nothing_and_is_counted(bench):
    bench.moving()
    before = bench.now.tx_failed
    bench.lose(0x080, 2, action="enobufs")
    bench.until(lambda s: s.plan_done)
    assert bench.now.tx_failed == before + 2
    bench.judge()


def test_t40_a_transmit_queue_that_stays_full_stops_the_arm():
    bench = Stepped()
    bench.moving()
    tick = bench.now.tick
    bench.step(5, send_fails=True)
    assert bench.now.tx_failed == 5
    assert [d.state for d in bench.plant.drives] == [DriveState.QUICK_STOP_ACTIVE] * 7
    bench.until(lambda s: s.state == ExecutorState.FAULT, 1500)
    begun = bench.events(STOP_BEGUN)
    assert begun[0]["tick"] - tick <= 5
    assert begun[0]["cause"] in (Cause.TX_FAILED, Cause.FEEDBACK_LOST)
    bench.judge(gaps_allowed=True)


def test_t40_a_queue_that_was_full_for_two_ticks_makes_no_step():
    bench = Stepped()
    bench.moving()
    bench.step(2, send_fails=True)
    bench.until(lambda s: s.plan_done)
    assert bench.now.tx_failed == 2
    assert bench.events(INFO) == []
    bench.judge(gaps_allowed=True)
