"""Intervals of the builder and of the gap tool, and the believable objects at and within their ends."""

import json

import mujoco
import mujoco.batch
import numpy as np
import pytest

from s2r_host.planning import PlanRequest, PlanSettings, Stage
from s2r_host.planning.belief import Belief, draw_belief, draw_ensemble, spread_over
from s2r_host.planning.doubt import Doubt, DoubtError, factors
from s2r_host.planning.doubt_files import DoubtFileError, doubt_from_files
from s2r_host.planning.planner import scene_of
from s2r_host.planning.sample_objects import DrawerShape, drawer_mjcf, lid_mjcf
from s2r_host.trajectory.perturb import PERTURBATIONS, perturbed
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")


def _scene(folder, mjcf):
    path = folder / "object.xml"
    path.write_text(mjcf)
    return scene_of(PlanRequest(ARM, path, 0.0, 0.08, ARM.q_home, settings=PlanSettings(threads=1)))


@pytest.fixture(scope="module")
def drawer(tmp_path_factory):
    return _scene(tmp_path_factory.mktemp("drawer"), drawer_mjcf(DrawerShape(front_height=0.12, bottom=0.08)))


@pytest.fixture(scope="module")
def laptop(tmp_path_factory):
    return _scene(tmp_path_factory.mktemp("laptop"), lid_mjcf())


def _part(scene, s):
    """Place and orientation of the part at a joint value."""
    data = mujoco.MjData(scene.fine)
    data.qpos[scene.s_qpos] = s
    mujoco.mj_kinematics(scene.fine, data)
    return data.xpos[scene.part_body].copy(), data.xmat[scene.part_body].reshape(3, 3).copy()


def _model_answer(**changes):
    intervals = {"axis_angle_rad": 0.02, "axis_offset_m": 0.004, "delta": [0.028, 0.034]}
    return json.dumps({"joint_type": "prismatic", "intervals90": intervals} | changes)


def _gap_answer(folder, name="gap.json", **content):
    path = folder / name
    path.write_text(json.dumps({"verdict": "parameter_off", "parameters_off": [], "effects": []} | content))
    return path


def test_a_tilted_slide_leaves_the_part_where_it_was_and_takes_it_elsewhere(drawer):
    other = Belief(tilt_rad=(0.0, 0.0, 0.03)).applied(drawer)
    assert _part(other, 0.0)[0] == pytest.approx(_part(drawer, 0.0)[0], abs=1e-12)
    off = _part(other, 0.2)[0] - _part(drawer, 0.2)[0]
    assert off[2] == pytest.approx(0.2 * np.sin(np.arctan(0.03)), rel=1e-6)


def test_a_moved_pivot_turns_the_part_about_the_other_axis(laptop):
    axis = laptop.axis_at_rest()
    side = np.cross(axis, [0.0, 0.0, 1.0])
    other = Belief(pivot_m=tuple(0.005 * side)).applied(laptop)
    assert _part(other, 0.0)[0] == pytest.approx(_part(laptop, 0.0)[0], abs=1e-12)
    off = _part(other, np.pi)[0] - _part(laptop, np.pi)[0]
    assert np.linalg.norm(off) == pytest.approx(0.010, rel=1e-6)


@pytest.mark.parametrize("kind", ["drawer", "laptop"])
def test_a_part_further_along_stands_where_a_larger_joint_value_has_it(kind, request):
    scene = request.getfixturevalue(kind)
    ahead = _part(Belief(along=0.02).applied(scene), 0.05)
    for one, other in zip(ahead, _part(scene, 0.07), strict=True):
        assert one == pytest.approx(other, abs=1e-9)


