"""The drawer in MuJoCo: shape, mass, hidden friction and play."""

import mujoco
import numpy as np
import pytest

from s2r_sim.physics import Physics, build_world
from s2r_sim.world import draw_world


@pytest.fixture
def physics(arm, world):
    return Physics(arm, world)


def hold_arm(physics):
    """Keep the arm where it is, out of the way: its joints are locked by stiff torques."""
    q0, kp, kd = physics.q, 8000.0, 200.0
    bias = physics.nominal_torque(physics.q, physics.dq, [0.0] * physics.dof)
    return [b + kp * (a - q) - kd * v for b, a, q, v in zip(bias, q0, physics.q, physics.dq, strict=True)]


def push_part(physics, force_N, steps):
    """Push on the drawer along its rail, outwards positive; returns how far it moved."""
    joint = physics.model.joint("object_joint")
    before = physics.object_value
    for _ in range(steps):
        physics.data.qfrc_applied[joint.dofadr[0]] = force_N
        physics.step(hold_arm(physics))
    return physics.object_value - before


def test_drawer_resists_less_than_its_coulomb_friction(physics, world):
    assert abs(push_part(physics, 0.8 * world.object.coulomb_N, 500)) < 2e-4


def test_drawer_moves_when_pushed_over_its_friction(physics, world):
    assert push_part(physics, world.object.coulomb_N + 6.0, 300) > 0.01


def test_drawer_stays_where_it_was_left(physics):
    assert abs(push_part(physics, 0.0, 1000)) < 2e-5


def test_drawer_ends_at_its_range(physics, world):
    push_part(physics, 60.0, 1500)
    assert physics.object_value == pytest.approx(world.object.range_m, abs=2e-3)


@pytest.mark.parametrize("seed", range(10))
def test_sliding_mass_is_the_drawn_one(arm, seed):
    world = draw_world(seed, salt="a")
    model = build_world(arm, world)
    assert model.body("object_part").mass[0] == pytest.approx(world.object.mass_kg, rel=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_front_closes_flush_and_handle_sticks_out(arm, seed):
    world = draw_world(seed, salt="a")
    model = build_world(arm, world)
    front, bar = model.geom("part_front"), model.geom("part_handle_bar")
    drawer = world.object
    assert front.pos[0] - front.size[0] == pytest.approx(0.0, abs=1e-9)
    gap = (bar.pos[0] - bar.size[0]) - (front.pos[0] + front.size[0])
    assert gap == pytest.approx(drawer.handle_gap_m, abs=1e-9)
    assert front.pos[2] + front.size[2] - bar.pos[2] == pytest.approx(drawer.handle_drop_m, abs=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_fingertip_fits_behind_the_bar(arm, seed):
    drawer = draw_world(seed, salt="a").object
    model = mujoco.MjSpec.from_string(arm.mjcf).compile()
    fingers = [model.geom(name) for name in ("finger_left", "finger_right")]
    thickness = max(f.pos[1] + f.size[1] for f in fingers) - min(f.pos[1] - f.size[1] for f in fingers)
    assert thickness < drawer.handle_gap_m
    assert 2 * fingers[0].size[0] < drawer.handle_width_m - 2 * drawer.handle_bar_m


def test_play_joints_spring_back_and_stay_small(physics, world):
    play = physics.model.joint("object_play_y")
    for _ in range(300):
        physics.data.qfrc_applied[play.dofadr[0]] = 30.0
        physics.step(hold_arm(physics))
    assert 0 < physics.data.qpos[play.qposadr[0]] < world.object.play_m + 2e-4
    physics.data.qfrc_applied[play.dofadr[0]] = 0.0
    for _ in range(500):
        physics.step(hold_arm(physics))
    assert abs(physics.data.qpos[play.qposadr[0]]) < 2e-5


def test_outwards_is_towards_the_arm(physics):
    handle = physics.data.geom("part_handle_bar").xpos.copy()
    physics.data.qpos[physics.model.joint("object_joint").qposadr[0]] += 0.1
    mujoco.mj_kinematics(physics.model, physics.data)
    moved = physics.data.geom("part_handle_bar").xpos - handle
    assert moved[0] < -0.09
    assert np.linalg.norm(moved) == pytest.approx(0.1, abs=1e-6)
