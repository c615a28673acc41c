"""Picking a recorded plan and comparing two executions of it."""

import json

import numpy as np
import pytest

from s2r_host.cli_replay import _unused
from s2r_host.errors import RecordingError, TargetError
from s2r_host.recording import JOINT_STATE, STATE, JointTrack, RunRecorder, plan_track, stamp
from s2r_host.replay.overlay import write_overlay
from s2r_host.replay.pace import from_time, path_time, slowed, until_time
from s2r_host.replay.replay import (
    Replayed,
    ReplaySettings,
    _against_first,
    as_sent,
    compare,
    repeatability,
)
from s2r_host.replay.sources import Replayable, pick, read_source, trajectory_of_message
from s2r_host.trajectory import Trajectory
from s2r_host.trajectory.plan_files import write_knots_csv, write_plan_csv, write_plan_mcap
from s2r_protocol.arms import load_arm
from s2r_protocol.cli.root import main
from s2r_protocol.exits import UsageError
from s2r_protocol.faults import ExecutorState

ARM = load_arm("xmate3pro")
NAMES = tuple(f"joint{i}" for i in range(1, 8))


@pytest.fixture
def trajectory():
    t = np.linspace(0.0, 1.0, 11)
    shape = (10 * t**3 - 15 * t**4 + 6 * t**5)[:, None]
    speed = (30 * t**2 - 60 * t**3 + 30 * t**4)[:, None]
    bend = (60 * t - 180 * t**2 + 120 * t**3)[:, None]
    reach = np.linspace(0.1, 0.7, 7)
    return Trajectory(t, shape * reach, speed * reach, bend * reach)


def track(trajectory, delay_s=0.0, offset=0.0, count=1000):
    t = np.arange(1, count + 1) * 1e-3
    q, dq, _ = trajectory.sample(t - delay_s)
    return JointTrack((5e9 + t * 1e9).astype(np.int64), q + offset, dq, t)


@pytest.fixture
def run(tmp_path, trajectory):
    """A run folder with three plans and the executor's records of two of them, one after the other."""
    with RunRecorder(tmp_path / "run.mcap", "/lab/xmate3pro", NAMES) as recorder:
        for seq, label in ((7, "push 1"), (8, "manipulation 1"), (9, "manipulation 1: home")):
            recorder.add_plan(trajectory, label, seq)
        for seq, begin_ns, offset in ((7, 10_000_000_000, 0.5), (8, 20_000_000_000, 0.0)):
            for k in range(1, 101):
                t_ns = begin_ns + k * 10_000_000
                q, dq, _ = trajectory.sample(k * 0.01)
                header = {"stamp": stamp(t_ns)}
                body = {"header": header, "name": NAMES, "position": q + offset, "velocity": dq}
                recorder._put("joint_states", JOINT_STATE, body, t_ns)
                recorder._put(
                    "executor_state", STATE, {"header": header, "plan_seq": seq, "plan_t": k * 0.01}, t_ns
                )
    return tmp_path


def test_default_is_the_first_planned_manipulation(run):
    assert pick(read_source(run, ARM), None, run).label == "manipulation 1"


def test_unknown_number_lists_the_known_ones(run):
    with pytest.raises(
        UsageError, match=r"--plan 9: .* has no such plan; it has 1 \(push 1\), 2 \(manipulation 1\), 3"
    ):
        pick(read_source(run, ARM), 9, run)


def test_the_list_of_plans_can_be_read_by_a_machine(run, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["replay", str(run), "--list", "--json"])
    assert ended.value.code == 0
    listed = json.loads(capsys.readouterr().out)
    assert [set(plan) for plan in listed] == [{"plan", "label", "duration_s", "broken_off_s"}] * len(listed)
    assert listed


def test_track_of_a_plan_leaves_out_the_others(run, trajectory):
    found = plan_track(run / "run.mcap", 8)
    assert len(found.t) == 100
    assert found.t[0] == pytest.approx(0.01)
    assert np.allclose(found.q, trajectory.sample(found.t)[0])


def test_plan_that_never_ran_is_refused(run):
    with pytest.raises(RecordingError, match="no state of the executor during plan 9"):
        plan_track(run / "run.mcap", 9)


def test_equal_executions_differ_by_nothing(trajectory):
    found = compare(trajectory, track(trajectory), track(trajectory))
    assert found.rms_rad.max() < 1e-12
    assert np.allclose(found.q_planned, found.q_first)


