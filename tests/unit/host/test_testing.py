"""What a hardware-in-the-loop test may get wrong is said in its own words."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from s2r_host.testing.cell import BusFaults, LabExecutor, VirtualTime
from s2r_host.testing.plugin import _wanted
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import UsageError

ARM = load_arm("xmate3pro")


@pytest.mark.parametrize(
    ("mark", "other"), [(pytest.mark.s2r(sed=7), "not sed"), (pytest.mark.s2r(7), "not 7")]
)
def test_a_marker_the_stand_in_does_not_know_fails_the_test(mark, other):
    with pytest.raises(pytest.fail.Exception, match=f"takes seed=….*{other}"):
        _wanted(mark.mark)
    assert _wanted(pytest.mark.s2r(seed=7, pace=0).mark) == {"seed": 7, "pace": 0}
    assert _wanted(None) == {}


@pytest.mark.parametrize(
    ("step", "duration_s", "says"),
    [
        ([0.1, 0.2], None, r"shape \(2,\): give one value, or one for each of joint1, joint2"),
        (0.1, 0.0, "duration_s = 0 s"),
        (0.1, float("nan"), "duration_s = nan s"),
    ],
)
def test_a_motion_that_is_none_is_refused_before_it_is_sent(step, duration_s, says):
    link = SimpleNamespace(
        lab=SimpleNamespace(arm=ARM), status=lambda: SimpleNamespace(q_ref=np.zeros(ARM.dof))
    )
    with pytest.raises(UsageError, match=says):
        LabExecutor.start_by(link, step, duration_s)


@pytest.mark.parametrize("seconds", [-1.0, float("nan"), float("inf")])
def test_only_a_time_is_waited_for(seconds):
    with pytest.raises(UsageError, match="give 0 s or more"):
        VirtualTime(SimpleNamespace(identity=SimpleNamespace(tick_ns=1_000_000))).wait(seconds)


def test_a_frame_that_came_in_the_last_moment_has_come():
    class Bus:
        def recv(self, timeout):
            time.sleep(0.1)  # a busy machine
            return SimpleNamespace(arbitration_id=0x81, data=b"\x01")

    faults = BusFaults.__new__(BusFaults)
    faults._bus = Bus()
    assert faults.watch(0x81, wall_limit_s=0.05) == [b"\x01"]
    with pytest.raises(TimeoutError, match=r"0 of 1 frames 0x82 within 0\.05 s"):
        faults.watch(0x82, wall_limit_s=0.05)
