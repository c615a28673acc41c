"""The oracle itself: a good trace passes, and each kind of wrong one is named."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_sim.bus.oracle import Limits, Stop, Trace, judge

N, DOF, UNIT = 2000, 7, 4e-9
LIMITS = Limits(*(np.full(DOF, x) for x in (-2.0, 2.0, 3.0, 6.0, 300.0)))
ARM, PLAN = 5, 105


def trace(moved=1.0):
    """Armed at tick 5, a minimum-jerk move of 0.5 rad from tick 106 to 1106."""
    tick = np.arange(N)
    x = np.clip((tick - 105) / 1000, 0, 1)
    q = 0.5 * moved * (10 * x**3 - 15 * x**4 + 6 * x**5)
    counts = np.repeat(np.round(q / UNIT).astype(np.int64)[:, None], DOF, axis=1)
    control = np.where(tick > ARM, 2, 0)
    enabled = np.repeat((tick > ARM + 2)[:, None], DOF, axis=1)
    return Trace(tick, control, counts, enabled, np.zeros_like(enabled), 1e-3)


def found(t, **more):
    options = {"arm_ticks": [ARM], "motion_ticks": [PLAN], **more}
    return {(v.invariant, v.quantity) for v in judge(t, LIMITS, **options).violations}


def changed(at, amount, joint=3):
    counts = trace().counts.copy()
    counts[at:, joint] += round(amount / UNIT)
    return replace(trace(), counts=counts)


def cut(ticks):
    """The first of the trace alone."""
    t = trace()
    return Trace(
        t.tick[:ticks], t.control[:ticks], t.counts[:ticks], t.enabled[:ticks], t.faulty[:ticks], t.dt
    )


def test_a_good_trace_has_no_violation_and_tells_its_use_of_limits():
    report = judge(trace(), LIMITS, None, [ARM], [PLAN])
    assert not report.violations
    assert report.use["velocity"] == pytest.approx(0.9375 / 3.0, rel=1e-3)
    assert report.use["acceleration"] == pytest.approx(2.887 / 6.0, rel=1e-2)


@pytest.mark.parametrize(
    ("t", "violation"),
    [
        (changed(600, 0.01), ("I1", "velocity")),
        (changed(600, 2e-5), ("I1", "acceleration")),
        (changed(600, 1e-6), ("I1", "jerk")),
        (trace(4.2), ("I1", "position")),
        (changed(1500, 1e-7), ("I3", "motion begins without an order")),
        (
            replace(trace(), control=np.where(np.arange(N) == 1400, 0, trace().control)),
            ("I3", "drives enabled without an order"),
        ),
        (replace(trace(), tick=np.arange(N) + (np.arange(N) > 900)), ("I6", "ticks to the next setpoint")),
    ],
)  # fmt: skip
def test_each_kind_of_wrong_trace_is_named(t, violation):
    assert violation in found(t)


def test_an_order_older_than_the_last_stand_still_moves_nothing():
    assert ("I3", "motion begins without an order") in found(trace(), motion_ticks=[])
    assert ("I3", "drives enabled without an order") in found(trace(), arm_ticks=[])


def test_a_stop_that_does_not_come_that_comes_late_or_leaves_the_drives_on_is_named():
    assert ("I2", "speed after the stop") in found(trace(), stop=Stop(500, 2, 0.1, off=False))
    assert ("I2", "drives enabled after the stop") in found(trace(), stop=Stop(500, 2, 0.7, off=True))
    assert not found(trace(), stop=Stop(500, 2, 0.7, off=False))
    assert ("I5", "trace ends before the stop") in found(trace(), stop=Stop(N - 2, 2, 0.1, off=False))


def test_a_trace_that_ends_within_the_time_for_a_stop_has_to_end_with_it():
    assert ("I2", "speed after the stop") in found(cut(900), stop=Stop(500, 2, 0.7, off=False))
    assert ("I2", "drives enabled after the stop") in found(cut(1500), stop=Stop(1200, 2, 0.7, off=True))
    assert not found(cut(1500), stop=Stop(1000, 2, 0.7, off=False))


def test_speeding_up_after_a_stop_decision_is_named():
    """The move is still gaining speed at its quarter; a joint-space stop would not."""
    assert ("I2", "speed while stopping") in found(trace(), stop=Stop(300, 2, 0.9, off=True))