def test_constant_offset_is_the_rms(trajectory):
    found = compare(trajectory, track(trajectory), track(trajectory, offset=0.002))
    assert np.allclose(found.rms_rad, 0.002)
    assert np.allclose(found.largest_rad, 0.002)


def test_recordings_of_different_length_are_compared_where_both_exist(trajectory):
    found = compare(trajectory, track(trajectory, count=1000), track(trajectory, count=400))
    assert found.t[-1] == pytest.approx(0.4)


def test_overlay_is_written_as_picture_and_offline_page(run, trajectory):
    found = compare(trajectory, track(trajectory), track(trajectory, delay_s=0.01))
    path = write_overlay(
        Replayed(pick(read_source(run, ARM), None, run), 12, b"", found), NAMES, run, run / "replay"
    )
    text = path.read_text()
    assert (run / "replay" / "overlay.png").stat().st_size > 10_000
    assert "RMS" in text
    assert "http" not in text.replace("http://www.w3.org", "")
    assert "<script" not in text


def test_the_page_of_a_slowed_replay_says_so(run, trajectory):
    found = compare(trajectory, track(trajectory), track(trajectory))
    replayed = Replayed(pick(read_source(run, ARM), None, run), 12, b"", found)
    full, slow = (
        write_overlay(replayed, NAMES, run, run / "replay", speed=speed).read_text() for speed in (1.0, 0.5)
    )
    assert "of its speed" not in full
    assert "sent again through the same admission as the executor's plan 12, at 0.5 of its speed" in slow


def test_a_slowed_plan_takes_longer_on_the_same_path(trajectory):
    slow = slowed(trajectory, 0.25)
    assert slow.duration_s == pytest.approx(4.0)
    np.testing.assert_allclose(slow.sample(2.0)[0], trajectory.sample(0.5)[0], atol=1e-12)
    with pytest.raises(TargetError, match=r"1\.5 is outside \(0, 1\]"):
        slowed(trajectory, 1.5)


@pytest.mark.parametrize("t_start", [0.2, 0.5, 0.9])
def test_a_plan_begun_in_the_middle_starts_at_rest_and_stays_on_the_path(trajectory, t_start):
    rest = from_time(trajectory, t_start)
    np.testing.assert_allclose(rest.q[0], trajectory.sample(t_start)[0], atol=1e-12)
    assert np.abs(rest.dq[0]).max() == 0.0
    assert np.abs(rest.ddq[0]).max() < 1e-12
    t = np.linspace(0.0, rest.duration_s, 300)
    on_path = trajectory.sample(path_time(t, t_start, 1.0, trajectory.duration_s))[0]
    np.testing.assert_allclose(rest.sample(t)[0], on_path, atol=1e-6)
    np.testing.assert_allclose(rest.q[-1], trajectory.q[-1], atol=1e-12)
    with pytest.raises(TargetError, match="outside the plan"):
        from_time(trajectory, 1.0)


@pytest.mark.parametrize("t_end", [0.1, 0.5, 1.0])
def test_a_plan_up_to_a_time_ends_there_at_rest_and_stays_on_the_path(trajectory, t_end):
    first = until_time(trajectory, t_end)
    np.testing.assert_allclose(first.q[0], trajectory.q[0], atol=1e-12)
    np.testing.assert_allclose(first.q[-1], trajectory.sample(t_end)[0], atol=1e-12)
    assert np.abs([first.dq[[0, -1]], first.ddq[[0, -1]]]).max() < 1e-12
    played = first.sample(np.linspace(0.0, first.duration_s, 50))[0]
    # All joints of this plan are proportional to each other.
    assert np.ptp(played / np.linspace(0.1, 0.7, 7), axis=1).max() < 1e-6
    assert (np.diff(played, axis=0) > -1e-9).all()


def paused(k):
    """Half a second of pause in the middle of a motion of one second."""
    return 0.01 * min(k, max(50, k - 50))


def slower(k):
    """The executor was told another speed meanwhile; then it holds."""
    return min(0.0075 * k, 1.0)


def executed(path, trajectory, plan_t):
    """A recording of 1.5 s of a plan of 1 s, which the arm follows; ``plan_t`` is its time [s] after k cycles."""
    with RunRecorder(path, "/lab/xmate3pro", NAMES) as recorder:
        recorder.add_plan(trajectory, "manipulation 1", 12)
        for k in range(1, 151):
            t, t_ns = plan_t(k), 30_000_000_000 + k * 10_000_000
            header, (q, dq, _) = {"stamp": stamp(t_ns)}, trajectory.sample(t)
            body = {"header": header, "name": NAMES, "position": q, "velocity": dq}
            recorder._put("joint_states", JOINT_STATE, body, t_ns)
            recorder._put("executor_state", STATE, {"header": header, "plan_seq": 12, "plan_t": t}, t_ns)
    return path


