"""Arm and object together: the drives move the arm, the arm moves the drawer against its hidden friction."""

import mujoco
import numpy as np
import pytest

from s2r_protocol.can.drive import DriveCommand
from s2r_sim.errors import StandInError, WorldFileError
from s2r_sim.physics import Physics
from s2r_sim.plant import Plant
from s2r_sim.score import read_truth
from s2r_sim.truth import TruthLog
from s2r_sim.world import Gears, load_world


class Cell:
    """Drives the plant without a bus: joint moves on a smooth law, and straight lines of the tool tip."""

    def __init__(self, arm, world):
        self.world, self.plant = world, Plant(arm, world)
        self.model = mujoco.MjSpec.from_string(arm.mjcf).compile()
        self.limits = arm.limits
        self.q = np.array(self.plant.physics.q)
        for command in (DriveCommand.SHUTDOWN, DriveCommand.SWITCH_ON, *[DriveCommand.ENABLE_OPERATION] * 60):
            self.tick(command, self.q, np.zeros(7))

    def tick(self, command, q, dq):
        for drive, position, velocity in zip(self.plant.drives, q, dq, strict=True):
            drive.command(command)
            drive.set_point(position, velocity, 0.0)
        self.plant.advance(1_000_000)

    def move(self, q_goal, duration_s):
        start, n = self.q, round(1000 * duration_s)
        for x in np.arange(1, n + 1) / n:
            share = x**3 * (10 - 15 * x + 6 * x * x)
            rate = 30 * x * x * (1 - x) ** 2 / duration_s
            self.tick(
                DriveCommand.ENABLE_OPERATION, start + share * (q_goal - start), rate * (q_goal - start)
            )
        self.q = q_goal

    def inverse(self, p_goal, R_goal, rounds):
        data, q = mujoco.MjData(self.model), self.q.copy()
        J = np.zeros((6, 7))
        for _ in range(rounds):
            data.qpos[:] = q
            mujoco.mj_kinematics(self.model, data)
            mujoco.mj_comPos(self.model, data)
            tip = data.site("tool_tip")
            mujoco.mj_jacSite(self.model, data, J[:3], J[3:], tip.id)
            turn = R_goal @ tip.xmat.reshape(3, 3).T
            error = np.concatenate([p_goal - tip.xpos, 0.5 * np.array([turn[2, 1], turn[0, 2], turn[1, 0]])])
            error[3:] -= 0.5 * np.array([turn[1, 2], turn[2, 0], turn[0, 1]])
            step = J.T @ np.linalg.solve(J @ J.T + 1e-4 * np.eye(6), error)
            q = np.clip(q + np.clip(step, -0.1, 0.1), self.limits.q_min, self.limits.q_max)
        assert np.linalg.norm(error) < 1e-3
        return q

    def tip_line(self, p_goal, R_goal, duration_s, pieces=8):
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.q
        mujoco.mj_kinematics(self.model, data)
        p_start = data.site("tool_tip").xpos.copy()
        for share in np.arange(1, pieces + 1) / pieces:
            self.move(self.inverse(p_start + share * (p_goal - p_start), R_goal, 40), duration_s / pieces)

    def on_part(self, *p_part):
        body = self.plant.physics.data.body("object_part")
        return body.xpos + body.xmat.reshape(3, 3) @ np.array(p_part)


@pytest.fixture
def cell(arm, world):
    return Cell(arm, world)


def test_arm_holds_its_pose_against_the_unknown_share_of_gravity(cell):
    for _ in range(1500):
        cell.tick(DriveCommand.ENABLE_OPERATION, cell.q, np.zeros(7))
    assert np.max(np.abs(np.array(cell.plant.physics.q) - cell.q)) < 2e-5


def test_hooked_finger_pulls_the_drawer_out_and_it_stays(cell, world):
    drawer, physics = world.object, cell.plant.physics
    out = physics.data.body("object_part").xmat.reshape(3, 3)[:, 0].copy()
    z = np.array([0.0, 0.0, -1.0]) * np.cos(0.35) - out * np.sin(0.35)  # down, a little into the cabinet
    y = out - (out @ z) * z
    y /= np.linalg.norm(y)
    R = np.column_stack([np.cross(y, z), y, z])
    behind = drawer.front_thickness_m + drawer.handle_gap_m / 2
    z_bar = drawer.height_m - drawer.handle_drop_m
    above = cell.on_part(behind, 0.0, z_bar + 0.15)
    cell.move(cell.inverse(above, R, 600), 2.0)
    cell.tip_line(cell.on_part(behind, 0.0, z_bar - 0.012), R, 1.5)
    inserted = physics.object_value
    assert inserted == pytest.approx(drawer.opening_m, abs=2e-3)

    cell.tip_line(cell.on_part(behind, 0.0, z_bar - 0.012) + 0.10 * out, R, 2.0)
    contacts = physics.contacts()
    slack = drawer.handle_gap_m / 2
    assert 0.10 - slack < physics.object_value - inserted < 0.10
    assert contacts.part
    assert contacts.part_force_N < 40.0
    pulled = physics.object_value
    for _ in range(500):
        cell.tick(DriveCommand.ENABLE_OPERATION, cell.q, np.zeros(7))
    assert physics.object_value == pytest.approx(pulled, abs=2e-3)


def elastic(arm, world, wind_up):
    """The world with gears that give this much under the joints' torque limits [rad]."""
    gears = Gears(stiffness_Nm_rad=tuple((arm.limits.tau_max / wind_up).tolist()), relaxation_s=0.0003)
    return world.model_copy(update={"arm": world.arm.model_copy(update={"gears": gears})})


