"""Numbers refitted on the simulated motion, and what a compiled model keeps from a change."""

import mujoco
import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.recordings.files import read_recording
from s2r_host.gap.regression.nuisance import base_parameters

XML = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody><body name="cart">
<joint name="slide" type="slide" axis="1 0 0" damping="{damping}" frictionloss="{dry}"/>
<inertial mass="{mass}" pos="0 0 0" diaginertia="1 1 1"/></body></worldbody></mujoco>"""
SECONDS = 8.0


def _record(path, session, factor, seed):
    """A cart whose viscosity differs by direction, driven by a loop nobody recorded."""
    m = mujoco.MjModel.from_xml_string(XML.format(damping=80, dry=8 * factor, mass=20))
    m.dof_solref[:], m.dof_solimp[:] = (0.001, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)
    d, rng, rows = mujoco.MjData(m), np.random.default_rng(seed), []
    for k in range(int(SECONDS / 0.001)):
        t = k * 0.001
        wish = min(t, 1.0) * (0.12 * np.sin(2 * np.pi * 0.3 * t) + 0.05 * np.sin(2 * np.pi * 0.8 * t + seed))
        u = 4000 * (wish - d.qpos[0]) - 200 * d.qvel[0]
        if k % 4 == 0:
            rows.append((t, d.qpos[0] + 2e-7 * rng.standard_normal(), u + 0.1 * rng.standard_normal()))
        m.dof_damping[0] = factor * (100 if d.qvel[0] > 0 else 60)
        d.qfrc_applied[0] = u
        mujoco.mj_step(m, d)
    np.savetxt(path, rows, delimiter=",", header="t,q.slide,tau.slide", comments="")
    path.with_suffix(".yaml").write_text(f"effort: commanded\ninput: effort\nsession: {session}\n")
    return path


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cart")
    model = folder / "cart.xml"
    model.write_text(XML.format(damping=80, dry=8, mass=20.2))
    first = _record(folder / "first.csv", "first", 1.0, 1)
    second = _record(folder / "second.csv", "second", 1.06, 2)
    config = GapConfig(baselines=False, open_loop_window_s=np.inf, calibrate_s=3.0)
    return analyse(model, [first], [second], [], config, lambda _: None)


def test_the_mass_of_a_plain_slide_is_a_parameter_that_matters(tmp_path):
    path = tmp_path / "cart.xml"
    path.write_text(XML.format(damping=80, dry=8, mass=20))
    model = RigidModel(path)
    session = make_session(model, read_recording(_record(tmp_path / "a.csv", "a", 1.0, 1)), 0)
    mass = next(p for p in base_parameters(model) if p.name == "mass")
    assert mass.column(session)[:, 0] == pytest.approx(20.0 * session.a[:, 0], abs=1e-6)


def test_an_asymmetric_viscosity_is_named_and_the_simulated_motion_follows(cart):
    named = {e.name: e for e in cart.decision.effects}
    table = named["asymmetric_friction"].parameters
    assert table["viscous_positive"]["value"] == pytest.approx(100, rel=0.04)
    assert table["viscous_negative"]["value"] == pytest.approx(60, rel=0.04)
    assert cart.after.open_train[0] < 0.2 * cart.before.open_train[0]


def test_a_new_session_is_calibrated_by_one_factor_on_all_its_friction(cart):
    factor = cart.twin.friction_factor["second"][0]
    assert factor == pytest.approx(1.06, abs=0.015)
    assert any("changed by +" in note and "first 3 s" in note for note in cart.notes)
    assert cart.after.open_held[0] < 0.1 * cart.before.open_held[0]
