"""The control law as second witness: what a measured effort hides, wrong gains, late stamps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import Context
from s2r_host.gap.motion.align import control_lag
from s2r_host.gap.motion.checks import check_units
from s2r_host.gap.motion.law import check_law, stamps_within
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.rig import write_model
from s2r_host.gap.simulation.replay import build_twin, run

KP, KD, DT = 40.0, 2.0, 0.004


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml"))


def recorded(model, index, effort="measured", drive=lambda u: u, kp=KP, kd=KD, late=0, late_s=0.0):
    """A loop whose plant does not matter: position lags the command, the drive bends what the law asks for."""
    rng = np.random.default_rng(index)
    t = np.arange(0, 12, DT)
    q_cmd = 0.6 * np.sin(1.3 * t + index) + 0.2 * np.sin(6.1 * t)
    q = 0.55 * np.sin(1.3 * t + index - 0.1) + 0.19 * np.sin(6.1 * t - 0.3)
    dq_cmd, dq = np.gradient(q_cmd, DT), np.gradient(q, DT)
    u = drive(kp * (q_cmd - q) + kd * (dq_cmd - dq)) + 0.01 * rng.normal(size=len(t))
    if late:
        q, dq = np.roll(q, late), np.roll(dq, late)
    q, dq = np.interp(t - late_s, t, q), np.interp(t - late_s, t, dq)
    channels = {
        "q": {"elbow": q}, "dq": {"elbow": dq}, "tau": {"elbow": u},
        "q_cmd": {"elbow": q_cmd}, "dq_cmd": {"elbow": dq_cmd},
    }  # fmt: skip
    law = Controller("pd", {"elbow": KP}, {"elbow": kd}, {}, 250.0)
    rec = Recording(f"r{index}", t, channels, law, effort, "q_cmd", "a", "", ())
    return make_session(model, rec, index)


def found(model, **how):
    return check_law(model, [recorded(model, 0, **how)], [recorded(model, 1, **how)], 0)


def test_a_law_that_holds_says_nothing(model):
    assert found(model) is None


def test_a_law_that_holds_for_a_reported_effort_excludes_late_stamps(model):
    shift = stamps_within(model, [recorded(model, 0)], 0)
    assert shift is not None
    assert shift <= 0.002
    late = recorded(model, 0, late_s=0.02)
    assert stamps_within(model, [late], 0) is None
    assert stamps_within(model, [recorded(model, 0, effort="commanded")], 0) is None


@pytest.mark.parametrize(("step", "lag_s", "name"), [(3e-3, 0.0, None), (1e-5, 0.02, "bandwidth")])
def test_steps_of_an_encoder_whose_speed_was_not_logged_are_no_lag(model, step, lag_s, name):
    def coarse(index):
        share = 1.0 - np.exp(-DT / lag_s) if lag_s else 1.0
        s = recorded(model, index, drive=lambda u: lfilter([share], [1.0, share - 1.0], u), kd=10.0)
        channels = {k: x for k, x in s.rec.channels.items() if k != "dq"}
        channels["q"] = {"elbow": np.round(channels["q"]["elbow"] / step) * step}
        return make_session(model, replace(s.rec, channels=channels), index)

    said = check_law(model, [coarse(0)], [coarse(1)], 0)
    assert (None if said is None else said.name) == name


def test_a_delay_behind_a_measured_effort_is_named_with_its_size(model):
    said = found(model, drive=lambda u: np.concatenate([u[:1].repeat(5), u[:-5]]))
    assert said is not None
    assert said.name == "actuator_delay"
    assert said.parameters["delay"]["value"] == pytest.approx(5 * DT, rel=0.05)


def test_a_lag_that_is_not_looked_for_is_told_as_the_next_best_and_never_as_a_law_that_holds(model):
    def lagging(u):
        return lfilter([0.2], [1.0, -0.8], u)

    runs = [[recorded(model, k, drive=lagging)] for k in (0, 1)]
    assert check_law(model, *runs, 0).name == "bandwidth"
    said = check_law(model, *runs, 0, skip=("bandwidth",))
    assert said is not None
    assert said.name == "actuator_delay"
    assert "bandwidth" not in said.rivals


@pytest.mark.parametrize("limit", [4.0, 0.8])  # now and then, and for most of the time
def test_a_clip_behind_a_measured_effort_is_named_with_its_limit(model, limit):
    said = found(model, drive=lambda u: np.clip(u, -limit, limit))
    assert said is not None
    assert said.name == "saturation"
    assert said.parameters["limit"]["value"] == pytest.approx(limit, rel=0.03)


def test_a_wrong_gain_is_a_parameter(model):
    said = found(model, effort="commanded", kp=1.1 * KP)
    assert said is not None
    assert said.name == "controller_gain"
    assert said.parameters["kp"]["value"] == pytest.approx(1.1 * KP, rel=0.01)


def test_late_stamps_are_told_from_a_late_drive(model):
    said = found(model, late=4)
    assert said is not None
    assert said.name == "clock_skew"
    assert said.parameters["lag"]["value"] == pytest.approx(4 * DT, rel=0.1)


def test_stamps_late_by_a_small_part_of_a_row_are_found(model):
    said = found(model, effort="commanded", late_s=2e-4)
    assert said is not None
    assert said.name == "clock_skew"
    assert said.parameters["lag"]["value"] == pytest.approx(2e-4, rel=0.25)


def test_a_commanded_effort_cannot_show_a_delay(model):
    said = found(model, effort="commanded", drive=lambda u: np.concatenate([u[:1].repeat(5), u[:-5]]))
    assert said is None or said.name not in ("actuator_delay", "bandwidth", "saturation")


@pytest.mark.parametrize(
    ("drive", "name"),
    [
        (lambda u: np.concatenate([u[:1].repeat(5), u[:-5]]), "actuator_delay"),
        (lambda u: lfilter([0.2], [1.0, -0.8], u), "bandwidth"),
        (lambda u: np.clip(u, -4.0, 4.0), "saturation"),
    ],
)
def test_what_the_law_finds_can_be_replayed_by_the_effect_of_that_name(model, drive, name):
    said = found(model, drive=drive)
    assert said is not None
    assert said.name == name
    effect, ctx = catalogue()[name], Context(model, [recorded(model, 0)])
    columns = effect.columns(ctx, ctx.sessions[0], 0, said.shape)
    step = effect.runtime(ctx, 0, said.shape, np.zeros(len(columns.linear)), DT)
    assert step is not None


def test_an_effort_that_is_one_period_old_is_no_clock(model):
    held = found(model, effort="commanded", late_s=-0.6 / 250.0)
    late = found(model, effort="commanded", late_s=0.6 / 250.0)
    assert held is None
    assert late is not None
    assert late.name == "clock_skew"


def test_a_drive_that_reports_the_effort_of_the_tick_before_is_no_late_drive(model):
    assert found(model, drive=lambda u: np.concatenate([u[:1], u[:-1]])) is None
    assert found(model, drive=lambda u: np.concatenate([u[:1].repeat(2), u[:-2]])) is not None


def test_a_recording_without_gains_beside_others_leaves_the_clocks_open(model):
    known = [recorded(model, k, effort="commanded") for k in range(2)]
    assert control_lag(model, known, 0) is not None
    bare = make_session(model, replace(known[1].rec, controller=Controller()), 1)
    assert control_lag(model, [known[0], bare], 0) is None


def handled(model, index=0):
    """What the drive gives is what the law asks for; most of it carries a recorded wrench, as of a tool."""
    s = recorded(model, index, effort="commanded")
    needed = s.load[:, 0] + 0.01 * np.random.default_rng(index).normal(size=len(s.t))
    push = -6.0 * s.load[:, 0]
    q, tau = s.rec.channels["q"], needed - push
    channels = s.rec.channels | {
        "tau": {"elbow": tau}, "wrench": {"arm.my": push},
        "q_cmd": {"elbow": q["elbow"] + tau / KP}, "dq_cmd": s.rec.channels["dq"],
    }  # fmt: skip
    return make_session(model, replace(s.rec, channels=channels), index)


def test_a_recorded_wrench_is_no_effort_that_a_controller_asks_for(model):
    s = handled(model)
    check_units(model, s)
    assert control_lag(model, [s], 0) == pytest.approx((0.0, 0.0005))
    assert check_law(model, [s], [handled(model, 1)], 0) is None


def test_a_recorded_wrench_acts_beside_a_simulated_controller(model):
    s, start = handled(model), 100
    motion = run(build_twin(model, Context(model, [s]), []), s, start, len(s.t) - start, closed=True)
    assert np.max(np.abs(motion.q[:, 0] - s.q[start : len(s.t) - start, 0])) < 0.01
    assert motion.u[:, 0] == pytest.approx(s.u[start : len(s.t) - start, 0], abs=0.5)


def test_a_drive_that_pulls_at_a_tendon_leaves_the_limits_of_a_joint_alone(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(
        """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size="0.1"/><body pos="0.3 0 0">
        <joint name="b" axis="0 1 0"/><geom size="0.1"/></body></body></worldbody>
        <tendon><fixed name="belt"><joint joint="b" coef="1"/></fixed></tendon>
        <actuator><motor joint="a" forcerange="-3 3" gear="2"/><motor tendon="belt" forcerange="-1 1"/></actuator>
        </mujoco>"""
    )
    low, high = RigidModel(path).effort_limits()
    assert low.tolist() == [-6.0, -np.inf]
    assert high.tolist() == [6.0, np.inf]