@pytest.mark.parametrize("kind", ["drawer", "laptop"])
def test_rollouts_have_the_same_objects_as_replays(kind, request):
    scene = request.getfixturevalue(kind)
    doubt = Doubt(axis_angle_rad=0.03, axis_offset_m=0.005, along=0.004)
    beliefs = draw_ensemble(doubt, 3, np.random.default_rng(1))
    batch = mujoco.batch.Batch(scene.rollout_model(Stage()), nsim=3, nthread=1)
    spread_over(batch, scene, beliefs)
    for index, belief in enumerate(beliefs):
        model = belief.applied(scene).fine
        for field in ("body_pos", "body_quat", "jnt_axis", "jnt_pos"):
            assert batch.expand(field)[index] == pytest.approx(getattr(model, field), abs=1e-12), field


def test_a_drawer_with_a_tilted_axis_does_not_jam_in_the_cabinet_of_its_scene(tmp_path):
    path = tmp_path / "scene.xml"
    shape = DrawerShape(front_height=0.12, bottom=0.08)
    path.write_text(drawer_mjcf(shape).replace("<worldbody>", '<worldbody><site name="arm_base"/>', 1))
    request = PlanRequest(ARM, path, 0.0, 0.08, ARM.q_home, in_scene=True, settings=PlanSettings(threads=1))
    scene = scene_of(request)
    moved = {}
    for name, model in (
        ("as in the file", scene.fine),
        ("tilted", Belief(tilt_rad=(0.0, 0.01, 0.0)).applied(scene).fine),
    ):
        data = mujoco.MjData(model)
        data.qpos[: ARM.dof] = data.ctrl[: ARM.dof] = ARM.q_home
        data.qfrc_applied[scene.s_dof] = 20.0
        mujoco.mj_step(model, data, 250)
        moved[name] = float(data.qpos[scene.s_qpos])
    assert moved["tilted"] == pytest.approx(moved["as in the file"], rel=0.02)
    assert moved["tilted"] > 0.1


def test_nine_of_ten_axes_are_within_the_interval(drawer):
    doubt = Doubt(axis_angle_rad=0.04, along=0.003)
    rng = np.random.default_rng(0)
    drawn = [draw_belief(doubt, rng) for _ in range(2000)]
    axis = drawer.axis_at_rest()
    across = np.array([np.array(b.tilt_rad) - (np.array(b.tilt_rad) @ axis) * axis for b in drawn])
    assert np.mean(np.linalg.norm(across, axis=1) < 0.04) == pytest.approx(0.9, abs=0.03)
    assert np.mean(np.abs([b.along for b in drawn]) < 0.003) == pytest.approx(0.9, abs=0.03)


def test_without_intervals_of_the_joint_the_usual_objects_are_tried():
    assert perturbed(Doubt(), np.array([1.0, 0.0, 0.0])) == PERTURBATIONS
    assert len(PERTURBATIONS) == 7
    assert not any(b.moves_joint for b in PERTURBATIONS)


def test_a_doubtful_joint_is_tried_at_the_ends_of_its_intervals():
    axis = np.array([0.6, 0.0, 0.8])
    more = perturbed(Doubt(axis_angle_rad=0.02, axis_offset_m=0.004, along=0.003), axis)[7:]
    assert len(more) == 4
    for belief in more:
        assert np.linalg.norm(belief.tilt_rad) == pytest.approx(0.02)
        assert np.array(belief.tilt_rad) @ axis == pytest.approx(0.0, abs=1e-12)
        assert abs(belief.along) == 0.003
    assert np.sum([b.tilt_rad for b in more], axis=0) == pytest.approx(np.zeros(3), abs=1e-12)


def test_a_share_of_a_doubt_is_between_it_and_none():
    half = Doubt(damping=(0.25, 4.0), shift_sigma_m=0.002, along=0.01).scaled(0.5)
    assert half.damping == pytest.approx((0.5, 2.0))
    assert half.shift_sigma_m == pytest.approx(0.001)
    assert half.along == pytest.approx(0.005)


