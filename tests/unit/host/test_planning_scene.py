"""The two models: same joints, different rules about contacts, and refusals of unusable object files."""

import mujoco
import numpy as np
import pytest

from s2r_host.planning.execution import FineWorld, play_side_by_side
from s2r_host.planning.sample_objects import DrawerShape, drawer_mjcf, faucet_mjcf, lid_mjcf
from s2r_host.planning.scene import GeomKind, SceneFileError, build_scene
from s2r_host.planning.settings import PlanSettings, Stage
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")


@pytest.fixture
def drawer(tmp_path):
    path = tmp_path / "object.xml"
    path.write_text(drawer_mjcf(DrawerShape()))
    return path


def test_both_models_have_the_same_joints_in_the_same_order(drawer):
    scene = build_scene(ARM, drawer, "object_joint", PlanSettings())
    for model in (scene.coarse, scene.fine):
        names = [model.joint(i).name for i in range(model.njnt)]
        assert names == [*ARM.joint_names, "object/object_joint"]
    assert scene.prismatic
    assert scene.s_qpos == 7
    assert scene.s_range == pytest.approx((-0.07, 0.21))


def test_every_geom_knows_what_it_belongs_to(drawer):
    scene = build_scene(ARM, drawer, "object_joint", PlanSettings())
    kinds = {scene.fine.geom(i).name: scene.geom_kind[i] for i in range(scene.fine.ngeom)}
    assert kinds["finger_left"] == GeomKind.FINGER
    assert kinds["link4_body"] == GeomKind.ROBOT
    assert kinds["object/part_bar"] == GeomKind.PART
    assert kinds["object/base_top"] == GeomKind.WORLD
    assert kinds["table"] == GeomKind.WORLD


def test_only_the_fine_model_saturates_torques(drawer):
    scene = build_scene(ARM, drawer, "object_joint", PlanSettings())
    assert scene.fine.jnt_actfrclimited[:7].all()
    assert scene.fine.jnt_actfrcrange[:7, 1] == pytest.approx(ARM.limits.tau_max)
    assert not scene.coarse.jnt_actfrclimited[:7].any()


def test_rollout_model_takes_the_stage_s_time_step_and_leaves_the_scene_alone(drawer):
    scene = build_scene(ARM, drawer, "object_joint", PlanSettings())
    model = scene.rollout_model(Stage(0.010, 60, True))
    assert model.opt.timestep == 0.010
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
    link = model.geom("link4_body").id
    assert model.geom_conaffinity[link] == 3
    assert scene.coarse.geom_conaffinity[link] == 2


@pytest.mark.parametrize("self_collision", [False, True])
def test_a_folded_arm_touches_itself_in_the_rollouts_of_the_stages_that_say_so(drawer, self_collision):
    scene = build_scene(ARM, drawer, "object_joint", PlanSettings())
    robot = scene.geom_kind >= GeomKind.ROBOT

    def touches_itself(model, q):
        data = mujoco.MjData(model)
        data.qpos[: scene.dof] = q
        mujoco.mj_forward(model, data)
        return bool(robot[data.contact.geom].all(axis=1).any())

    folded = [-2.6, -1.16, 0.62, -1.89, 2.8, 2.08, -4.51]
    assert touches_itself(scene.fine, folded)
    model = scene.rollout_model(Stage(self_collision=self_collision))
    assert touches_itself(model, folded) == self_collision
    assert not touches_itself(model, ARM.q_home)


def test_arm_holds_its_pose_against_gravity(drawer):
    scene = build_scene(ARM, drawer, "object_joint", PlanSettings())
    world = FineWorld(scene, ARM.q_home, 0.0)
    report = world.play(np.tile(ARM.q_home, (250, 1)))
    assert world.q == pytest.approx(ARM.q_home, abs=1e-4)
    assert report.contact is None
    assert 0.05 < report.torque_share < 0.9


@pytest.mark.parametrize("ds", [1e11, 3e9, np.nan])
def test_a_model_that_becomes_unstable_says_so_and_does_not_begin_anew(drawer, ds):
    scene = build_scene(ARM, drawer, "object_joint", PlanSettings())
    stay = np.tile(ARM.q_home, (50, 1))
    worlds = [FineWorld(scene, ARM.q_home, 0.05) for _ in range(2)]
    worlds[0].data.qvel[scene.s_dof] = ds
    broken, whole = play_side_by_side(worlds, stay, 25, 1)
    assert broken.report.contact == "the fine model became unstable"
    assert not abs(broken.qpos[-1, scene.s_qpos]) < 1.0  # 0 is where the model begins
    assert whole.report.contact is None
    fresh = FineWorld(scene, ARM.q_home, 0.05)
    before = fresh.save()
    fresh.data.qvel[scene.s_dof] = ds
    assert fresh.play(stay).contact == "the fine model became unstable"
    fresh.restore(before)
    assert fresh.play(stay).contact is None


@pytest.mark.parametrize("stage", PlanSettings().cascade[:3])
def test_a_rollout_that_becomes_unstable_does_not_begin_anew(drawer, stage):
    scene = build_scene(ARM, drawer, "object_joint", PlanSettings())
    data = mujoco.MjData(scene.rollout_model(stage))
    data.qpos[scene.s_qpos], data.qvel[scene.s_dof] = 0.05, 1e11
    mujoco.mj_step(scene.rollout_model(stage), data)
    assert not abs(data.qpos[scene.s_qpos]) < 1.0


def test_unexpected_contact_is_reported_with_both_names(drawer):
    scene = build_scene(ARM, drawer, "object_joint", PlanSettings())
    world = FineWorld(scene, np.array([0.0, 1.0, 0.0, 1.2, 0.0, 0.3, 0.0]), 0.0)
    contact = world.check_now().contact
    assert contact is not None
    assert " against " in contact


def test_direction_of_a_slide_is_its_axis_and_of_a_hinge_its_sweep(tmp_path):
    path = tmp_path / "lever.xml"
    path.write_text(faucet_mjcf(x=0.5))
    scene = build_scene(ARM, path, "object_joint", PlanSettings())
    world = FineWorld(scene, ARM.q_home, 0.0)
    # The lever points towards -x and turns about z: its end moves towards -y.
    direction = scene.part_motion(world.data, np.array([0.38, 0.0, 0.195]))
    assert direction == pytest.approx([0.0, -1.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("text", [lid_mjcf(), faucet_mjcf(), drawer_mjcf(DrawerShape())])
def test_sample_objects_fit_the_convention(tmp_path, text):
    path = tmp_path / "object.xml"
    path.write_text(text)
    scene = build_scene(ARM, path, "object_joint", PlanSettings())
    assert scene.fine.body("object/object_part").id == scene.part_body


def test_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(SceneFileError, match=r"nothing\.xml: no such file"):
        build_scene(ARM, tmp_path / "nothing.xml", "object_joint", PlanSettings())


def test_unknown_joint_is_refused_with_the_known_ones(drawer):
    with pytest.raises(SceneFileError, match=r"no joint 'lid'; it has object_joint"):
        build_scene(ARM, drawer, "lid", PlanSettings())


def test_malformed_file_is_refused(tmp_path):
    path = tmp_path / "object.xml"
    path.write_text("<mujoco><worldbody>")
    with pytest.raises(SceneFileError, match=r"object\.xml"):
        build_scene(ARM, path, "object_joint", PlanSettings())
