"""Picking a recorded plan and comparing two executions of it."""

import numpy as np
import pytest

from s2r_host.errors import RecordingError
from s2r_host.recording import JOINT_STATE, STATE, JointTrack, RunRecorder, plan_track, stamp
from s2r_host.replay.overlay import write_overlay
from s2r_host.replay.replay import Replayed, compare, pick_plan
from s2r_host.trajectory import Trajectory

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
    return JointTrack((5e9 + t * 1e9).astype(np.int64), q + offset, dq, t_first_s=1e-3)


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
    assert pick_plan(run, None).label == "manipulation 1"


def test_unknown_number_lists_the_known_ones(run):
    with pytest.raises(RecordingError, match=r"no plan 9; it has 1 \(push 1\), 2 \(manipulation 1\), 3"):
        pick_plan(run, 9)


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
    path = write_overlay(Replayed(pick_plan(run, None), 12, b"", found), NAMES, run, run / "replay")
    text = path.read_text()
    assert (run / "replay" / "overlay.png").stat().st_size > 10_000
    assert "RMS" in text
    assert "http" not in text.replace("http://www.w3.org", "")
    assert "<script" not in text
