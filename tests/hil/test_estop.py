"""T48 to T50: the emergency stop chain and the way out of a latch. Real ``s2r-rt``, virtual time (lock-step)."""

from __future__ import annotations

import numpy as np
import pytest
from hil_bench import ARM_, LATCH, LIMITS, REJECTED, RESET, STATE, STOP_BEGUN, move

from s2r_protocol.can.drive import DriveError, DriveState
from s2r_protocol.faults import Cause, ExecutorState
from s2r_sim.bus.oracle import Stop, longest_joint_stop_s


def press(bench, channels=3):
    for drive in bench.plant.drives:
        drive.estop_open = channels


def nothing_moves(bench, ticks=300):
    """Neither setpoints of enabled drives nor joints."""
    q = np.array(bench.plant.q)
    tick = bench.tick
    bench.step(ticks)
    trace = bench.trace()
    assert not (trace.control[trace.tick > tick + 1] == 2).any()
    np.testing.assert_allclose(bench.plant.q, q, atol=1e-3)


@pytest.mark.parametrize("phase", [0, 1, 40, 200, 613, 900, 1399, 1450])
def test_t48_emergency_stop_at_any_moment_is_taken_up_in_one_tick_and_release_moves_nothing(bench, phase):
    bench.moving(phase)
    tick = bench.tick
    press(bench)
    bench.step(2)
    assert bench.now.state == ExecutorState.ESTOP
    bench.one_cause(Cause.ESTOP)
    assert (
        bench.events(STOP_BEGUN)[0]["tick"] - tick <= 2
    )  # the answer with the open chain, and the tick after it
    bench.step(400)
    press(bench, 0)
    nothing_moves(bench)
    assert bench.now.state == ExecutorState.ESTOP
    bench.judge(Stop(tick, 2, 0.0, off=True, braking=False))


def test_t48_the_way_back_is_reset_and_arm(bench):
    bench.moving()
    press(bench)
    bench.step(300)
    bench.command(RESET)
    bench.step(700)
    assert bench.now.state == ExecutorState.ESTOP  # still pressed
    assert len(bench.events(REJECTED)) == 1
    press(bench, 0)
    bench.step(5)
    bench.command(RESET)
    bench.until(lambda s: s.state == ExecutorState.DISARMED, 600)
    nothing_moves(bench, 100)
    bench.command(ARM_)
    bench.until(lambda s: s.state == ExecutorState.HOLD, 300)
    bench.run(move(np.asarray(bench.now.q_ref), 0.1), plan_id=2)
    bench.until(lambda s: s.plan_done)
    bench.judge()


def test_t48_pressed_while_off_it_keeps_the_arm_off(bench):
    bench.step(5)
    press(bench)
    bench.step(3)
    assert bench.now.state == ExecutorState.ESTOP
    bench.command(ARM_)
    bench.step(50)
    assert bench.now.state == ExecutorState.ESTOP
    press(bench, 0)
    bench.step(5)
    bench.command(RESET)
    bench.until(lambda s: s.state == ExecutorState.DISARMED, 600)
    bench.judge()


def test_t49_one_channel_only_is_a_discrepancy(bench):
    bench.moving()
    press(bench, 1)
    bench.step(2)
    assert bench.now.state == ExecutorState.ESTOP
    bench.step(80)
    assert bench.now.cause == Cause.ESTOP_DISCREPANCY
    assert len(bench.events(LATCH)) == 2  # the stop, and what was found out about it
    nothing_moves(bench)


@pytest.mark.parametrize("channel", [1, 2])
def test_t49_a_bouncing_contact_of_one_channel_is_latched_as_a_discrepancy(bench, channel):
    bench.moving()
    for open_ in (channel, 0, channel, channel, 0, 0):
        press(bench, open_)
        bench.step(2)
    assert bench.now.state == ExecutorState.ESTOP
    assert bench.now.cause == Cause.ESTOP_DISCREPANCY
    nothing_moves(bench)


def test_t49_bounce_of_both_channels_is_an_ordinary_emergency_stop(bench):
    bench.moving()
    for open_ in (1, 3, 2, 3, 1, 3):
        press(bench, open_)
        bench.step(2)
    bench.step(100)
    assert bench.now.cause == Cause.ESTOP


def test_t50_reset_before_the_cause_is_cleared_stays_latched(bench):
    bench.moving()
    drive = bench.plant.drives[2]
    drive._fail(DriveError.ENCODER, DriveState.FAULT_REACTION)
    bench.until(lambda s: s.state == ExecutorState.FAULT, 1500)
    drive.command = lambda *_: None  # the cause is still there: it obeys no reset
    bench.command(RESET)
    bench.step(700)
    assert bench.now.state == ExecutorState.FAULT
    assert bench.events(REJECTED)[-1]["joint"] == 2
    del drive.command
    bench.command(RESET)
    bench.until(lambda s: s.state == ExecutorState.DISARMED, 700)
    assert bench.now.cause == Cause.DRIVE_FAULT  # still told, until somebody arms
    bench.judge()


def test_t50_reset_held_high_before_the_fault_does_not_reset_it(bench):
    """RESET is an order, not a level: those that come before the latch are refused and leave nothing behind."""
    bench.moving()
    for _ in range(20):
        bench.command(RESET)
        bench.step()
    bench.plant.drives[2]._fail(DriveError.ENCODER, DriveState.FAULT_REACTION)
    bench.until(lambda s: s.state == ExecutorState.FAULT, 1500)
    bench.step(700)
    assert bench.now.state == ExecutorState.FAULT
    assert ExecutorState.DISARMED not in [e["state"] for e in bench.events(STATE)][2:]
    bench.judge(Stop(bench.events(STOP_BEGUN)[0]["tick"], 2, longest_joint_stop_s(LIMITS), off=True))
