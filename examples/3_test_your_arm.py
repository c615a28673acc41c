"""Hardware-in-the-loop tests: on the stand-in as they are, on the arm with --s2r-hardware ENDPOINT."""

import numpy as np
import pytest

from s2r_host.errors import ArmStoppedError, CommandRefusedError


def test_the_arm_ends_where_it_was_sent(executor):
    q_before = executor.status().q_ref
    status = executor.move_by(0.1)
    np.testing.assert_allclose(status.q_meas, q_before + 0.1, atol=5e-3)
    executor.move_by(-0.1)  # on the arm the next test, and the next run, begin where this one ends


@pytest.mark.s2r(pace=0.25)  # slow motion: there is time to ask while it moves
def test_a_stop_in_motion_brings_it_to_rest_before_the_plans_end(executor, virtual_time):
    q_before = executor.status().q_ref
    motion = executor.start_by(0.3, duration_s=4.0)
    begun = virtual_time.wait(0.8)
    executor.stop()
    executor.wait_at_rest()
    assert virtual_time.now_s - begun < 2.0
    with pytest.raises(ArmStoppedError, match="STOP_REQUESTED"):
        executor.wait_done(motion)
    executor.move_by(q_before - executor.status().q_ref)


def test_a_plan_that_is_too_fast_is_refused_by_name(executor):
    with pytest.raises(CommandRefusedError, match="velocity"):
        executor.move_by(0.1, duration_s=0.04)


@pytest.mark.s2r(faults=["drop:0x183@1-999999999"])
def test_an_arm_whose_third_drive_is_silent_is_never_enabled(standin):
    from s2r_host.testing.cell import LabExecutor

    with LabExecutor(standin) as link, link.leased(), pytest.raises((CommandRefusedError, ArmStoppedError)):
        link.arm_drives()


def test_drives_answer_every_setpoint(executor, bus_faults):
    assert len(bus_faults.watch(0x183, count=50)) == 50
