"""What comes back in the second run of a motion is no noise; what comes in another unit is refused."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.motion import checks
from s2r_host.gap.motion.checks import check_units
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.problem import Problem, build_problem
from s2r_host.gap.regression.second_run import find_partner, no_partner
from s2r_host.gap.rig import write_model
from s2r_host.gap.search.search import Search
from s2r_host.gap.verdict.decide import decide
from s2r_host.gap.verdict.parameters_off import parameters_only

DT, KP, KD = 0.004, 40.0, 2.0
TWO_JOINTS = """<mujoco><worldbody><body><joint name="j1" axis="0 1 0"/><geom size="0.1"/>
<body pos="0.3 0 0"><joint name="j2" axis="0 1 0"/><geom size="0.1"/></body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml"))


def recorded(model, index, phase, hidden=0.0, unit=1.0, ahead=0.0, dry=0.0, tilted=0.0, scale=1.0):
    """A motion and the effort the model needs, slow noise of 0.05 N·m and a hidden force tied to the clock.

    A share ``ahead`` of the effort is fed forward, the rest is what the controller asks for; ``dry`` is friction [N·m].
    The base stands ``tilted`` [rad], and of the effort that is reported a share ``scale`` arrives.
    """
    rng = np.random.default_rng(index)
    t = np.arange(0, 20, DT)
    q = 0.6 * np.sin(1.7 * t + phase) + 0.2 * np.sin(5.3 * t + 2.0 * phase)
    dq = np.gradient(q, DT)
    noise = np.asarray(lfilter([0.2], [1.0, -0.96], rng.normal(size=len(t))))
    u = model.inverse((q + tilted)[:, None], dq[:, None], np.gradient(dq, DT)[:, None])[:, 0] / scale
    u = u + 0.05 * noise / np.std(noise) + hidden * np.sin(2.0 * np.pi * 1.37 * t)
    u = u + dry * np.sign(dq)
    q_cmd, dq_cmd = q + (1.0 - ahead) * u / KP, dq
    channels = {
        "q": {"elbow": unit * q}, "dq": {"elbow": unit * dq}, "tau": {"elbow": u},
        "q_cmd": {"elbow": unit * q_cmd}, "dq_cmd": {"elbow": unit * dq_cmd},
        "tau_ff": {"elbow": ahead * u},
    }  # fmt: skip
    law = Controller("pd", {"elbow": KP}, {"elbow": KD}, {}, 250.0)
    return make_session(
        model, Recording(f"r{index}", t, channels, law, "commanded", "q_cmd", "a", "", ()), index
    )


def searched(model, hidden):
    fit, again, held = (recorded(model, k, phase, hidden) for k, phase in ((0, 0.0), (1, 0.0), (2, 1.0)))
    return Search(build_problem(model, [fit], [held], [again]))


def test_noise_does_not_come_back_in_the_second_run(model):
    assert not searched(model, 0.0).comes_back([])


def test_a_force_as_small_as_the_noise_comes_back_in_the_second_run(model):
    search = searched(model, 0.08)
    assert search.comes_back([])
    assert not search.at_floor([])


def test_two_runs_are_held_against_each_other_in_one_band(model):
    fit, again, held = (recorded(model, k, phase, 0.08) for k, phase in ((0, 0.0), (1, 0.0), (2, 1.0)))
    again.cut[:] = 2.1
    problem = build_problem(model, [fit], [held], [again])
    assert problem.twin is not None
    ((first, second),) = problem.twin.pairs
    assert np.array_equal(first.picks, second.picks)
    assert Search(problem).comes_back([])


def test_without_a_second_run_nothing_is_said_about_coming_back(model):
    fit, held = recorded(model, 0, 0.0, 0.08), recorded(model, 2, 1.0, 0.08)
    assert not Search(build_problem(model, [fit], [held], [])).comes_back([])


def test_positions_in_degrees_are_refused_by_what_the_controller_would_ask_for(model):
    with pytest.raises(GapRecordingError, match="degrees"):
        check_units(model, recorded(model, 0, 0.0, unit=180.0 / np.pi))


def test_degrees_are_seen_beside_an_effort_that_is_fed_forward(model):
    with pytest.raises(GapRecordingError, match="degrees"):
        check_units(model, recorded(model, 0, 0.0, unit=180.0 / np.pi, ahead=0.9))


def test_degrees_are_seen_by_the_load_where_friction_hides_half_of_it(model):
    turned = recorded(model, 0, 0.0, unit=180.0 / np.pi, dry=1.5)
    turned.rec.controller.kp.clear()  # no law to hold against
    assert 0.5 < checks._fit(turned, 0, 0) < 0.9
    with pytest.raises(GapRecordingError, match="read as degrees"):
        check_units(model, turned)


@pytest.mark.parametrize("ahead", [0.0, 0.9, 1.0])
def test_positions_in_radians_pass(model, ahead):
    check_units(model, recorded(model, 0, 0.0, ahead=ahead))


