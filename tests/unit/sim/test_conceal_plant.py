"""The integrator: exact friction, energy, agreement of the rigs with independent equations."""

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from s2r_conceal.motions import RATE_HZ, derivatives, poor, rich
from s2r_conceal.parameters import Controller, Heating, Machine, Motion, Sensing
from s2r_conceal.plant import SETTLE_TICKS, Column, simulate
from s2r_conceal.rigs import rig_named


def _free(rig, machine, q0, ticks=400):
    """A column without controller, starting at rest at ``q0``."""
    n = rig.joints
    zeros, ones = np.zeros(n), np.ones(n)
    q = np.tile(q0, (ticks, 1))
    return Column(
        machine,
        Controller(zeros, zeros, zeros),
        Motion(q, np.zeros_like(q), np.zeros_like(q)),
        Sensing(1e-6 * ones, zeros, zeros, zeros, zeros, 0.1),
        Heating(zeros, ones, 10.0),
    )


def _without_friction(machine):
    return replace(machine, coulomb=np.zeros_like(machine.coulomb), viscous=np.zeros_like(machine.viscous))


def test_a_small_pendulum_swings_with_its_textbook_period():
    rig = rig_named("one_joint")
    machine = Machine(
        mass=np.array([2.0]),
        com=np.array([[0.0, 0.0, -0.3]]),
        inertia=np.zeros((1, 3, 3)),
        armature=np.array([0.05]),
        viscous=np.zeros(1),
        coulomb=np.zeros(1),
        gravity=np.array([0.0, 0.0, -9.81]),
    )
    trace = simulate(rig, [_free(rig, machine, np.array([0.02]), 1500)])[0]
    period = 2 * np.pi * np.sqrt((2.0 * 0.3**2 + 0.05) / (2.0 * 9.81 * 0.3))
    t = (np.arange(1500) + SETTLE_TICKS) / RATE_HZ
    assert trace.q[:, 0] == pytest.approx(0.02 * np.cos(2 * np.pi * t / period), abs=2e-4)


def test_dry_friction_holds_still_below_its_bound_and_never_creeps():
    rig = rig_named("one_joint")
    machine = replace(rig.draw(np.random.default_rng(2)), coulomb=np.array([1e3]))
    trace = simulate(rig, [_free(rig, machine, np.array([0.4]))])[0]
    assert np.ptp(trace.q) == 0.0


def test_two_links_keep_their_energy_without_friction():
    rig = rig_named("two_link")
    machine = _without_friction(rig.draw(np.random.default_rng(4)))
    trace = simulate(rig, [_free(rig, machine, np.array([0.3, -0.5]), 300)])[0]
    dynamics = rig.dynamics([machine])
    mass = dynamics.mass_matrix(trace.q.astype(float)) + np.diag(machine.armature)
    kinetic = 0.5 * np.einsum("ti,tij,tj->t", trace.dq, mass, trace.dq)
    still = np.zeros_like(trace.q)
    power = np.sum(dynamics.bias(trace.q, still) * trace.dq, axis=1)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1])) / RATE_HZ])
    total = kinetic + work
    assert np.ptp(total) < 0.01 * np.ptp(kinetic)


def test_two_links_agree_with_recursive_newton_euler():
    rig = rig_named("two_link")
    machine = replace(
        rig.draw(np.random.default_rng(7)), armature=np.zeros(2), gravity=np.array([1.0, 0.0, -9.0])
    )
    model = pin.Model()
    parent = 0
    for i, place in enumerate(([0.0, 0.0, 0.0], [0.35, 0.0, 0.0])):
        parent = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), np.array(place)), f"j{i}")
        body = pin.Inertia(float(machine.mass[i]), machine.com[i], machine.inertia[i])
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    model.gravity.linear = machine.gravity
    rng = np.random.default_rng(8)
    q, dq, ddq = rng.normal(size=(3, 5, 2))
    expected = [pin.rnea(model, model.createData(), *row) for row in zip(q, dq, ddq, strict=True)]
    assert rig.inverse_dynamics(machine, q, dq, ddq) == pytest.approx(np.array(expected), abs=1e-9)


def test_noise_is_the_only_difference_between_two_runs_of_a_motion():
    rig = rig_named("one_joint")
    column = _free(rig, _without_friction(rig.draw(np.random.default_rng(5))), np.array([0.1]))
    noisy = replace(column.sensing, process=np.array([0.05]), q_noise=np.array([1e-5]))
    columns = [replace(column, sensing=noisy, noise=seed) for seed in (None, (1, 2), (1, 2), (1, 3))]
    quiet, one, again, other = (t.q for t in simulate(rig, columns, substeps=2))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
    assert 0.0 < np.abs(one - quiet).max() < 0.1


def test_rich_motions_are_smooth_and_stay_in_range():
    for seed in range(5):
        q = rich(np.random.default_rng(seed), 10.0)
        dq, ddq = derivatives(q)
        assert np.abs(q).max() <= 1.0
        assert np.abs(np.diff(ddq)).max() < 3.0
        assert np.abs(dq[[0, -1]]).max() < 1e-6


def test_poor_motions_show_little():
    rng = np.random.default_rng(0)
    assert np.ptp(poor(rng, "still", 3.0)) == 0.0
    assert np.all(np.diff(poor(rng, "one_way", 3.0)) >= 0.0)
    assert np.ptp(poor(rng, "crawl", 3.0)) < 0.01


def _in_mujoco(column, model):
    """The same loop stepped by MuJoCo at the plant's step, friction constraint made stiff."""
    model.opt.timestep = 1e-4
    model.dof_solref[:] = (0.001, 1.0)
    model.dof_solimp[:] = (0.9999, 0.9999, 0.001, 0.5, 2.0)
    data = mujoco.MjData(model)
    motion, gains = column.motion, column.controller
    data.qpos[:] = motion.q_cmd[0]
    out = np.zeros_like(motion.q_cmd)
    for tick in range(-SETTLE_TICKS, len(out)):
        row, moving = max(tick, 0), tick >= 0
        out[row] = data.qpos
        error = motion.q_cmd[row] - data.qpos
        data.ctrl[:] = gains.kp * error + gains.kd * (motion.dq_cmd[row] * moving - data.qvel)
        for _ in range(10):
            mujoco.mj_step(model, data)
    return out


@pytest.mark.parametrize("name", ["one_joint", "two_link"])
def test_the_plant_agrees_with_mujoco_once_its_friction_is_made_stiff(name):
    rig = rig_named(name)
    machine = rig.draw(np.random.default_rng(12))
    t = np.arange(600) / RATE_HZ
    q = 0.3 * (1.0 - np.cos(2 * np.pi * 1.5 * t))[:, None] * np.linspace(1.0, -0.7, rig.joints)
    dq, _ = derivatives(q)
    column = _free(rig, machine, np.zeros(rig.joints))
    gains = 300.0 * np.ones(rig.joints)
    column = replace(
        column,
        motion=Motion(q, dq, np.zeros_like(q)),
        controller=Controller(gains, 0.1 * gains, 0.0 * gains),
    )
    trace = simulate(rig, [column])[0]
    model = mujoco.MjModel.from_xml_string(rig.mjcf(machine, [{} for _ in rig.joint_names]))
    assert trace.q == pytest.approx(_in_mujoco(column, model), abs=5e-5)
