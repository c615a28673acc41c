"""A link that swings behind its motor is felt by the other joints of an arm."""

import mujoco
import numpy as np
import pytest

from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import Context
from s2r_host.gap.effects.joint_elasticity import mean_inertia, shared_inertia
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import lowpass, make_session
from s2r_host.gap.recordings.recording import Controller, Recording

MOTOR, STEP_S, EVERY = 0.3, 0.0002, 10
STIFFNESS, DAMPING = 3000.0, 6.0
ARM = """<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0" damping="0.5" armature="{motor}"/>{flex}
<inertial mass="4" pos="0.2 0 0" diaginertia="0.02 0.05 0.05"/><body name="fore" pos="0.4 0 0">
<joint name="elbow" axis="0 1 0" damping="0.3" armature="0.05"/>
<inertial mass="2" pos="0.2 0 0" diaginertia="0.01 0.03 0.03"/></body></body></worldbody></mujoco>"""
SPRING = '<joint name="flex" axis="0 1 0" stiffness="{k}" damping="{d}"/>'
GAINS = {"shoulder": (400.0, 40.0), "elbow": (150.0, 10.0)}


def recorded(model, flex):
    """Twelve seconds under a servo, positions read at the motors, every two milliseconds."""
    m = mujoco.MjModel.from_xml_string(ARM.format(step=STEP_S, motor=MOTOR, flex=flex))
    d = mujoco.MjData(m)
    dof = np.array([m.joint(j).dofadr[0] for j in model.joints])
    d.qpos[dof] = 1.6, 0.2
    rows = []
    for i in range(round(12.0 / STEP_S)):
        t = i * STEP_S
        asked = np.array([1.6 + 0.4 * np.sin(3.0 * t) + 0.1 * np.sin(11.0 * t), 0.2 + 0.4 * np.sin(2.3 * t)])
        kp, kd = (np.array([GAINS[j][k] for j in model.joints]) for k in (0, 1))
        u = kp * (asked - d.qpos[dof]) - kd * d.qvel[dof]
        if i % EVERY == 0:
            rows.append((d.qpos[dof].copy(), u))
        d.qfrc_applied[dof] = u
        mujoco.mj_step(m, d)
    q, u = (np.stack(x) for x in zip(*rows, strict=True))
    channels = {kind: {j: x[:, k] for k, j in enumerate(model.joints)} for kind, x in (("q", q), ("tau", u))}
    t = np.arange(len(q)) * STEP_S * EVERY
    return make_session(
        model, Recording("r", t, channels, Controller(), "measured", "effort", "a", "", ()), 0
    )


@pytest.fixture(scope="module")
def swinging(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "model.xml"
    path.write_text(ARM.format(step=STEP_S, motor=MOTOR, flex=""))
    model = RigidModel(path)
    return Context(model, [recorded(model, SPRING.format(k=STIFFNESS, d=DAMPING))])


def test_what_swings_behind_one_motor_is_felt_by_the_next_joint(swinging):
    s = swinging.sessions[0]
    link = mean_inertia(swinging, 0) - MOTOR
    w = np.sqrt(STIFFNESS / link)
    motor = MOTOR / mean_inertia(swinging, 0)
    shape = {"f": w / (2 * np.pi), "zeta": DAMPING / (2 * w * link), "motor": motor}
    columns = catalogue()["joint_elasticity"].columns(swinging, s, 0, shape)
    for joint, said in enumerate((columns.fixed, columns.linear[0][:, 1])):
        seen, told = (lowpass(x[1500:-200], 12.0, s.dt) for x in (s.u[:, joint] - s.load[:, joint], said))
        assert np.std(seen - told) < 0.06 * np.std(seen)


def test_play_at_one_joint_is_felt_by_the_next(swinging):
    s = swinging.sessions[0]
    shape = {"w": 0.002, "f": 20.0, "zeta": 0.3, "motor": MOTOR / mean_inertia(swinging, 0)}
    columns = catalogue()["backlash"].columns(swinging, s, 0, shape)
    shared = np.mean(shared_inertia(swinging, s, 0), axis=0)
    felt = np.std(columns.linear[0][:, 1]) / np.std(columns.fixed)
    assert felt == pytest.approx(shared[1] / (shared[0] - MOTOR), rel=0.2)