def test_the_builders_answer_becomes_intervals(drawer, tmp_path):
    path = tmp_path / "model.json"
    path.write_text(_model_answer())
    doubt = doubt_from_files([path], drawer)
    assert doubt.axis_angle_rad == 0.02
    assert doubt.axis_offset_m == 0.004
    assert doubt.along == pytest.approx(0.003)
    assert doubt.joint_friction[0] < 0.5 < 1.5 < doubt.joint_friction[1]  # a drawer's is guessed widely
    assert doubt.friction == Doubt().friction


def test_a_gap_result_narrows_what_it_found(drawer, tmp_path):
    damping = float(drawer.fine.dof_damping[drawer.s_dof])
    entry = {
        "name": "damping", "joint": "object_joint", "from": 1.0, "to": damping,
        "interval90": [0.9 * damping, 1.2 * damping],
    }  # fmt: skip
    doubt = doubt_from_files([_gap_answer(tmp_path, parameters_off=[entry])], drawer)
    assert doubt.damping == pytest.approx((0.9, 1.2))
    assert doubt.joint_friction == Doubt().joint_friction


def test_friction_that_the_gap_tool_added_counts_from_the_patched_model(drawer, tmp_path):
    friction = float(drawer.fine.dof_frictionloss[drawer.s_dof])
    (tmp_path / "model_patched.xml").write_text(
        f"""<mujoco><worldbody><body><joint name="object_joint" type="slide" frictionloss="{friction}"/>
        <geom size=".1"/></body></worldbody></mujoco>"""
    )
    effect = {
        "name": "coulomb_friction", "joint": "object_joint",
        "parameters": {"level": {"value": 0.5, "interval90": [0.4, 0.7]}},
    }  # fmt: skip
    doubt = doubt_from_files([_gap_answer(tmp_path, effects=[effect])], drawer)
    assert doubt.joint_friction == pytest.approx(((friction - 0.1) / friction, (friction + 0.2) / friction))


def test_a_scene_that_is_not_the_patched_one_is_refused(drawer, tmp_path):
    entry = {
        "name": "damping",
        "joint": "object_joint",
        "from": 1.0,
        "to": 777.0,
        "interval90": [700.0, 800.0],
    }
    with pytest.raises(DoubtFileError, match=r"has damping .* found 777: plan with that"):
        doubt_from_files([_gap_answer(tmp_path, parameters_off=[entry])], drawer)


def test_files_that_say_nothing_usable_are_refused(drawer, tmp_path):
    other = {"name": "damping", "joint": "elbow", "from": 1.0, "to": 2.0, "interval90": [1.0, 3.0]}
    with pytest.raises(DoubtFileError, match="of joint 'object_joint'; it speaks of elbow"):
        doubt_from_files([_gap_answer(tmp_path, parameters_off=[other])], drawer)
    path = tmp_path / "x.json"
    with pytest.raises(DoubtFileError, match="cannot be read: No such file"):
        doubt_from_files([path], drawer)
    for text, said in (
        ("{", "is not JSON"),
        ("[1]", "holds no object but a list"),
        ("{}", "holds no intervals: expected gap.json"),
        (_model_answer(joint_type="revolute"), "about a revolute joint; joint .object_joint. of the scene is a slide"),
        (_model_answer(intervals90={"delta": [0.0, 0.1]}), "entry 'axis_angle_rad' is missing"),
        (_model_answer().replace("0.02", "-0.02"), "axis_angle_rad = -0.02 is not allowed"),
        ('{"verdict": "x", "effects": ["damping"]}', "as intervals: effects is no list of objects"),
        ('{"verdict": "x", "parameters_off": {"damping": 1}}', "parameters_off is no list of objects"),
    ):  # fmt: skip
        path.write_text(text)
        with pytest.raises(DoubtFileError, match=said):
            doubt_from_files([path], drawer)


def test_intervals_that_are_none_are_refused():
    with pytest.raises(DoubtError, match="doubt about damping"):
        Doubt(damping=(2.0, 1.0))
    with pytest.raises(DoubtError, match="along = -1"):
        Doubt(along=-1.0)
    with pytest.raises(DoubtError, match="cannot be told in factors"):
        factors(0.0, 1.0, 2.0)
