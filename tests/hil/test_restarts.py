"""T06, T51, T52: parts that die and come back. Real ``s2r-rt`` on the bus model, virtual time (lock-step)."""

from __future__ import annotations

import numpy as np
import pytest
from hil_bench import ARM_, LIMITS, RESET, STOP_BEGUN, WATCHDOG, move

from s2r_protocol.can.drive import DriveError, DriveState
from s2r_protocol.faults import Cause, ExecutorState
from s2r_sim.drives import QUICK_STOP_OVER_LIMIT


def test_t06_when_the_core_is_killed_the_drives_stop_by_themselves_and_brake(bench):
    bench.moving()
    speeds = np.abs([d._dq_set for d in bench.plant.drives])
    assert speeds.max() > 0.5
    bench.child.kill()
    bench.child.wait()
    bench._waiting.clear()
    ticks = bench.bus.ticks
    while any(d._dq_set != 0 for d in bench.plant.drives):
        bench.bus.tick()
        assert bench.bus.ticks - ticks < 500
    ramp_s = (speeds / (QUICK_STOP_OVER_LIMIT * LIMITS.ddq_max)).max()
    assert bench.bus.ticks - ticks <= 4 + np.ceil(ramp_s * 1e3) + 1  # the watchdog, then the ramp
    while not bench.plant.at_rest:
        bench.bus.tick()
        assert bench.bus.ticks - ticks < 500
    assert {d.error for d in bench.plant.drives} == {DriveError.COMMUNICATION}
    assert not any(d.brake_released for d in bench.plant.drives)


@pytest.mark.parametrize("moving", [False, True], ids=["while holding", "while moving"])
def test_t51_a_restarted_executor_comes_up_disarmed_and_arms_without_a_step(bench, moving):
    bench.moving(600) if moving else bench.arm()
    first = bench.master
    bench.judge()
    bench.child.kill()
    bench.child.wait()
    bench._waiting.clear()
    for client, packet in bench.hub.receive(1.0):
        if packet is None:
            bench.bus._master_left(client)
    assert all(d.stopped for d in bench.plant.drives)
    bench.arm_ticks.clear()
    bench.motion_ticks.clear()
    bench._events.clear()
    q = np.array(bench.plant.q)
    bench.start()
    bench.step(50)
    assert bench.now.state == ExecutorState.DISARMED
    assert bench.master != first
    np.testing.assert_allclose(bench.plant.q, q, atol=1e-3)  # brakes give a little
    bench.arm()
    bench.step(100)
    np.testing.assert_allclose(bench.plant.q, q, atol=1e-3)
    bench.run(move(np.asarray(bench.now.q_ref), 0.1))
    bench.until(lambda s: s.plan_done)
    bench.judge()


def test_t52_a_drive_that_loses_its_power_needs_reset_and_arm(bench):
    bench.moving()
    drive = bench.plant.drives[4]
    drive._enter(DriveState.NOT_READY)
    drive._walk = lambda: None
    bench.until(lambda s: s.state == ExecutorState.FAULT, 1500)
    bench.one_cause(Cause.DRIVE_NOT_ENABLED, 4)
    bench.step(100)
    del drive._walk
    drive._enter(DriveState.SWITCH_ON_DISABLED)  # powered again, self test passed
    bench.step(500)
    assert bench.now.state == ExecutorState.FAULT
    assert [d.state for d in bench.plant.drives] == [DriveState.SWITCH_ON_DISABLED] * 7
    bench.command(ARM_)
    bench.step(20)
    assert bench.now.state == ExecutorState.FAULT
    bench.arm_ticks.pop()
    bench.command(RESET)
    bench.until(lambda s: s.state == ExecutorState.DISARMED, 600)
    bench.command(ARM_)
    bench.until(lambda s: s.state == ExecutorState.HOLD, 300)
    assert len(bench.events(STOP_BEGUN)) == 1
    bench.judge()


@pytest.mark.parametrize("brake_feedback", [True, False], ids=["brakes told", "brakes not told"])
@pytest.mark.parametrize("packing", ["fd", "classic"])
@pytest.mark.parametrize("ticks", [0, 30, 100])
def test_t52_a_drive_whose_power_returns_during_the_stop_stays_off(
    make_bench, packing, brake_feedback, ticks
):
    """It obeys as before: enabled again, it would step to where the reference has gone meanwhile."""
    bench = make_bench(packing=packing, brake_feedback=brake_feedback)
    bench.moving(150 if packing == "classic" else 600)
    drive = bench.plant.drives[1]
    drive._enter(DriveState.SWITCH_ON_DISABLED)
    drive._walk = lambda: None
    states = []

    def watch():
        if len(states) == ticks:
            del drive._walk
        states.append(drive.state)

    bench.until(lambda s: s.state == ExecutorState.STOP1, 5, watch)
    bench.until(lambda s: s.state == ExecutorState.FAULT, 1500, watch)
    assert not bench.now.dq_ref.any()
    bench.step(200, watch)
    assert DriveState.OPERATION_ENABLED not in states
    bench.one_cause(Cause.DRIVE_NOT_ENABLED, 1)
    assert Cause.BRAKE not in {e["cause"] for e in bench.events(WATCHDOG)}  # the others braked under control
    bench.command(RESET)
    bench.until(lambda s: s.state == ExecutorState.DISARMED, 600, watch)
    assert DriveState.OPERATION_ENABLED not in states
    bench.command(ARM_)
    bench.until(lambda s: s.state == ExecutorState.HOLD, 300)
    assert drive.state == DriveState.OPERATION_ENABLED
