"""Late stamps that the control law tells are set right before anything else is compared."""

import json

import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.motion.aligned import aligned
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.output.answer import make_answer
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.rig import write_model

DT, KP, KD = 0.004, 40.0, 3.0
QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)


def test_a_late_motion_is_read_where_it_belongs(tmp_path):
    model = RigidModel(write_model(tmp_path / "model.xml"))
    t = np.arange(0.0, 8.0, DT)
    lag = 0.013
    channels = {
        "q": {"elbow": np.sin(2.0 * (t - lag))},
        "dq": {"elbow": 2.0 * np.cos(2.0 * (t - lag))},
        "tau": {"elbow": np.cos(t)},
    }
    rec = Recording("r", t, channels, Controller(), "measured", "effort", "a", "", ())
    (s,) = aligned(model, [make_session(model, rec, 3)], {("q", 0): lag, ("dq", 0): lag})
    assert s.index == 3
    assert s.rec.t[-1] <= t[-1] - lag
    assert s.rec.channels["q"]["elbow"] == pytest.approx(np.sin(2.0 * s.rec.t), abs=1e-6)
    assert s.rec.channels["tau"]["elbow"] == pytest.approx(np.cos(s.rec.t))
    (early,) = aligned(model, [make_session(model, rec, 0)], {("q", 0): -lag})
    assert early.rec.t[0] == 0.0
    assert early.rec.start_s == pytest.approx(0.016)
    assert early.rec.channels["q"]["elbow"] == pytest.approx(
        np.sin(2.0 * (early.rec.t + 0.016 - 2.0 * lag)), abs=1e-6
    )


def late_run(folder, model, name, seed, phase, push=0.0, of="motion", effort="measured"):
    """A run of a loop with dry friction, position or effort stamped 12 ms late; law and both channels are declared.

    ``push``: amplitude of an effort that depends on the time alone [N·m].
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 10.0, DT)
    q = 0.8 * np.sin(1.7 * t + phase) + 0.3 * np.sin(5.3 * t) + 0.1 * np.sin(11.0 * t + phase)
    v = np.gradient(q, DT)
    a = np.gradient(v, DT)
    u = model.inverse(q[:, None], v[:, None], a[:, None])[:, 0] + 0.3 * np.tanh(v / 0.01)
    u += push * np.sin(4.0 * t + np.sin(0.9 * t))
    q_cmd = q + u / KP  # what the law was asked for, so that it gives u
    at = t - 0.012
    late_q, late_v, late_u = (
        np.interp(at if late else t, t, x) for x, late in zip((q, v, u), _late(of), strict=True)
    )
    noisy = [x + s * rng.normal(size=len(t)) for x, s in ((late_q, 2e-5), (late_v, 1e-3), (late_u, 0.01))]
    table = np.stack([t, *noisy, q_cmd, v], axis=1)
    file = folder / f"{name}.csv"
    names = "t,q.elbow,dq.elbow,tau.elbow,q_cmd.elbow,dq_cmd.elbow"
    np.savetxt(file, table, delimiter=",", header=names, comments="", fmt="%.9g")
    file.with_suffix(".yaml").write_text(
        f"controller: {{type: pd, kp: {{elbow: {KP}}}, kd: {{elbow: {KD}}}}}\neffort: {effort}\ninput: q_cmd\n"
    )
    return file


def _late(of):
    return (False, False, True) if of == "effort" else (True, True, False)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("late")
    path = write_model(folder / "model.xml", 0.3, 0.2)
    model = RigidModel(path)
    return path, [late_run(folder, model, f"r{k}", k, float(k)) for k in range(2)]


def test_stamps_that_explain_nearly_all_are_named_though_something_small_is_left(tmp_path):
    """The stamps are ten times as much as a push that comes back in both runs."""
    model = RigidModel(write_model(tmp_path / "model.xml", 0.3, 0.2))
    files = [
        late_run(tmp_path, model, f"{name}{k}", k, phase, push=0.03)
        for k, (name, phase) in enumerate((("fit", 0.0), ("again", 0.0), ("held", 1.0)))
    ]
    answer = analyse(tmp_path / "model.xml", files[:1], files[2:], files[1:2], QUICK, lambda _: None)
    assert answer.problem is not None
    assert answer.problem.set_right > 0.95
    assert answer.decision is not None
    assert answer.decision.leftover > 2.0
    assert [e.name for e in answer.decision.effects] == ["clock_skew"]


def test_late_stamps_are_the_only_name_and_no_friction_is_lost_to_them(recordings):
    path, (fit, hold) = recordings
    said = json.loads(json.dumps(make_answer(analyse(path, [fit], [hold], [], QUICK, lambda _: None), 0)))
    assert said["verdict"] == "physics_missing"
    assert [e["name"] for e in said["effects"]] == ["clock_skew"]
    assert said["effects"][0]["parameters"]["lag"]["value"] == pytest.approx(0.012, rel=0.03)
    assert said["parameters_off"] == []


@pytest.mark.parametrize("effort", ["measured", "commanded"])
def test_late_stamps_of_the_effort_are_no_late_drive(tmp_path, effort):
    """The law alone would be content with a delay of the drive; the joint had moved before."""
    path = write_model(tmp_path / "model.xml", 0.3, 0.2)
    model = RigidModel(path)
    fit, hold = (
        late_run(tmp_path, model, f"r{k}", k, float(k), of="effort", effort=effort) for k in range(2)
    )
    found = analyse(path, [fit], [hold], [], QUICK, lambda _: None)
    assert found.decision is not None
    assert [e.name for e in found.decision.effects] == ["clock_skew"]
    assert found.decision.effects[0].parameters["lag"]["value"] == pytest.approx(-0.012, rel=0.05)
    assert "actuator_delay" not in found.decision.effects[0].could_also_be
    assert found.decision.parameters_off == []
    assert found.twin is not None
    assert found.twin.lag == {}  # the position of the forward simulation has no lag
