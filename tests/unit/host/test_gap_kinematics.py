"""Position against speed: what two sensors of one joint say against each other."""

import numpy as np
import pytest

from s2r_host.gap.motion import kinematics
from s2r_host.gap.motion.kinematics import contradiction
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.frozen import late_rows
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.rig import write_model

DT, LSB = 0.004, 1e-4


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml"))


def motion(pace=1.0):
    t = np.arange(0, 16, DT)
    x = pace * t
    q = 0.6 * np.sin(2.1 * x) + 0.25 * np.sin(7.3 * x + 0.4) + 0.1 * np.sin(13.0 * x)
    return t, q, np.gradient(q, DT)


def recorded(model, seen=lambda t, q, u: q, speed=lambda dq: dq, frozen=(), still=12, pace=1.0):
    """A motion, its speed and the effort the model needs for it; ``seen`` bends the position that is recorded."""
    rng = np.random.default_rng(3)
    t, q, dq = motion(pace)
    u = model.inverse(q[:, None], dq[:, None], np.gradient(dq, DT)[:, None])[:, 0]
    bent = np.round((seen(t, q, u) + 0.3 * LSB * rng.normal(size=len(t))) / LSB) * LSB
    for start in frozen:
        i = round(start / DT)
        bent[i : i + still] = bent[i]
    noisy = speed(dq) + 1e-3 * rng.normal(size=len(t))
    channels = {"q": {"elbow": bent}, "dq": {"elbow": noisy}, "tau": {"elbow": u}}
    rec = Recording("r", t, channels, Controller("none"), "commanded", "effort", "a", "", ())
    return make_session(model, rec, 0)


def test_honest_sensors_do_not_contradict_each_other(model):
    assert contradiction(model, [recorded(model)], 0) is None


def test_a_filtered_or_badly_scaled_speed_is_no_contradiction(model):
    def lagging(dq):
        return 1.03 * np.interp(np.arange(len(dq)) * DT - 0.012, np.arange(len(dq)) * DT, dq)

    assert contradiction(model, [recorded(model, speed=lagging)], 0) is None


def test_a_position_that_freezes_has_no_name_but_a_time(model):
    t, _, dq = motion()
    fast = t[np.abs(dq) > 1.5]
    starts = [float(fast[np.searchsorted(fast, x)]) for x in (3.0, 7.5, 11.0)]

    said = contradiction(model, [recorded(model, frozen=starts)], 0)
    assert said is not None
    assert said.finding is None
    assert [a for a, _ in said.intervals] == pytest.approx(starts, abs=0.02)


def test_short_stops_that_vanish_in_the_mean_are_seen_by_their_peaks(model):
    t, _, dq = motion()
    slow = t[(np.abs(dq) > 0.5) & (np.abs(dq) < 1.0)]
    starts = [float(slow[np.searchsorted(slow, x)]) for x in (3.0, 11.0)]
    stopped = recorded(model, frozen=starts, still=3)
    track = kinematics._track(model, stopped, 0)
    assert track is not None
    assert np.std(kinematics._without_filter(track)) < track.noise

    said = contradiction(model, [stopped], 0)
    assert said is not None
    assert [a for a, _ in said.intervals] == pytest.approx(starts, abs=0.02)


def slow_log(frozen=(), hole=None):
    """Rows 50 ms apart of a motion; the sensor stops 40 ms before each row ``frozen``; ``hole`` is lost."""
    rng = np.random.default_rng(5)
    t, q, dq = motion()
    rows = np.arange(0, len(t), 12)
    seen = q[rows] + 0.3 * LSB * rng.normal(size=len(rows))
    for k in frozen:
        seen[k] = q[rows[k] - 10]
    kept = np.ones(len(rows), bool)
    if hole is not None:
        kept[hole] = False
    channels = {"q": {"elbow": np.round(seen / LSB)[kept] * LSB}, "dq": {"elbow": dq[rows][kept]}}
    return Recording("slow", t[rows][kept], channels, Controller("none"), "commanded", "effort", "a", "", ())


def test_rows_of_a_slow_log_at_which_the_sensor_had_stopped_are_late():
    moving = np.flatnonzero(np.abs(motion()[2][::12]) > 1.5)
    rows = [int(moving[np.searchsorted(moving, k)]) for k in (60, 150, 240)]
    said = late_rows(slow_log(rows), "elbow")
    assert said is not None
    assert [a for a, _ in said.intervals] == pytest.approx([0.048 * k for k in rows])