@pytest.fixture(params=[0.0034, 0.009], ids=["stiff", "soft"])
def elastic_cell(request, arm, world):
    return Cell(arm, elastic(arm, world, request.param))


def test_behind_elastic_gears_motors_hold_their_places_and_links_hang_by_what_they_carry(elastic_cell):
    plant = elastic_cell.plant
    for _ in range(1000):
        elastic_cell.tick(DriveCommand.ENABLE_OPERATION, elastic_cell.q, np.zeros(7))
    motors, links = np.array(plant.physics.q), np.array(plant.physics.q_link)
    assert np.max(np.abs(motors - elastic_cell.q)) < 2e-5
    carried = np.array(elastic_cell.world.arm.gears.stiffness_Nm_rad) * (motors - links)
    effort = np.array([drive.tau_meas for drive in plant.drives])
    assert np.max(np.abs(carried)) > 5.0
    np.testing.assert_allclose(carried, effort, atol=max(elastic_cell.world.arm.coulomb_Nm) + 0.1)


def test_elastic_gears_swing_out_after_a_quick_motion(elastic_cell):
    physics = elastic_cell.plant.physics
    away = elastic_cell.q + 0.3
    elastic_cell.move(np.clip(away, elastic_cell.limits.q_min, elastic_cell.limits.q_max), 0.5)
    swung = np.zeros(14)  # motors and gears
    for tick in range(800):
        elastic_cell.tick(DriveCommand.ENABLE_OPERATION, elastic_cell.q, np.zeros(7))
        if tick >= 600:
            swung = np.maximum(
                swung, np.abs(physics.data.qvel[: physics.model.joint("object_play_y").dofadr[0]])
            )
    assert np.max(np.abs(np.array(physics.q) - elastic_cell.q)) < 1e-4
    assert np.max(swung) < 2e-3


def test_the_truth_log_tells_where_the_links_are(arm, world, tmp_path):
    plant = Plant(arm, elastic(arm, world, 0.009))
    log = TruthLog(tmp_path / "truth.csv", plant)
    plant.observers.append(log)
    plant.advance(200_000_000)
    log.close()
    motors, links = np.array(plant.physics.q), np.array(plant.physics.q_link)
    assert np.max(np.abs(motors - links)) > 5e-4
    assert read_truth(tmp_path / "truth.csv").q[-1] == pytest.approx(links, abs=1e-6)


def test_gears_of_another_joint_count_are_refused(arm, world):
    gears = Gears(stiffness_Nm_rad=(1e4,) * 6, relaxation_s=0.0003)
    short = world.model_copy(update={"arm": world.arm.model_copy(update={"gears": gears})})
    with pytest.raises(WorldFileError, match=r"arm\.gears\.stiffness_Nm_rad has 6 entries, .* has 7 joints"):
        Physics(arm, short)


def test_a_world_that_cannot_be_simulated_ends_the_stand_in_before_its_truth_log_tells_what_is_not_so(
    arm, world, tmp_path
):
    """Gears of a hundred times the stiffness that steps of a millisecond bear; MuJoCo would go on with all at zero."""
    gears = Gears(stiffness_Nm_rad=(1e6,) * 7, relaxation_s=0.0003)
    stiff = world.model_copy(update={"arm": world.arm.model_copy(update={"gears": gears})})
    plant = Plant(arm, stiff)
    log = TruthLog(tmp_path / "truth.csv", plant)
    plant.observers.append(log)
    q, found = plant.physics.q, plant.physics.object_value
    commands = (DriveCommand.SHUTDOWN, DriveCommand.SWITCH_ON, *[DriveCommand.ENABLE_OPERATION] * 200)

    def hold():
        for command in commands:
            for drive, position in zip(plant.drives, q, strict=True):
                drive.command(command)
                drive.set_point(position, 0.0, 0.0)
            plant.advance(1_000_000)

    with pytest.raises(StandInError, match="became unstable"):
        hold()
    log.close()
    assert read_truth(tmp_path / "truth.csv").s == pytest.approx(found, abs=1e-3)


def test_rigid_gears_are_written_and_sealed_as_before_gears_could_give(arm, world, tmp_path):
    assert "gears" not in world.to_json()
    hidden = elastic(arm, world, 0.005)
    hidden.save(tmp_path / "world.json")
    assert load_world(tmp_path / "world.json") == hidden
    assert load_world(tmp_path / "world.json").commitment == hidden.commitment != world.commitment


def test_object_in_the_arms_place_is_refused(arm, world):
    inside = world.object.model_copy(update={"x_front_m": 0.30, "y_m": 0.13, "height_m": 0.40})
    with pytest.raises(WorldFileError, match="where the arm is in its home pose"):
        Physics(arm, world.model_copy(update={"object": inside}))


def test_shapes_that_cannot_be_are_refused_by_their_name(arm, world):
    thin = world.model_copy(update={"object": world.object.model_copy(update={"width_m": -0.1})})
    with pytest.raises(WorldFileError, match=r"MuJoCo takes no such world: .* 'base_back'"):
        Physics(arm, thin)


def test_arm_truth_of_another_joint_count_is_refused(arm, world):
    short = world.arm.model_copy(update={"coulomb_Nm": (0.5, 0.5)})
    with pytest.raises(WorldFileError, match=r"coulomb_Nm has 2 entries, arm xmate3pro has 7 joints"):
        Physics(arm, world.model_copy(update={"arm": short}))