@pytest.mark.parametrize("plan_t", [paused, slower])
@pytest.mark.parametrize("known", [True, False])
def test_a_replay_is_compared_without_its_pauses_and_in_the_plans_own_time(run, trajectory, known, plan_t):
    path = executed(run / "again.mcap", trajectory, plan_t)
    plan = Replayable(1, "manipulation 1", trajectory, track(trajectory) if known else None)
    found = _against_first(plan, ReplaySettings(), trajectory, path.read_bytes(), 12)
    assert found.largest_rad.max() < 1e-3
    assert found.t[-1] >= 1.0 - 1e-9


@pytest.mark.parametrize("plan_t", [paused, slower])
def test_so_is_a_first_execution_during_which_somebody_paused_the_arm(tmp_path, trajectory, plan_t):
    (plan,) = read_source(executed(tmp_path / "run.mcap", trajectory, plan_t), ARM)
    found = compare(trajectory, plan.first, track(trajectory))
    assert found.largest_rad.max() < 1e-3
    assert found.t[-1] >= 1.0 - 1e-9


def test_repeatability_is_the_spread_about_the_mean(run, trajectory):
    plan = pick(read_source(run, ARM), None, run)
    shifts = (-1e-3, 0.0, 1e-3)
    done = [
        Replayed(plan, 1, b"", compare(trajectory, track(trajectory), track(trajectory, offset=s)))
        for s in shifts
    ]
    found = repeatability(done, NAMES)
    np.testing.assert_allclose(found.sigma_rad, 1e-3)
    np.testing.assert_allclose(found.range_rad, 2e-3)
    with pytest.raises(RecordingError, match="--loop 2"):
        repeatability(done[:1], NAMES)


def message(trajectory, names=NAMES, velocities=True):
    points = [
        {
            "positions": trajectory.q[i],
            "velocities": trajectory.dq[i] if velocities else [],
            "accelerations": [],
            "time_from_start": stamp(round(trajectory.t[i] * 1e9)),
        }
        for i in range(len(trajectory.t))
    ]
    return {"header": {"frame_id": ""}, "joint_names": list(names), "points": points}


def test_a_foreign_trajectory_is_read_by_joint_name(trajectory):
    shuffled = (*NAMES[3:], *NAMES[:3])
    found = trajectory_of_message(message(trajectory, shuffled), ARM)
    np.testing.assert_allclose(found.q[:, 0], trajectory.q[:, 4])
    assert np.abs(found.ddq[-1]).max() == 0.0


def test_way_points_without_velocities_get_a_time_law_within_limits(trajectory):
    found = trajectory_of_message(message(trajectory, velocities=False), ARM)
    speed = np.abs(found.sample(np.linspace(0, found.duration_s, 400))[1]).max(axis=0)
    assert (speed <= ARM.limits.dq_max).all()
    np.testing.assert_allclose(found.q[-1], trajectory.q[-1], atol=1e-6)


def test_a_foreign_trajectory_that_cannot_be_meant_is_refused_by_name(trajectory):
    with pytest.raises(RecordingError, match="is of joints elbow"):
        trajectory_of_message(message(trajectory, ("elbow", *NAMES[1:])), ARM)
    backwards = message(trajectory)
    backwards["points"][3]["time_from_start"] = stamp(0)
    with pytest.raises(RecordingError, match="do not rise"):
        trajectory_of_message(backwards, ARM)
    short = message(trajectory)
    short["points"][2]["positions"] = [0.0]
    with pytest.raises(RecordingError, match="point 2 has 1 positions"):
        trajectory_of_message(short, ARM)
    nowhere = message(trajectory)
    for point in nowhere["points"]:
        point["positions"] = []
    with pytest.raises(RecordingError, match="no positions"):
        trajectory_of_message(nowhere, ARM)