@pytest.mark.parametrize("hole", [None, slice(100, 112)])
def test_a_slow_log_of_honest_sensors_has_no_late_rows(hole):
    assert late_rows(slow_log(hole=hole), "elbow") is None


def test_an_effort_that_leaks_into_the_position_has_no_name(model):
    said = contradiction(model, [recorded(model, seen=lambda t, q, u: q + 2e-3 * (u / np.std(u)) ** 2)], 0)
    assert said is not None
    assert said.finding is None


def test_a_spring_before_the_encoder_is_joint_elasticity_with_its_stiffness(model):
    m = model.model
    k = 200.0

    def behind(t, q, u):
        v = np.gradient(q, DT)
        return q - (u - m.dof_armature[0] * np.gradient(v, DT) - m.dof_damping[0] * v) / k

    said = contradiction(model, [recorded(model, seen=behind)], 0)
    assert said is not None
    assert said.finding is not None
    assert said.finding.name == "joint_elasticity"
    assert said.finding.parameters["stiffness"]["value"] == pytest.approx(k, rel=0.1)


def test_a_gap_before_the_encoder_is_backlash_with_its_width(model):
    said = contradiction(
        model, [recorded(model, seen=lambda t, q, u: q - 4e-3 * np.tanh(u / (0.02 * np.std(u))))], 0
    )
    assert said is not None
    assert said.finding is not None
    assert said.finding.name == "backlash"
    assert said.finding.parameters["half_width"]["value"] == pytest.approx(4e-3, rel=0.15)


def crossing(t, q, u, half=4e-3, late_s=0.07):
    """A motor that needs ``late_s`` to get from one flank to the other, and swings about in between."""
    windup = half * np.tanh(u / (0.02 * np.std(u)))
    for i in np.flatnonzero(np.diff(np.sign(u)) != 0):
        n = min(round(late_s / DT), len(u) - i - 1)
        share = np.arange(n) / n
        after = windup[i + n]
        windup[i : i + n] = after * (2.0 * share - 1.0) + 2.5 * half * np.sin(2 * np.pi * share)
    return q - windup


def test_play_is_named_although_the_motor_takes_time_to_cross_it(model, monkeypatch):
    s = recorded(model, seen=crossing, pace=0.7)
    said = contradiction(model, [s], 0)
    assert said is not None
    assert said.finding is not None
    assert said.finding.name == "backlash"
    width = said.finding.parameters["half_width"]
    assert width["identifiable"]
    assert width["value"] == pytest.approx(4e-3, rel=0.15)
    monkeypatch.setattr(kinematics, "SETTLED_SHARE", 2.0)
    unsettled = contradiction(model, [s], 0)
    assert unsettled is not None
    assert unsettled.finding is None


def test_a_slow_log_is_not_asked(model):
    s = recorded(model, seen=lambda t, q, u: q + 5e-3 * (u / np.std(u)) ** 2)
    slow = {k: {j: x[::10] for j, x in table.items()} for k, table in s.rec.channels.items()}
    rec = Recording("r", s.rec.t[::10], slow, s.rec.controller, "commanded", "effort", "a", "", ())
    assert contradiction(model, [make_session(model, rec, 0)], 0) is None


def test_a_leak_below_the_noise_is_seen_by_its_pattern(model):
    faint = recorded(model, seen=lambda t, q, u: q + 1.2e-4 * (u / np.std(u)) ** 2)
    said = contradiction(model, [faint], 0)
    assert said is not None
    assert said.size < 2.0 * said.noise
    assert said.finding is None


def test_a_trace_far_below_what_sensors_leave_open_is_no_contradiction(model):
    t, q, dq = motion()
    u = model.inverse(q[:, None], dq[:, None], np.gradient(dq, DT)[:, None])[:, 0]

    def noiseless(leak):
        bent = q + leak * (u / np.std(u)) ** 2
        channels = {"q": {"elbow": bent}, "dq": {"elbow": dq}, "tau": {"elbow": u}}
        rec = Recording("r", t, channels, Controller("none"), "commanded", "effort", "a", "", ())
        return make_session(model, rec, 0)

    assert contradiction(model, [noiseless(1e-5)], 0) is None
    assert contradiction(model, [noiseless(2e-4)], 0) is not None
