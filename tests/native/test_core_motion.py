"""The core in virtual time: arming, plans, stops on the path, pause, speed, splices."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from s2r_protocol.faults import Cause, ExecutorState, Refusal

ARM, DISARM, STOP, PAUSE, RESUME, SET_SPEED, RESET = range(1, 8)
PLAN_STARTED, PLAN_DONE, REJECTED, STOP_BEGUN, STOP_DONE = 2, 3, 4, 5, 6


def on_path(cell, plan) -> float:
    """Largest distance [rad] between the recorded reference and the plan at the recorded path time."""
    from s2r_executor import _native

    records = cell.shared.records(65536)
    moving = records[np.isin(records["state"], [4, 5, 6]) & (records["plan_id"] == 1)]
    q, _, _, _ = _native.evaluate_spline(plan.t, plan.q, plan.dq, plan.ddq, moving["plan_t"].copy())
    return float(np.abs(q - moving["q_ref"]).max())


def test_arming_adopts_the_measured_position_and_moves_nothing(cell):
    start = list(cell.drives.counts)
    cell.step(3)
    assert cell.state.state == ExecutorState.DISARMED
    assert {ctrl for _, ctrl, _ in cell.drives.setpoints} == {0}
    cell.command(ARM)
    snapshot = cell.until(lambda s: s.state == ExecutorState.HOLD, 20)
    cell.step(10)
    assert list(snapshot.drive_state) == [4] * 7
    assert cell.drives.counts == start
    assert (cell.emitted() == start).all()
    assert np.abs(snapshot.q_ref - 4e-9 * np.array(start)).max() < 1e-15


def test_drives_are_switched_on_before_they_are_enabled(armed):
    requests = [ctrl for _, ctrl, _ in armed.drives.setpoints]
    first_seen = sorted(set(requests), key=requests.index)
    assert first_seen == [0, 1, 2]
    assert requests == sorted(requests)


def test_enabled_drive_keeps_its_setpoint_while_others_are_not_yet_enabled(cell):
    cell.drives.offset[0] = 1000  # following its own answer, this joint would creep
    cell.drives.stuck[4] = 3
    cell.step(3)
    cell.command(ARM)
    cell.step(30)
    assert cell.state.state == ExecutorState.ARMING
    assert cell.drives.state[0] == 4
    del cell.drives.stuck[4]
    cell.until(lambda s: s.state == ExecutorState.HOLD, 10)
    assert len(set(cell.emitted()[1:, 0])) == 1


def test_arming_resets_the_speed(armed):
    armed.command(SET_SPEED, 0.5)
    armed.command(DISARM)
    armed.step(5)
    armed.command(ARM)
    armed.until(lambda s: s.state == ExecutorState.HOLD, 20)
    assert armed.state.speed_scale == 1.0


def test_arming_bumps_the_epoch(cell):
    cell.step(3)
    before = cell.state.epoch
    cell.command(ARM)
    cell.step(10)
    assert cell.state.epoch == before + 1


def test_plan_is_played_to_its_end_inside_all_limits(armed, plan_from, use_of_limits):
    plan = plan_from(armed.state.q_ref)
    armed.run_plan(plan)
    snapshot = armed.until(lambda s: s.plan_done, 1500)
    assert snapshot.state == ExecutorState.HOLD
    assert snapshot.plan_id == 1
    assert np.abs(snapshot.q_ref - plan.q[-1]).max() < 1e-12
    assert use_of_limits(armed.emitted()) < 0.5
    assert on_path(armed, plan) < 1e-12
    assert [e["plan_id"] for e in armed.events(PLAN_STARTED)] == [1]
    assert [e["plan_id"] for e in armed.events(PLAN_DONE)] == [1]


def test_plan_takes_as_many_ticks_as_it_is_long(armed, plan_from):
    armed.run_plan(plan_from(armed.state.q_ref, duration_s=1.4))
    first = armed.state.tick
    armed.until(lambda s: s.plan_done, 1500)
    assert armed.state.tick - first + 1 == 1400


def test_same_inputs_give_the_same_setpoints(make_cell, plan_from):
    def run() -> list:
        cell = make_cell()
        cell.arm()
        cell.run_plan(plan_from(cell.state.q_ref))
        cell.step(300)
        cell.command(PAUSE)
        cell.step(700)
        cell.command(RESUME)
        cell.step(100)
        cell.command(STOP)
        cell.step(700)
        return cell.drives.setpoints

    assert run() == run()


@pytest.mark.parametrize(
    "at_tick", [0, 1, 7, 60, 199, 200, 201, 350, 500, 700, 850, 1000, 1100, 1200, 1390, 1398]
)
def test_stop_request_ends_on_the_path_inside_all_limits(armed, plan_from, use_of_limits, at_tick):
    plan = plan_from(armed.state.q_ref)
    armed.run_plan(plan)
    armed.step(at_tick)
    epoch = armed.state.epoch
    armed.command(STOP)
    armed.step()
    assert armed.state.state in (ExecutorState.STOPPING, ExecutorState.HOLD)
    assert armed.state.epoch == epoch + 1
    snapshot = armed.until(lambda s: s.state == ExecutorState.HOLD, 620)
    armed.step(20)
    assert snapshot.cause == Cause.STOP_REQUESTED
    assert not armed.state.plan_done
    assert use_of_limits(armed.emitted()) <= 1.0
    assert (np.diff(armed.emitted()[-20:], axis=0) == 0).all()
    assert on_path(armed, plan) < 1e-12
    assert list(armed.state.drive_state) == [4] * 7


def test_reference_velocity_and_acceleration_are_the_derivatives_of_its_position(armed, plan_from):
    armed.run_plan(plan_from(armed.state.q_ref))
    armed.step(500)
    armed.command(STOP)
    armed.step(650)
    records = armed.shared.records(65536)
    records = records[np.isin(records["state"], [ExecutorState.RUN, ExecutorState.STOPPING])]
    q, dq, ddq = records["q_ref"], records["dq_ref"], records["ddq_ref"]
    dt = 1e-3
    assert np.abs((q[2:] - q[:-2]) / (2 * dt) - dq[1:-1]).max() < 300.0 * dt**2
    assert np.abs((dq[2:] - dq[:-2]) / (2 * dt) - ddq[1:-1]).max() < 300.0 * dt


def test_stop_takes_the_ramp_of_its_segment(armed, plan_from):
    armed.run_plan(plan_from(armed.state.q_ref))
    armed.step(500)
    armed.command(STOP)
    armed.step()
    first = armed.state.tick
    armed.until(lambda s: s.state == ExecutorState.HOLD, 700)
    assert armed.state.tick - first + 1 == 600


def test_stop_shortly_before_the_end_lets_the_plan_end(armed, plan_from):
    plan = plan_from(armed.state.q_ref)
    armed.run_plan(plan)
    armed.step(1200)
    armed.command(STOP)
    first = armed.state.tick
    snapshot = armed.until(lambda s: s.state == ExecutorState.HOLD, 250)
    assert snapshot.tick - first == 1400 - 1201  # not a tick later than without the stop
    assert np.abs(snapshot.q_ref - plan.q[-1]).max() < 1e-12


def test_stop_while_holding_voids_the_epoch_and_changes_nothing_else(armed):
    before = armed.state
    armed.command(STOP, float(Cause.HOST_LOST))
    armed.step(5)
    after = armed.state
    assert after.state == ExecutorState.HOLD
    assert after.cause == Cause.HOST_LOST
    assert after.epoch == before.epoch + 1
    assert [e["cause"] for e in armed.events(STOP_DONE)] == [Cause.HOST_LOST]


def test_stop_is_taken_whatever_its_epoch(armed, plan_from):
    armed.run_plan(plan_from(armed.state.q_ref))
    armed.step(300)
    armed.command(STOP, epoch=12345)
    armed.step()
    assert armed.state.state == ExecutorState.STOPPING


def test_unknown_stop_cause_still_stops(armed, plan_from):
    armed.run_plan(plan_from(armed.state.q_ref))
    armed.step(300)
    armed.command(STOP, float("nan"))
    armed.step()
    assert armed.state.state == ExecutorState.STOPPING
    assert armed.state.cause == Cause.STOP_REQUESTED


@pytest.mark.parametrize("at_tick", [100, 400, 700, 1000])
def test_pause_stands_still_and_resume_ends_at_the_same_pose(armed, plan_from, use_of_limits, at_tick):
    plan = plan_from(armed.state.q_ref)
    armed.run_plan(plan)
    armed.step(at_tick)
    armed.command(PAUSE)
    paused = armed.until(lambda s: s.state == ExecutorState.PAUSED, 700)
    assert paused.cause == Cause.PAUSE_REQUESTED
    assert paused.speed_scale == 0.0
    armed.step(50)
    assert armed.state.plan_t == paused.plan_t
    armed.command(RESUME)
    snapshot = armed.until(lambda s: s.plan_done, 2500)
    assert np.abs(snapshot.q_ref - plan.q[-1]).max() < 1e-12
    assert use_of_limits(armed.emitted()) <= 1.0
    assert on_path(armed, plan) < 1e-12


def test_resume_during_the_pause_ramp_and_stop_during_the_resume_stay_inside_limits(
    armed, plan_from, use_of_limits
):
    plan = plan_from(armed.state.q_ref)
    armed.run_plan(plan)
    armed.step(400)
    armed.command(PAUSE)
    armed.step(250)
    armed.command(RESUME)
    armed.step(200)
    armed.command(STOP)
    armed.until(lambda s: s.state == ExecutorState.HOLD, 1500)
    assert use_of_limits(armed.emitted()) <= 1.0
    assert on_path(armed, plan) < 1e-12


@pytest.mark.parametrize("resumed_ticks", [20, 75, 100, 140])
def test_a_stop_during_a_resume_into_segments_with_longer_ramps_slows_down_at_once(
    armed, plan_from, use_of_limits, resumed_ticks
):
    plan = plan_from(armed.state.q_ref, distance=0.4)
    plan = dataclasses.replace(plan, stop_duration=np.array([0.15, 0.15, 0.6, 0.6, 0.6, 0.6, 0.6]))
    armed.run_plan(plan)
    armed.step(150)
    armed.command(PAUSE)
    armed.until(lambda s: s.state == ExecutorState.PAUSED, 200)
    armed.command(RESUME)
    armed.step(resumed_ticks)
    armed.command(STOP)
    armed.step()
    rates = []
    while armed.state.state == ExecutorState.STOPPING:
        rates.append(armed.state.speed_scale)
        armed.step()
    assert armed.state.state == ExecutorState.HOLD
    assert max(rates) <= 1.0
    assert armed.state.plan_t < 0.7  # of 1.4 s
    assert use_of_limits(armed.emitted()) <= 1.0
    assert on_path(armed, plan) < 1e-12


def test_speed_scale_slows_the_plan_and_keeps_its_end(armed, plan_from, use_of_limits):
    plan = plan_from(armed.state.q_ref)
    armed.run_plan(plan)
    armed.step(300)
    armed.command(SET_SPEED, 0.25)
    armed.step(650)
    assert armed.state.speed_scale == pytest.approx(0.25)
    armed.command(SET_SPEED, 1.0)
    snapshot = armed.until(lambda s: s.plan_done, 4000)
    assert np.abs(snapshot.q_ref - plan.q[-1]).max() < 1e-12
    assert use_of_limits(armed.emitted()) <= 1.0
    assert on_path(armed, plan) < 1e-12


def test_speed_set_while_holding_counts_for_the_next_plan(armed, plan_from):
    armed.command(SET_SPEED, 0.5)
    armed.step()
    armed.run_plan(plan_from(armed.state.q_ref))
    first = armed.state.tick
    armed.until(lambda s: s.plan_done, 4000)
    assert armed.state.tick - first + 1 == 2800


@pytest.mark.parametrize("value", [0.0, -0.5, 1.0001, float("nan"), float("inf")])
def test_speed_outside_its_range_is_refused(armed, value):
    armed.command(SET_SPEED, value)
    armed.step()
    assert [e["cause"] for e in armed.events(REJECTED)] == [Refusal.MALFORMED]
    assert armed.state.speed_scale == 1.0


def test_random_pauses_resumes_and_speeds_reach_the_planned_end(armed, plan_from, use_of_limits):
    rng = np.random.default_rng(20)
    plan = plan_from(armed.state.q_ref)
    armed.run_plan(plan)
    for _ in range(12):
        armed.step(int(rng.integers(20, 400)))
        kind = int(rng.choice([PAUSE, RESUME, SET_SPEED]))
        armed.command(kind, float(rng.uniform(0.2, 1.0)))
    armed.step(700)
    armed.command(SET_SPEED, 1.0)
    armed.command(RESUME)
    armed.until(lambda s: s.plan_done, 4000)
    assert np.abs(armed.state.q_ref - plan.q[-1]).max() < 1e-12
    assert use_of_limits(armed.emitted()) <= 1.0
    assert on_path(armed, plan) < 1e-12


@pytest.mark.parametrize("name", ["t", "q", "dq", "ddq", "stop_duration"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), float("-inf")])
def test_number_that_is_none_is_refused_and_the_arm_stays(armed, plan_from, name, bad):
    plan = plan_from(armed.state.q_ref)
    values = getattr(plan, name).copy()
    values.flat[values.size // 2] = bad
    armed.submit(dataclasses.replace(plan, **{name: values}))
    armed.step(5)
    expected = {"t": Refusal.TIME, "stop_duration": Refusal.NO_STOP_PATH}.get(name, Refusal.NONFINITE)
    assert [(e["cause"], e["plan_id"]) for e in armed.events(REJECTED)] == [(expected, 1)]
    assert armed.state.state == ExecutorState.HOLD


def shifted(plan, **changes):
    """The plan with some array changed: name -> (index, value)."""
    arrays = {}
    for name, (index, value) in changes.items():
        arrays[name] = getattr(plan, name).copy()
        arrays[name][index] = value
    return dataclasses.replace(plan, **arrays)


@pytest.mark.parametrize(
    ("changes", "refusal", "joint"),
    [
        ({"t": (0, 0.01)}, Refusal.TIME, -1),
        ({"t": (3, 0.0)}, Refusal.TIME, -1),
        ({"q": ((4, 2), 2.91)}, Refusal.POSITION, 2),
        ({"q": ((4, 5), -2.91)}, Refusal.POSITION, 5),
        ({"dq": ((4, 1), 3.1)}, Refusal.VELOCITY, 1),
        ({"ddq": ((4, 6), -6.2)}, Refusal.ACCELERATION, 6),
        ({"dq": ((7, 0), 0.01)}, Refusal.NOT_AT_REST, 0),
        ({"ddq": ((7, 3), 0.01)}, Refusal.NOT_AT_REST, 3),
        ({"dq": ((0, 4), 0.01)}, Refusal.NOT_AT_REST, 4),
        ({"stop_duration": (2, 0.0)}, Refusal.NO_STOP_PATH, -1),
        ({"stop_duration": (2, 11.0)}, Refusal.NO_STOP_PATH, -1),
    ],
)
def test_plan_with_one_wrong_number_is_refused_by_name(armed, plan_from, changes, refusal, joint):
    armed.submit(shifted(plan_from(armed.state.q_ref), **changes))
    armed.step(3)
    assert [(e["cause"], e["joint"]) for e in armed.events(REJECTED)] == [(refusal, joint)]
    assert armed.state.state == ExecutorState.HOLD


@pytest.mark.parametrize(
    ("offset", "accepted"), [(0.9e-4, True), (-0.9e-4, True), (1.1e-4, False), (-1.1e-4, False)]
)
def test_start_must_lie_at_the_reference(armed, plan_from, use_of_limits, offset, accepted):
    plan = plan_from(armed.state.q_ref + offset * np.eye(7)[3])
    armed.submit(plan)
    armed.step(3)
    if accepted:
        armed.until(lambda s: s.plan_done, 1500)
        assert np.abs(armed.state.q_ref - plan.q[-1]).max() < 1e-12
        assert use_of_limits(armed.emitted()) <= 1.0
    else:
        event = armed.events(REJECTED)[0]
        assert (event["cause"], event["joint"]) == (Refusal.START, 3)
        assert event["value"] == pytest.approx(offset)
        assert event["limit"] == pytest.approx(1e-4)
        assert armed.state.state == ExecutorState.HOLD


def test_plan_of_an_old_epoch_is_refused(armed, plan_from):
    plan = plan_from(armed.state.q_ref)
    armed.submit(plan, epoch=armed.state.epoch - 1)
    armed.step(3)
    event = armed.events(REJECTED)[0]
    assert (event["cause"], event["limit"]) == (Refusal.STALE, armed.state.epoch)


def test_plan_that_was_queued_before_a_stop_never_runs(armed, plan_from):
    plan = plan_from(armed.state.q_ref)
    armed.submit(plan)
    armed.command(STOP)
    armed.step(5)
    assert armed.state.state == ExecutorState.HOLD
    assert [e["cause"] for e in armed.events(REJECTED)] == [Refusal.STALE]


def test_second_plan_while_one_runs_is_refused_and_the_first_goes_on(armed, plan_from):
    plan = plan_from(armed.state.q_ref)
    armed.run_plan(plan)
    armed.step(100)
    armed.submit(plan_from(armed.state.q_ref), plan_id=2)
    armed.until(lambda s: s.plan_done, 1500)
    assert [(e["plan_id"], e["cause"]) for e in armed.events(REJECTED)] == [(2, Refusal.STATE)]
    assert armed.state.plan_id == 1
    assert np.abs(armed.state.q_ref - plan.q[-1]).max() < 1e-12


def test_many_plans_in_a_row_reuse_the_slots(armed, plan_from):
    for plan_id in range(1, 20):
        plan = plan_from(armed.state.q_ref, distance=0.01 * (-1) ** plan_id, duration_s=0.3)
        armed.run_plan(plan, plan_id)
        armed.until(lambda s: s.plan_done, 400)
    assert [e["plan_id"] for e in armed.events(PLAN_DONE)] == list(range(1, 20))


def test_full_plan_ring_says_so(cell, plan_from):
    from s2r_executor import _native

    plan = plan_from(np.zeros(7))
    arrays = (plan.t, plan.q, plan.dq, plan.ddq, plan.stop_duration)
    taken = [cell.shared.submit_plan(i, 1, *arrays, 0.0, 0.0) for i in range(_native.PLAN_SLOTS + 1)]
    assert taken == [True] * _native.PLAN_SLOTS + [False]


def branch_of(plan, splice_t, distance):
    """A plan that leaves `plan` at splice_t with the same position, velocity and acceleration."""
    from s2r_executor import _native

    q, dq, ddq, _ = _native.evaluate_spline(plan.t, plan.q, plan.dq, plan.ddq, np.array([splice_t]))
    end = plan.q[-1] + distance * np.linspace(1.0, -1.0, 7)
    zeros = np.zeros((1, 7))
    return type(plan)(
        np.array([0.0, 1.5]),
        np.vstack([q, end]),
        np.vstack([dq, zeros]),
        np.vstack([ddq, zeros]),
        np.array([0.6]),
    )


def test_spliced_plan_takes_over_without_a_step(armed, plan_from, use_of_limits):
    plan = plan_from(armed.state.q_ref)
    child = branch_of(plan, 0.6005, 0.1)
    armed.run_plan(plan)
    armed.step(300)
    armed.submit(child, plan_id=2, parent_id=1, splice_t=0.6005)
    snapshot = armed.until(lambda s: s.plan_done, 2500)
    assert snapshot.plan_id == 2
    assert np.abs(snapshot.q_ref - child.q[-1]).max() < 1e-12
    assert use_of_limits(armed.emitted()) <= 1.0
    assert [e["plan_id"] for e in armed.events(PLAN_STARTED)] == [1, 2]
    assert armed.events(REJECTED) == []


def test_a_plan_spliced_at_the_end_of_another_is_played(armed, plan_from, use_of_limits):
    """A sum of ticks may stand a rounding before the end."""
    for plan_id, duration_s in zip(range(1, 9, 2), (0.3, 0.7, 1.0, 1.4), strict=True):
        plan = plan_from(armed.state.q_ref, distance=0.03, duration_s=duration_s)
        back = plan_from(plan.q[-1], distance=-0.03, duration_s=0.5)
        armed.run_plan(plan, plan_id)
        armed.submit(back, plan_id + 1, parent_id=plan_id, splice_t=duration_s)
        armed.until(lambda s: s.plan_done, 2500)
        assert armed.state.plan_id == plan_id + 1
        assert np.abs(armed.state.q_ref - back.q[-1]).max() < 1e-12
    assert armed.events(REJECTED) == []
    assert use_of_limits(armed.emitted()) <= 1.0


def test_splice_within_tolerance_fades_instead_of_stepping(armed, plan_from, use_of_limits):
    plan = plan_from(armed.state.q_ref)
    child = shifted(branch_of(plan, 0.6, 0.1))
    child = dataclasses.replace(child, q=child.q + 0.9e-6)
    armed.run_plan(plan)
    armed.submit(child, plan_id=2, parent_id=1, splice_t=0.6)
    armed.until(lambda s: s.plan_done and s.plan_id == 2, 2500)
    assert use_of_limits(armed.emitted()) <= 1.0
    assert np.abs(armed.state.q_ref - child.q[-1]).max() < 1e-12


def test_splice_while_the_start_still_fades_keeps_what_is_left(armed, plan_from, use_of_limits):
    plan = plan_from(armed.state.q_ref + 0.9e-4)
    child = branch_of(plan, 0.08, 0.1)
    armed.run_plan(plan)
    armed.submit(child, plan_id=2, parent_id=1, splice_t=0.08)
    armed.until(lambda s: s.plan_done and s.plan_id == 2, 2500)
    assert use_of_limits(armed.emitted()) <= 1.0


@pytest.mark.parametrize(
    ("changes", "fields", "refusal"),
    [
        ({"q": ((0, 2), 1e-5)}, {}, Refusal.SPLICE),
        ({"dq": ((0, 2), 1e-4)}, {}, Refusal.SPLICE),
        ({"ddq": ((0, 2), 1e-3)}, {}, Refusal.SPLICE),
        ({}, {"splice_t": 0.2}, Refusal.LATE),
        ({}, {"splice_t": 1.5}, Refusal.SPLICE),
        ({}, {"parent_id": 9}, Refusal.SPLICE),
        ({}, {"splice_t": float("nan")}, Refusal.LATE),
    ],
)
def test_splice_that_does_not_fit_is_refused_and_the_parent_goes_on(
    armed, plan_from, changes, fields, refusal
):
    plan = plan_from(armed.state.q_ref)
    child = branch_of(plan, 0.6, 0.1)
    for name, (index, offset) in changes.items():
        child = shifted(child, **{name: (index, getattr(child, name)[index] + offset)})
    armed.run_plan(plan)
    armed.step(300)
    armed.submit(child, plan_id=2, **{"parent_id": 1, "splice_t": 0.6, **fields})
    snapshot = armed.until(lambda s: s.plan_done, 1500)
    assert [(e["plan_id"], e["cause"]) for e in armed.events(REJECTED)] == [(2, refusal)]
    assert snapshot.plan_id == 1
    assert np.abs(snapshot.q_ref - plan.q[-1]).max() < 1e-12


def test_stop_before_the_splice_stays_on_the_parent(armed, plan_from, use_of_limits):
    plan = plan_from(armed.state.q_ref)
    armed.run_plan(plan)
    armed.step(300)
    armed.submit(branch_of(plan, 0.6, 0.1), plan_id=2, parent_id=1, splice_t=0.6)
    armed.step(10)
    armed.command(STOP)
    armed.until(lambda s: s.state == ExecutorState.HOLD, 700)
    assert armed.state.plan_id == 1
    assert use_of_limits(armed.emitted()) <= 1.0
    assert on_path(armed, plan) < 1e-12


def run_before_waiting_plan(armed, plan_from, plan_t):
    """Play a plan whose stops take 0.2 s up to a time of it; a branch with longer ones takes over at 0.6 s."""
    plan = dataclasses.replace(plan_from(armed.state.q_ref, distance=0.3), stop_duration=np.full(7, 0.2))
    armed.run_plan(plan)
    armed.submit(branch_of(plan, 0.6, 0.1), plan_id=2, parent_id=1, splice_t=0.6)
    armed.until(lambda s: s.plan_t >= plan_t)


@pytest.mark.parametrize("before_s", [0.01, 0.05])
def test_a_pause_that_reaches_into_a_waiting_plan_takes_that_plans_ramp(
    armed, plan_from, use_of_limits, before_s
):
    run_before_waiting_plan(armed, plan_from, 0.6 - before_s)
    armed.command(PAUSE)
    armed.step()
    first = armed.state.tick
    paused = armed.until(lambda s: s.state == ExecutorState.PAUSED, 700)
    assert paused.tick - first + 1 == 600
    assert paused.plan_id == 2
    armed.command(RESUME)
    armed.until(lambda s: s.plan_done, 2500)
    assert use_of_limits(armed.emitted()) <= 1.0


def test_a_resume_that_reaches_into_a_waiting_plan_takes_that_plans_ramp(armed, plan_from):
    run_before_waiting_plan(armed, plan_from, 0.42)
    armed.command(PAUSE)
    paused = armed.until(lambda s: s.state == ExecutorState.PAUSED, 700)
    assert paused.next_plan_id == 2
    assert 0.5 < paused.plan_t < 0.53
    armed.command(RESUME)
    armed.step()
    first = armed.state.tick
    assert armed.until(lambda s: s.speed_scale == 1.0).tick - first + 1 == 600


def test_a_pause_that_ends_before_a_waiting_plan_keeps_its_own_ramp(armed, plan_from):
    run_before_waiting_plan(armed, plan_from, 0.35)
    armed.command(PAUSE)
    armed.step()
    first = armed.state.tick
    paused = armed.until(lambda s: s.state == ExecutorState.PAUSED, 700)
    assert paused.tick - first + 1 == 200
    assert paused.next_plan_id == 2


def ramp(cell, joint, counts, ticks=20):
    """Move a joint away from its setpoint no faster than a joint can move."""
    begin = cell.drives.offset[joint]
    for i in range(1, ticks + 1):
        cell.drives.offset[joint] = begin + round((counts - begin) * i / ticks)
        cell.step()


def test_goal_outside_its_tolerance_ends_in_a_stop_with_the_joint_named(make_cell, plan_from):
    cell = make_cell(goal_timeout_s=0.05)
    cell.arm()
    cell.run_plan(plan_from(cell.state.q_ref))
    ramp(cell, 4, 5_500_000)  # 0.022 rad
    snapshot = cell.until(lambda s: s.state == ExecutorState.HOLD, 1600)
    assert snapshot.cause == Cause.GOAL_TOLERANCE
    assert snapshot.cause_joint == 4
    assert snapshot.cause_value == pytest.approx(0.022, abs=1e-6)
    assert snapshot.cause_limit == 0.02
    assert not snapshot.plan_done
    assert cell.events(PLAN_DONE) == []


def test_goal_counts_only_with_a_fresh_answer_of_every_joint(armed, plan_from):
    armed.run_plan(plan_from(armed.state.q_ref))
    armed.step(1397)
    armed.drives.silent.add(6)
    armed.step(2)
    assert armed.state.state == ExecutorState.RUN
    armed.drives.silent.clear()
    armed.step(2)
    assert armed.state.plan_done


def test_goal_that_is_reached_late_but_in_time_is_done(make_cell, plan_from):
    cell = make_cell(goal_timeout_s=0.5)
    cell.arm()
    cell.run_plan(plan_from(cell.state.q_ref))
    ramp(cell, 4, 5_500_000)
    cell.step(1500)
    assert cell.state.state == ExecutorState.RUN
    ramp(cell, 4, 0)
    cell.step(3)
    assert cell.state.plan_done
    assert cell.state.state == ExecutorState.HOLD


def test_disarm_while_running_stops_on_the_path_first(armed, plan_from, use_of_limits):
    plan = plan_from(armed.state.q_ref)
    armed.run_plan(plan)
    armed.step(400)
    armed.command(DISARM)
    armed.step()
    assert armed.state.state == ExecutorState.STOPPING
    armed.until(lambda s: s.state == ExecutorState.DISARMED, 700)
    armed.step(3)
    assert use_of_limits(armed.emitted()) <= 1.0
    assert on_path(armed, plan) < 1e-12
    assert list(armed.state.drive_state) == [1] * 7


@pytest.mark.parametrize("kind", [PAUSE, RESUME, RESET, ARM])
def test_command_that_makes_no_sense_while_holding_is_refused(armed, kind):
    armed.command(kind)
    armed.step()
    assert [e["cause"] for e in armed.events(REJECTED)] == [Refusal.STATE]
    assert armed.state.state == ExecutorState.HOLD


@pytest.mark.parametrize("kind", [ARM, PAUSE, RESUME, SET_SPEED, RESET])
def test_command_of_an_old_epoch_is_refused(cell, kind):
    cell.step(3)
    cell.command(kind, 0.5, epoch=77)
    cell.step()
    assert [e["cause"] for e in cell.events(REJECTED)] == [Refusal.STALE]
    assert cell.state.state == ExecutorState.DISARMED


def test_records_hold_every_tick_once(armed, plan_from):
    armed.run_plan(plan_from(armed.state.q_ref))
    armed.step(200)
    records = armed.shared.records(65536)
    assert (np.diff(records["tick"]) == 1).all()
    assert records["tick"][-1] == armed.state.tick
    assert records["q_ref"].shape == (len(records), 7)
    assert (records["q_ref"][-1] == armed.state.q_ref).all()


def test_records_that_nobody_takes_are_counted_not_waited_for(make_cell):
    cell = make_cell(record_capacity=16)
    cell.step(50)
    assert len(cell.shared.records()) == 16
    assert cell.shared.records_dropped == 34