@pytest.mark.parametrize("kind", ["positions", "velocities"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_foreign_trajectory_with_a_number_that_is_none_is_refused_by_point_and_joint(
    trajectory, kind, value
):
    spoilt = message(trajectory, (*NAMES[3:], *NAMES[:3]))
    spoilt["points"][3][kind] = np.where(np.arange(7) == 1, value, spoilt["points"][3][kind])
    with pytest.raises(RecordingError, match=rf"point 3, joint 'joint5': {kind} = {value} is no finite"):
        trajectory_of_message(spoilt, ARM)


@pytest.mark.parametrize("row", [0, 4])
def test_a_point_without_velocities_among_others_does_not_drop_all_times(trajectory, row):
    gap = message(trajectory)
    gap["points"][row]["velocities"] = []
    with pytest.raises(RecordingError, match=f"point {row} has 0 velocities, xmate3pro has 7 joints"):
        trajectory_of_message(gap, ARM)


def test_a_table_of_positions_is_a_source(tmp_path, trajectory):
    write_plan_csv(tmp_path / "plan.csv", trajectory, NAMES)
    (plan,) = read_source(tmp_path / "plan.csv", ARM)
    t = np.linspace(0, 1, 200)
    for have, want, atol in zip(
        plan.trajectory.sample(t), trajectory.sample(t), (1e-5, 1e-3, 0.1), strict=True
    ):
        np.testing.assert_allclose(have, want, atol=atol)
    assert np.diff(plan.trajectory.t).min() >= 0.019
    assert not plan.trajectory.dq[[0, -1]].any()


def test_a_table_with_velocities_and_accelerations_is_taken_as_it_is(tmp_path, trajectory):
    write_knots_csv(tmp_path / "knots.csv", trajectory, NAMES)
    (plan,) = read_source(tmp_path / "knots.csv", ARM)
    np.testing.assert_allclose(plan.trajectory.ddq, trajectory.ddq, atol=1e-7)
    np.testing.assert_allclose(plan.trajectory.t, trajectory.t)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (
            lambda text: text.replace("q.joint3", "q.elbow"),
            r"no column q\.joint3; a trajectory of xmate3pro has t",
        ),
        (lambda text: text.replace("t,", "time,", 1), "no column t"),
        (lambda text: text.replace("\n0.002,", "\n0.002,x", 1), "line 3: needs 8 finite numbers"),
        (lambda text: text.replace("\n0.002,", "\n0.002,1,", 1), "line 3: needs 8 finite numbers"),
        (lambda text: text.replace("\n0.002,", "\n0,", 1), "line 3: t does not rise"),
        (lambda text: text.splitlines()[0], "0 rows below its header"),
        (lambda text: "", "0 rows below its header"),
    ],
)
def test_a_table_that_is_no_trajectory_is_refused_by_column_or_line(tmp_path, trajectory, spoil, reason):
    file = write_plan_csv(tmp_path / "plan.csv", trajectory, NAMES)
    file.write_text(spoil(file.read_text()))
    with pytest.raises(RecordingError, match=reason):
        read_source(file, ARM)


@pytest.mark.parametrize("lost", ["q", "dq"])
def test_a_table_does_not_pass_off_velocities_or_accelerations_as_another_kind(tmp_path, trajectory, lost):
    file = write_knots_csv(tmp_path / "knots.csv", trajectory, NAMES)
    header, *rows = [line.split(",") for line in file.read_text().splitlines()]
    keep = [i for i, name in enumerate(header) if not name.startswith(f"{lost}.")]
    file.write_text("".join(",".join(line[i] for i in keep) + "\n" for line in (header, *rows)))
    with pytest.raises(RecordingError, match=rf"no column {lost}\.joint1"):
        read_source(file, ARM)


def test_an_executors_session_names_the_plans_beside_it(tmp_path):
    session = tmp_path / "session-20261128T010203Z.mcap"
    with RunRecorder(session, "/lab/xmate3pro", NAMES) as recorder:
        for t_ns in (1, 2):
            header = {"stamp": stamp(t_ns)}
            body = {"header": header, "name": NAMES, "position": [0.0] * 7, "velocity": [0.0] * 7}
            for topic in ("joint_states", "joint_commands"):
                recorder._put(topic, JOINT_STATE, body, t_ns)
            recorder._put("executor_state", STATE, {"header": header}, t_ns)
    with pytest.raises(RecordingError, match="beside it there is none"):
        read_source(session, ARM)
    for seq in range(7):
        (tmp_path / f"plan-3-{seq}.mcap").touch()
    with pytest.raises(RecordingError, match=r"plans are beside it: plan-3-0\.mcap, .* and 2 more; name one"):
        read_source(session, ARM)


