"""The drawer in MuJoCo: shape, mass, hidden friction and play."""

import mujoco
import numpy as np
import pytest

from s2r_sim.objects.drawer import draw_slop
from s2r_sim.physics import Physics, build_world
from s2r_sim.world import draw_world, load_world


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


@pytest.fixture
def loose(arm, world):
    """A drawer whose rail has clearance."""
    slop = draw_slop(np.random.default_rng(3))
    return Physics(arm, world.model_copy(update={"object": world.object.model_copy(update={"slop": slop})}))


def press(physics, joint, effort, steps):
    """Press on the drawer along one of its joints, then let go; returns that joint's value at the end of each."""
    address = int(physics.model.joint(joint).dofadr[0])
    values = []
    for applied in (effort, 0.0):
        for _ in range(steps):
            physics.data.qfrc_applied[address] = applied
            physics.step(hold_arm(physics))
        values.append(float(physics.data.joint(joint).qpos[0]))
    return values


@pytest.mark.parametrize(("joint", "lever_m"), [("object_play_y", 1.0), ("object_play_yaw", 0.3)])
def test_within_its_clearance_a_loose_drawer_stays_where_it_is_pressed_to(loose, joint, lever_m):
    half = float(loose.model.joint(joint).range[1])
    rubs = float(loose.model.dof_frictionloss[loose.model.joint(joint).dofadr[0]])
    held, left = press(loose, joint, 0.7 * rubs, 100)
    assert abs(held) < 0.02 * half  # friction alone holds it
    pressed, left = press(loose, joint, rubs + 4.0 * lever_m, 300)
    assert half < pressed < 1.1 * half + 1e-4  # the stop is stiff
    assert left == pytest.approx(half, rel=0.05)  # nothing leads it back


def test_a_loose_drawer_drops_its_front_as_it_is_drawn_out(loose):
    pitch, slide = loose.data.joint("object_play_pitch"), loose.data.joint("object_joint")
    half = float(loose.model.joint("object_play_pitch").range[1])
    leans = []
    for opening in (0.05, 0.30):
        slide.qpos[0] = opening
        for _ in range(400):
            loose.step(hold_arm(loose))
        leans.append(float(pitch.qpos[0]))
    assert leans[0] == pytest.approx(-half, rel=0.1)
    assert leans[1] == pytest.approx(half, rel=0.1)


def test_a_loose_drawer_stays_where_it_was_left_and_ends_at_its_range(loose, world):
    push_part(loose, 0.0, 300)
    assert abs(push_part(loose, 0.0, 700)) < 2e-5
    assert abs(push_part(loose, 0.8 * world.object.coulomb_N, 300)) < 2e-4
    push_part(loose, 60.0, 1500)
    assert loose.object_value == pytest.approx(world.object.range_m, abs=2e-3)


def test_a_tight_rail_is_written_and_sealed_as_before_rails_could_be_loose(tmp_path, world):
    assert "slop" not in world.to_json()
    hidden = world.model_copy(
        update={"object": world.object.model_copy(update={"slop": draw_slop(np.random.default_rng(0))})}
    )
    hidden.save(tmp_path / "world.json")
    assert load_world(tmp_path / "world.json") == hidden
    assert load_world(tmp_path / "world.json").commitment == hidden.commitment != world.commitment


def test_outwards_is_towards_the_arm(physics):
    handle = physics.data.geom("part_handle_bar").xpos.copy()
    physics.data.qpos[physics.model.joint("object_joint").qposadr[0]] += 0.1
    mujoco.mj_kinematics(physics.model, physics.data)
    moved = physics.data.geom("part_handle_bar").xpos - handle
    assert moved[0] < -0.09
    assert np.linalg.norm(moved) == pytest.approx(0.1, abs=1e-6)
