"""Recordings that MuJoCo made, without any noise: what its solver does to friction and time is no missing physics."""

import mujoco
import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.pipeline import analyse, load_sessions
from s2r_host.gap.recordings.leading_position import lead_of_position
from s2r_host.gap.regression.friction_edge import find_edges

DT, KP, KD = 0.002, 60.0, 4.0
QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)
ARM = """<mujoco><option timestep="0.002"/><worldbody><body>
<joint name="elbow" axis="0 1 0" damping="0.1" frictionloss="{friction}" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" mass="1"/></body></worldbody></mujoco>"""
TONES = ((0.5, 0.23, 0.0), (0.25, 0.7, 1.0), (0.1, 1.6, 2.0))


def tones(t):
    """Position and speed asked for."""
    q = sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in TONES)
    return q, sum(2 * np.pi * f * a * np.cos(2 * np.pi * f * t + p) for a, f, p in TONES)


def places(t):
    """From place to place at a constant speed, with a stop of 0.8 s at each."""
    stops = np.array((0.0, 0.3, 0.6, 0.9, 1.2, 0.6, 0.0, -0.5, -1.0, -0.4, 0.2, 0.0))
    k, into = int(t // 1.4), min(t % 1.4, 0.6) / 0.6
    if k + 1 >= len(stops):
        return stops[-1], 0.0
    way = stops[k + 1] - stops[k]
    return stops[k] + way * into, way / 0.6 * (into < 1.0)


def steps(t):
    """A new place every second, asked for at once."""
    return np.random.default_rng(int(t)).uniform(-0.6, 0.6), 0.0


def recorded(folder, friction=0.05, known=0.05, noise=0.0, duration=20.0, motion=tones):
    """Write a run of the arm under PD control with Euler's steps, as MuJoCo's state says it; returns model and file."""
    model = folder / "model.xml"
    model.write_text(ARM.format(friction=known))
    m = mujoco.MjModel.from_xml_string(ARM.format(friction=friction))
    d = mujoco.MjData(m)
    rows = []
    for k in range(int(duration / DT)):
        t = k * DT
        q, dq = motion(t)
        u = KP * (q - d.qpos[0]) + KD * (dq - d.qvel[0])
        rows.append((t, d.qpos[0], d.qvel[0], u, q, dq))
        d.qfrc_applied[0] = u
        mujoco.mj_step(m, d)
    table = np.array(rows)
    table[:, 1:4] += np.array(noise) * np.random.default_rng(0).normal(size=(len(table), 3))
    names = ",".join(["t", *(f"{kind}.elbow" for kind in ("q", "dq", "tau", "q_cmd", "dq_cmd"))])
    path = folder / "run.csv"
    np.savetxt(path, table, delimiter=",", header=names, comments="", fmt="%.10g")
    path.with_suffix(".yaml").write_text(
        f"controller: {{type: pd, kp: {{elbow: {KP}}}, kd: {{elbow: {KD}}}, rate_hz: {1 / DT}}}\n"
        "effort: commanded\ninput: q_cmd\n"
    )
    return model, path


def test_nothing_is_missing_in_a_run_of_the_model_itself(tmp_path):
    model, path = recorded(tmp_path)
    found = analyse(model, [path], [], [], QUICK, lambda _: None)
    assert found.verdict == "nothing_missing"


def test_friction_that_the_model_lacks_is_still_named(tmp_path):
    model, path = recorded(tmp_path, friction=0.4, known=0.0)
    found = analyse(model, [path], [], [], QUICK, lambda _: None)
    (named,) = found.decision.effects
    assert named.name == "coulomb_friction"
    assert named.parameters["level"]["value"] == pytest.approx(0.4, rel=0.03)


def test_the_step_of_its_friction_is_early_and_its_position_ahead_by_half_a_step(tmp_path):
    path, run = recorded(tmp_path)
    model = RigidModel(path)
    (s,) = load_sessions(model, [run], 0, [])
    find_edges([s], model)
    assert s.lead[0] == model.friction_lead("elbow") == pytest.approx(0.0095)
    assert lead_of_position(s.rec, "elbow") == pytest.approx(0.5 * DT, rel=0.02)


def test_noise_hides_the_half_step(tmp_path):
    path, run = recorded(tmp_path, noise=1e-3)
    (s,) = load_sessions(RigidModel(path), [run], 0, [])
    assert lead_of_position(s.rec, "elbow") == 0.0


@pytest.mark.parametrize("motion", [places, steps])
@pytest.mark.parametrize("friction", [0.05, 0.35])
def test_nothing_is_missing_in_a_noisy_run_that_stops_often(tmp_path, motion, friction):
    model, path = recorded(tmp_path, friction, friction, (2e-5, 3e-3, 0.05), motion=motion)
    found = analyse(model, [path], [], [], QUICK, lambda _: None)
    assert found.verdict == "nothing_missing", (found.decision.effects, found.decision.parameters_off)


def test_a_joint_that_never_turns_round_tells_no_early_friction(tmp_path):
    path, run = recorded(tmp_path, motion=lambda t: (0.05 * t, 0.05))
    model = RigidModel(path)
    (s,) = load_sessions(model, [run], 0, [])
    find_edges([s], model)
    assert s.lead[0] == 0.0


RAIL = """<mujoco><option timestep="0.001"/><worldbody><body>
<joint name="rail" type="slide" axis="1 0 0" damping="5" frictionloss="6"/>
<geom type="box" size=".1 .1 .1" mass="2"/></body></worldbody></mujoco>"""


def test_the_friction_of_a_heavy_joint_glides_through_its_step(tmp_path):
    (tmp_path / "model.xml").write_text(RAIL)
    model = RigidModel(tmp_path / "model.xml")
    m = mujoco.MjModel.from_xml_string(RAIL)
    d, dt, rows = mujoco.MjData(m), 0.001, []
    rng = np.random.default_rng(0)
    for k in range(20000):
        t = k * dt
        q, dq = 0.05 * np.sin(2.0 * t), 0.1 * np.cos(2.0 * t)
        u = 8000.0 * (q - d.qpos[0]) + 300.0 * (dq - d.qvel[0])
        if k % 4 == 0:
            noisy = np.array([d.qpos[0], d.qvel[0], u]) + np.array([4e-6, 2e-4, 0.1]) * rng.normal(size=3)
            rows.append((t, *noisy, q, dq))
        d.qfrc_applied[0] = u
        mujoco.mj_step(m, d)
    names = ",".join(["t", *(f"{kind}.rail" for kind in ("q", "dq", "tau", "q_cmd", "dq_cmd"))])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header=names, comments="", fmt="%.10g")
    (tmp_path / "run.yaml").write_text("effort: commanded\ninput: effort\n")
    (s,) = load_sessions(model, [tmp_path / "run.csv"], 0, [])
    find_edges([s], model)
    assert s.lead[0] == pytest.approx(0.0095)
    # R / B of the constraint: a ninth of the inverse mass, times the lead; a tanh of 0.72 of that
    assert model.friction_slip("rail") == pytest.approx(0.0095 / 9.0 / 2.0)
    assert s.v_eps[0] == pytest.approx(0.72 * 6.0 * model.friction_slip("rail"), rel=0.2)
