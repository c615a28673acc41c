"""T26 to T28: stops, pauses and speeds, swept. The core class in virtual time; T27 with the real ``s2r-rt``."""

from __future__ import annotations

import numpy as np
import pytest
from hil_bench import LIMITS, PAUSE, RESUME, SET_SPEED, STOP, STOP_BEGUN, Stepped, move

from s2r_executor._native import evaluate_spline
from s2r_protocol.faults import Cause, ExecutorState
from s2r_sim.bus.oracle import RAD_PER_COUNT, Stop

EVERY = {"quick": 97, "all": 1}


def on_path(plan, q):
    """Largest distance of points (n, dof) from the plan's path [rad], joint by joint at the nearest path time."""
    s = np.linspace(0.0, plan.t[-1], 28_001)
    path = evaluate_spline(plan.t, plan.q, plan.dq, plan.ddq, s)[0]
    rising = np.argmax(np.abs(path[-1] - path[0]))
    sign = np.sign(path[-1, rising] - path[0, rising])
    at = np.interp(sign * q[:, rising], sign * path[:, rising], s)
    return float(np.abs(evaluate_spline(plan.t, plan.q, plan.dq, plan.ddq, at)[0] - q).max())


def sweep(ticks, stop_s=0.5):
    worst = 0.0
    for cancel_at in ticks:
        bench = Stepped()
        plan = bench.moving(cancel_at)
        tick = bench.now.tick
        bench.command(STOP)
        bench.until(lambda s: s.state == ExecutorState.HOLD, 2500)
        bench.step(30)
        bench.judge(Stop(tick, 2, 1.2 * stop_s, off=False))
        trace = bench.trace()
        powered = trace.enabled.all(axis=1)
        worst = max(worst, on_path(plan, trace.counts[powered] * RAD_PER_COUNT))
    return worst


def test_t26_a_cancel_anywhere_in_a_plan_ends_on_its_path_quick():
    assert sweep(range(3, 1400, EVERY["quick"])) < 1e-6


@pytest.mark.prove
@pytest.mark.parametrize("part", range(10))
def test_t26_a_cancel_at_every_tick_of_a_plan_ends_on_its_path(part):
    assert sweep(range(part, 1401, 10)) < 1e-6


def test_t27_a_cancel_with_a_following_error_starts_from_the_reference(bench):
    """An executor that brakes from the measured position makes a step of the following error here: 5 mrad in a tick."""
    bench.moving(550)
    tick = bench.tick
    for drive in bench.plant.drives:
        drive.parameters = drive.parameters.__class__(**{**drive.parameters.__dict__, "ki": 0.0})
    bench.plant.drives[0].encoder = lambda q: q - 0.005
    bench.step(1)
    bench.command(STOP)
    bench.until(lambda s: s.state == ExecutorState.HOLD)
    bench.step(20)
    bench.one_cause(Cause.STOP_REQUESTED)
    bench.judge(Stop(tick + 1, 2, 0.6, off=False))


def random_orders(seed):
    """Pauses, resumes and speeds at random ticks; the plan ends where it would have without them."""
    random = np.random.default_rng(seed)
    bench = Stepped()
    plan = bench.moving(5)
    while not bench.now.plan_done:
        kind = random.choice([PAUSE, RESUME, SET_SPEED])
        state = bench.now.state
        if (kind, state) in ((PAUSE, 4), (RESUME, 5)) or kind == SET_SPEED:
            bench.command(int(kind), float(random.uniform(0.05, 1.0)) if kind == SET_SPEED else 0.0)
        for _ in range(int(random.integers(1, 400))):
            bench.motion_ticks.append(bench.now.tick)  # motion may begin again after any of these
            bench.step()
            if bench.now.plan_done:
                break
        if bench.now.state == 5:
            bench.command(RESUME)
            bench.step(2)
    bench.step(30)
    assert bench.events(STOP_BEGUN) == []
    bench.judge()
    np.testing.assert_allclose(bench.now.q_ref, plan.q[-1], atol=1e-9)
    trace = bench.trace()
    assert on_path(plan, trace.counts[trace.enabled.all(axis=1)] * RAD_PER_COUNT) < 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_t28_random_pauses_and_speeds_keep_to_the_path_and_end_where_planned_quick(seed):
    random_orders(seed)


@pytest.mark.prove
@pytest.mark.parametrize("part", range(10))
def test_t28_random_pauses_and_speeds_keep_to_the_path_and_end_where_planned(part):
    for seed in range(10 + 10 * part, 20 + 10 * part):
        random_orders(seed)


def test_t28_the_fastest_legal_plan_still_has_room_for_its_stop():
    bench = Stepped()
    bench.step(1)
    plan = move(np.array([d.q_meas for d in bench.plant.drives]), 0.6, 1.2, stop_s=0.7)
    bench.moving(400, plan)
    assert np.abs(bench.now.dq_ref / LIMITS.dq_max).max() > 0.2
    bench.command(STOP)
    bench.until(lambda s: s.state == ExecutorState.HOLD)
    bench.judge()