def test_one_scale_is_named_beside_a_tilt_instead_of_several_numbers(model):
    """A drive that gives 6 % less shifts weight, inertia and friction alike; mass and friction apart are two causes."""
    sessions = [
        recorded(model, k, phase, tilted=0.06, scale=0.94) for k, phase in ((0, 0.0), (1, 0.0), (2, 1.0))
    ]
    problem = build_problem(model, sessions[:1], sessions[2:], sessions[1:2])
    decision = parameters_only(problem, Search(problem))
    assert decision.verdict == "physics_missing"
    assert decision.effects[0].name in ("gravity_tilt", "encoder_offset")
    assert [p["name"] for p in decision.parameters_off] == ["effort_scale"]
    assert decision.parameters_off[0]["to"] == pytest.approx(0.94, abs=0.02)


def resting(model, index):
    """Half a minute of which a joint rests two thirds, stopped at one place in every run by its friction of 0.5 N·m."""
    rng, t = np.random.default_rng(index), np.arange(0, 30, DT)
    turning = np.minimum(t, 4.5 * np.pi / 1.7)
    q = 0.6 * np.sin(1.7 * turning)
    dq = np.where(t > turning, 0.0, 1.02 * np.cos(1.7 * turning))
    u = model.inverse(q[:, None], dq[:, None], np.gradient(dq, DT)[:, None])[:, 0]
    held = np.where(np.sin(0.7 * t) > 0.0, 0.4, -0.3)
    u += np.where(t > turning, held, 0.5 * np.sign(dq)) + 0.01 * rng.normal(size=len(t))
    channels = {"q": {"elbow": q}, "dq": {"elbow": dq}, "tau": {"elbow": u}}
    rec = Recording(f"r{index}", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    return make_session(model, rec, index)


def test_friction_of_a_new_session_is_told_once_however_many_recordings_it_has(tmp_path):
    rubbing = RigidModel(write_model(tmp_path / "model.xml", friction=0.5))
    fit, again = (recorded(rubbing, k, 0.0, dry=0.5) for k in range(2))
    held = []
    for index, phase in ((2, 1.0), (3, 2.0)):
        s = recorded(rubbing, index, phase, dry=0.8)
        held.append(make_session(rubbing, replace(s.rec, session="next day"), index))
    search = Search(build_problem(rubbing, [fit], held, [again]))
    effects = decide(search.problem, search).effects
    assert [(e.name, e.joint) for e in effects] == [("session_friction", "elbow")]
    assert effects[0].parameters["factor"]["value"] == pytest.approx(1.6, rel=0.1)


def test_what_friction_holds_at_rest_may_come_back(tmp_path):
    model = RigidModel(write_model(tmp_path / "model.xml", friction=0.5))
    problem = build_problem(model, [resting(model, 0)], [], [resting(model, 1)])
    assert not Search(problem).comes_back([])


def test_rows_that_friction_leaves_open_are_no_leftover():
    rng = np.random.default_rng(3)
    weight = np.repeat([1.0, 0.02], 200)
    rows = rng.normal(size=400) / weight
    stated: Any = SimpleNamespace(floor_source="repeat", trust=weight)
    block: Any = SimpleNamespace(rows=slice(0, 400))
    assert Problem.rms(stated, rows, block, np.ones(400, dtype=bool)) == pytest.approx(1.0, abs=0.1)


def test_a_second_run_of_another_motion_is_told(model):
    first, again, other = (recorded(model, k, phase) for k, phase in ((0, 0.0), (1, 0.0), (2, 1.0)))
    assert no_partner(again, [first]) is None
    assert find_partner(other, [first]) is None
    why = no_partner(other, [first])
    assert why is not None
    assert why.startswith("r2 is no second run of any --fit recording and is left out: its positions differ")
    assert "10% is allowed" in why


@pytest.mark.parametrize(
    ("step", "drift", "copied"), [(0.0, 0.0, False), (1e-4, 0.0, True), (1e-4, 3e-4, False)]
)
def test_a_second_run_that_repeats_every_step_of_the_encoder_is_none(model, step, drift, copied):
    first, again = recorded(model, 0, 0.0), recorded(model, 1, 0.0)
    for s, off in ((first, 0.0), (again, drift)):
        q = s.rec.channels["q"]["elbow"] + off * np.sin(0.3 * s.rec.t)
        s.rec.as_read.channels["q"]["elbow"] = np.round(q / step) * step if step else q
    assert (find_partner(again, [first]) is None) == copied
    assert ("repeat nearly every encoder step of r0" in (no_partner(again, [first]) or "")) == copied


def test_a_second_run_without_one_of_the_joints_is_none(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(TWO_JOINTS)
    arm, t, step = RigidModel(path), np.arange(0, 8, DT), 1e-3
    q = {"j1": step * np.round(np.sin(1.3 * t) / step), "j2": step * np.round(np.sin(2.1 * t) / step)}
    first, again = (
        make_session(
            arm, Recording(name, t, {"q": joints}, Controller(), "commanded", "effort", "a", "", ()), k
        )
        for k, (name, joints) in enumerate((("whole", q), ("half", {"j2": q["j2"]})))
    )
    assert find_partner(again, [first]) is None
    assert "half is no second run" in (no_partner(again, [first]) or "")