def test_the_folder_of_a_plan_stands_for_its_recording(tmp_path, trajectory, capsys):
    write_plan_mcap(tmp_path / "plan.mcap", trajectory, ARM, "drawer to 0.1")
    (plan,) = read_source(tmp_path, ARM)
    np.testing.assert_allclose(plan.trajectory.q, trajectory.q, atol=1e-9)
    with pytest.raises(SystemExit):
        main(["replay", str(tmp_path), "--list"])
    assert "drawer to 0.1" in capsys.readouterr().out


def test_an_executors_own_recording_is_a_source_without_a_run_folder(tmp_path, trajectory):
    path = tmp_path / "plan.mcap"
    with RunRecorder(path, "/lab/xmate3pro", NAMES) as recorder:
        for k in range(0, 1001):
            t_ns = 10_000_000_000 + k * 1_000_000
            q, dq, _ = trajectory.sample(k * 1e-3)
            header = {"stamp": stamp(t_ns)}
            for topic in ("joint_states", "joint_commands"):
                body = {"header": header, "name": NAMES, "position": q, "velocity": dq}
                recorder._put(topic, JOINT_STATE, body, t_ns)
            recorder._put(
                "executor_state", STATE, {"header": header, "plan_seq": 4, "plan_t": k * 1e-3}, t_ns
            )
    (only,) = read_source(path, ARM)
    t = np.linspace(0, 1, 50)
    np.testing.assert_allclose(only.trajectory.sample(t)[0], trajectory.sample(t)[0], atol=2e-4)
    assert isinstance(only, Replayable)
    assert only.first is not None


def test_a_plan_whose_commands_were_lost_is_left_out(tmp_path, trajectory):
    """Of a file that was cut off the states may reach further than the commands."""
    path = tmp_path / "plan.mcap"
    with RunRecorder(path, "/lab/xmate3pro", NAMES) as recorder:
        for seq, commanded in ((4, True), (5, False)):
            for k in range(101):
                t_ns = 10_000_000_000 * seq + k * 10_000_000
                q, dq, _ = trajectory.sample(k * 1e-2)
                header = {"stamp": stamp(t_ns)}
                body = {"header": header, "name": NAMES, "position": q, "velocity": dq}
                for topic in ("joint_states", "joint_commands")[: 1 + commanded]:
                    recorder._put(topic, JOINT_STATE, body, t_ns)
                state = {"header": header, "plan_seq": seq, "plan_t": k * 1e-2}
                recorder._put("executor_state", STATE, state, t_ns)
    assert [plan.label for plan in read_source(path, ARM)] == ["plan 4"]


@pytest.mark.parametrize("stopped", [False, True])
def test_what_a_stop_left_of_a_plan_is_no_plan(tmp_path, trajectory, stopped, capsys):
    file = tmp_path / "motion.mcap"
    with RunRecorder(file, "/lab/xmate3pro", NAMES) as recorder:
        for k in range(1, 101):
            t_ns = 10_000_000_000 + k * 10_000_000
            q, dq, _ = trajectory.sample(k * 0.01)
            header = {"stamp": stamp(t_ns)}
            body = {"header": header, "name": NAMES, "position": q, "velocity": dq}
            for topic in ("joint_states", "joint_commands"):
                recorder._put(topic, JOINT_STATE, body, t_ns)
            state = ExecutorState.STOPPING if stopped and k > 60 else ExecutorState.RUN
            body = {"header": header, "state": int(state), "plan_seq": 4, "plan_t": k * 0.01}
            recorder._put("executor_state", STATE, body, t_ns)
    plan = pick(read_source(file, ARM), None, file)
    if not stopped:
        assert plan.cut_s is None
        assert as_sent(plan, ReplaySettings()).duration_s == pytest.approx(1.0, abs=0.05)
        return
    assert plan.cut_s == pytest.approx(0.6)
    with pytest.raises(RecordingError, match=r"broken off by a stop 0.60 s after its start"):
        as_sent(plan, ReplaySettings())
    with pytest.raises(SystemExit):
        main(["replay", str(file), "--list"])
    assert "(broken off by a stop at 0.60 s)" in capsys.readouterr().out


def test_an_earlier_replay_is_kept(tmp_path):
    assert _unused(tmp_path / "replay-1") == tmp_path / "replay-1"
    (tmp_path / "replay-1").mkdir()
    assert _unused(tmp_path / "replay-1") == tmp_path / "replay-1-2"
