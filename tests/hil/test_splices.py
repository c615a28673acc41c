"""T22 to T25: a new plan while one runs, through admission, the front end and the real ``s2r-rt``; virtual time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hil_bench import STARTED, STOP_BEGUN
from hil_front_end import Rig, move, onward, state_at

from s2r_executor.plan import CommandRefusedError
from s2r_protocol.faults import Refusal


@pytest.fixture
def rig(make_bench):
    rig = Rig(make_bench(collision_share=10.0))
    rig.arm()
    return rig


def running(rig, ticks=400):
    plan = move(rig.bench.now.q_ref)
    seq = rig.send(plan)
    rig.tick(ticks)
    return plan, seq


def test_t22_a_splice_that_meets_the_running_plan_is_played_without_a_jump(rig):
    parent, seq = running(rig)
    child = onward(state_at(parent, 0.8), np.full(7, 0.02), parent_seq=seq, splice_t=0.8)
    rig.send(child)
    assert rig.bench.now.next_plan_id == 2
    rig.until(lambda s: s.plan_id == 2)
    taken_over = rig.bench.tick
    rig.until(lambda s: s.plan_done)
    np.testing.assert_allclose(rig.bench.now.q_ref, child.q[-1], atol=1e-9)
    assert rig.bench.events(STOP_BEGUN) == []
    assert len(rig.bench.events(STARTED)) == 2
    rig.bench.judge()
    # C2: the setpoints around the take-over are the two plans, to the rounding of the wire.
    trace = rig.bench.trace()
    around = (trace.tick > taken_over - 20) & (trace.tick <= taken_over + 20)
    jumps = np.diff(trace.counts[around], n=3, axis=0) * 4e-9 / 1e-9
    assert np.abs(jumps).max() < 300 * 1.02 + 4 * 4e-9 / 1e-9


@pytest.mark.parametrize("offset", [1e-3, -5e-3])
def test_t23_a_splice_that_misses_is_bridged_inside_the_limits(rig, offset):
    parent, seq = running(rig)
    state = state_at(parent, 0.8)
    state.q = state.q + offset
    child = onward(state, np.full(7, 0.02), parent_seq=seq, splice_t=0.8)
    rig.send(child)
    rig.until(lambda s: s.plan_done)
    np.testing.assert_allclose(rig.bench.now.q_ref, child.q[-1], atol=1e-9)
    assert rig.bench.events(STOP_BEGUN) == []
    rig.bench.judge()


def goes_on(rig, parent, refusal, plan, **expected):
    """The plan is refused with its numbers, and the running one ends as if nothing had been asked."""
    with pytest.raises(CommandRefusedError) as caught:
        rig.send(plan)
    error = caught.value
    assert error.code is refusal
    for name, value in expected.items():
        assert getattr(error, name) == value
    rig.until(lambda s: s.plan_done)
    np.testing.assert_array_equal(rig.bench.now.q_ref, parent.q[-1])
    assert rig.bench.events(STOP_BEGUN) == []
    rig.bench.judge()
    return error


def test_t23_a_splice_far_off_is_refused_and_the_running_plan_goes_on(rig):
    parent, seq = running(rig)
    state = state_at(parent, 0.8)
    state.q = state.q + np.array([0, 0, 0.05, 0, 0, 0, 0])
    plan = onward(state, np.zeros(7), parent_seq=seq, splice_t=0.8)
    error = goes_on(rig, parent, Refusal.SPLICE, plan, joint="joint3", quantity="position", t=0.8, limit=0.02)
    assert error.value == pytest.approx(0.05)


@pytest.mark.parametrize("ahead", [-0.2, 0.0, 0.02])
def test_t24_a_splice_too_soon_or_in_the_past_is_late_and_the_running_plan_goes_on(rig, ahead):
    parent, seq = running(rig)
    at = rig.bench.now.plan_t + ahead
    plan = onward(state_at(parent, at), np.zeros(7), parent_seq=seq, splice_t=at)
    error = goes_on(rig, parent, Refusal.LATE, plan, quantity="splice_t")
    assert error.limit == pytest.approx(error.value - ahead + 0.05, abs=5e-3)


def test_t24_a_splice_that_the_core_gets_too_late_is_refused_by_the_core(rig):
    """Admission takes longer than the horizon: the core looks at its own time and has the last word."""
    parent, seq = running(rig)
    at = rig.bench.now.plan_t + 0.06
    plan = onward(state_at(parent, at), np.zeros(7), parent_seq=seq, splice_t=at)
    admit = rig.front_end._admission.admit_splice

    def slowly(*arguments):
        admitted = admit(*arguments)
        rig.tick(100)
        return admitted

    rig.front_end._admission.admit_splice = slowly
    error = goes_on(rig, parent, Refusal.LATE, plan)
    assert "splice further ahead" in str(error)
    assert error.value == pytest.approx(at)


@pytest.mark.parametrize(
    ("change", "refusal"),
    [
        ({"parent_seq": 999}, Refusal.SPLICE),
        ({"splice_t": 2.5}, Refusal.SPLICE),
        ({"parent_seq": 0}, Refusal.SPLICE),
    ],
)
def test_t24_a_splice_into_something_else_is_refused(rig, change, refusal):
    parent, seq = running(rig)
    plan = replace(onward(state_at(parent, 0.8), np.zeros(7), parent_seq=seq, splice_t=0.8), **change)
    goes_on(rig, parent, refusal, plan)


def test_t24_a_splice_while_the_arm_holds_is_refused(rig):
    with pytest.raises(CommandRefusedError) as caught:
        rig.send(move(rig.bench.now.q_ref, parent_seq=1, splice_t=0.5))
    assert caught.value.code is Refusal.STATE


def test_t25_a_newer_replacement_wins_over_one_that_waits(rig):
    parent, seq = running(rig)
    first = onward(state_at(parent, 1.2), np.full(7, 0.02), parent_seq=seq, splice_t=1.2)
    second = onward(state_at(parent, 0.9), np.full(7, -0.02), parent_seq=seq, splice_t=0.9)
    rig.send(first)
    rig.send(second)
    rig.until(lambda s: s.plan_done)
    np.testing.assert_allclose(rig.bench.now.q_ref, second.q[-1], atol=1e-9)
    rig.bench.judge()


def test_t25_random_replacements_at_fifty_hertz_never_break_a_limit_quick(rig):
    """A reactive planner: every 20 ms a new goal, from where the arm will be in 80 ms."""
    random = np.random.default_rng(25)
    running_plan, seq = running(rig, 100)
    accepted, refusals = 0, []
    for _ in range(60):
        now = rig.bench.now
        at = now.plan_t + 0.08
        if at < running_plan.t[-1]:
            change = random.uniform(-0.03, 0.03, 7)
            plan = onward(state_at(running_plan, at), change, parent_seq=seq, splice_t=at)
            try:
                new_seq = rig.send(plan)
                accepted += 1
                rig.until(lambda s: s.next_plan_id == 0)
                running_plan, seq = plan, new_seq
            except CommandRefusedError as error:
                refusals.append(error.code)
        rig.tick(20)
    assert accepted > 40
    assert set(refusals) <= {Refusal.JERK, Refusal.ACCELERATION, Refusal.NO_STOP_PATH, Refusal.POSITION}
    rig.until(lambda s: s.plan_done)
    np.testing.assert_allclose(rig.bench.now.q_ref, running_plan.q[-1], atol=1e-6)
    assert rig.bench.events(STOP_BEGUN) == []
    rig.bench.judge()
