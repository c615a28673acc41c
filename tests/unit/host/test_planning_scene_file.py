"""Scenes somebody else wrote: where the arm goes, what stays as it was, and what is refused."""

import json
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

from s2r_host.cli_plan import plan
from s2r_host.plan_process import PlanOrder
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.free_space import FINE_STEP_RAD, FreeSpace
from s2r_host.planning.scene import GeomKind, SceneFileError, build_scene
from s2r_host.planning.scene_file import read_spec
from s2r_host.planning.settings import PlanSettings
from s2r_host.replay.sources import read_source
from s2r_host.trajectory.plan_worker import carried_out
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")

SCENE = """<mujoco model="room"><compiler angle="degree"/><option gravity="0 0 -9.81"/>
<default><geom friction="0.8 0.01 0.001"/></default>
<worldbody>
  <geom name="table" type="box" size=".6 .6 .35" pos="1 .5 .35"/>
  <site name="arm_base" pos="0.6 0.5 0.7" euler="0 0 90"/>
  <body name="link1" pos="0.6 1.12 0.7">
    <geom type="cylinder" size=".02 .09" pos="0 0 .09"/>
    <body name="lever" pos="0 0 .2">
      <joint name="tap" axis="0 0 1" range="-80 80" damping=".2" frictionloss="{friction}"/>
      <geom type="capsule" size=".009 .05" euler="90 0 0" pos="0 -.06 0" mass=".2"/>
    </body>
  </body>
  {more}
</worldbody>
<keyframe><key qpos="0.5"/></keyframe></mujoco>
"""


@pytest.fixture
def scene_file(tmp_path):
    def write(friction=0.2, more="", text=SCENE):
        path = tmp_path / "scene.xml"
        path.write_text(text.format(friction=friction, more=more))
        return path

    return write


def scene_of(path, joint="tap"):
    return build_scene(ARM, path, joint, PlanSettings(), in_scene=True)


def refused(path, joint, target, **changes):
    """Exit code and sentence of ``s2r plan``, without the process that it starts."""
    out = path.parent / "out"
    order = PlanOrder(
        scene=str(path), joint=joint, target=target, target_type=None, arm="xmate3pro", tool=None,
        q0=None, out=str(out), seed=0,
        time_limit_s=600.0, threads=1, ensemble=(),
    )  # fmt: skip
    answer = carried_out(replace(order, **changes), lambda doing, steps: None)
    return answer["exit_code"], answer["refused"], out


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (("4",), "--ensemble 4 is not allowed: an odd number up to 99"),
        (("101",), "--ensemble 101 is not allowed"),
        (("3", "5"), "was given 2 numbers"),
        (("²",), "file with intervals ² cannot be read"),
    ],
)
def test_an_ensemble_that_cannot_be_meant_is_refused(scene_file, values, said):
    exit_code, reason, _ = refused(scene_file(), "tap", 0.5, ensemble=values)
    assert exit_code == 2
    assert said in reason


def test_the_body_that_moves_needs_no_name(scene_file):
    path = scene_file(text=SCENE.replace('<body name="lever"', "<body"))
    scene = scene_of(path)
    names = [scene.fine.geom(g).name for g in np.flatnonzero(scene.geom_kind == GeomKind.PART)]
    assert len(names) == 1
    assert scene.part_body == scene.fine.joint(scene.joint_name).bodyid[0]


def test_the_arm_stands_at_arm_base_and_the_scene_is_seen_from_there(scene_file):
    scene = scene_of(scene_file())
    world = FineWorld(scene, ARM.q_home, 0.0)
    # The column is 0.62 m along the scene's y, and the base is turned by 90 degrees: along the base's x.
    p = world.data.xpos[scene.fine.body("object/link1").id]
    assert p == pytest.approx([0.62, 0.0, 0.0], abs=1e-9)
    assert scene.gravity == pytest.approx([0.0, 0.0, -9.81])


def test_a_tilted_base_tilts_gravity(scene_file):
    text = SCENE.replace('euler="0 0 90"', 'euler="90 0 0"')
    assert scene_of(scene_file(text=text)).gravity == pytest.approx([0.0, -9.81, 0.0], abs=1e-9)


def test_names_shared_with_the_arm_and_keyframes_do_no_harm(scene_file):
    scene = scene_of(scene_file())
    assert scene.fine.body("link1").id != scene.fine.body("object/link1").id
    assert scene.fine.nkey == 0


def test_things_of_the_scene_still_rest_on_each_other(scene_file):
    cup = (
        '<body name="cup" pos="1.3 .5 .76"><freejoint/><geom type="box" size=".03 .03 .05" mass=".2"/></body>'
    )
    text = SCENE.replace('<key qpos="0.5"/>', "")
    scene = scene_of(scene_file(more=cup, text=text))
    world = FineWorld(scene, ARM.q_home, 0.0)
    world.play(np.tile(ARM.q_home, (200, 1)))
    height = world.data.xpos[scene.fine.body("object/cup").id][2]
    assert height == pytest.approx(0.05, abs=0.005)  # on the table top, which is the arm base's plane
    assert world.check_now().contact is None  # and that contact is none of the robot's


@pytest.mark.parametrize("prefix", ["", "robot/"])
def test_an_arm_in_the_scene_is_replaced_where_it_stands(scene_file, tmp_path, prefix):
    spec = mujoco.MjSpec.from_file(str(scene_file()))
    for key in list(spec.keys):
        spec.delete(key)
    spec.body("link1").name = "column"
    spec.delete(spec.site("arm_base"))
    arm = mujoco.MjSpec.from_string(ARM.mjcf)
    for key in list(arm.keys):
        arm.delete(key)
    spec.attach(arm, prefix=prefix, frame=spec.worldbody.add_frame(pos=[0.6, 0.5, 0.7], euler=[0, 0, 90]))
    spec.compile()
    path = tmp_path / "with_arm.xml"
    path.write_text(spec.to_xml())
    scene = scene_of(path)
    assert scene.fine.nq == ARM.dof + 1
    world = FineWorld(scene, ARM.q_home, 0.0)
    assert world.data.xpos[scene.fine.body("object/column").id] == pytest.approx([0.62, 0.0, 0.0], abs=1e-6)
    with pytest.raises(SceneFileError, match=f"joint '{prefix}joint3' belongs to arm 'xmate3pro'"):
        scene_of(path, f"{prefix}joint3")


def test_a_joint_of_the_object_may_be_called_as_one_of_the_arm(scene_file):
    scene = scene_of(scene_file(text=SCENE.replace('name="tap"', 'name="joint3"')), "joint3")
    assert scene.joint_name == "object/joint3"
    assert scene.fine.nq == ARM.dof + 1


def test_visual_geoms_are_not_solid(scene_file):
    ghost = '<geom name="ghost" type="box" size=".3 .3 .3" pos=".6 1 1" contype="0" conaffinity="0"/>'
    scene = scene_of(scene_file(more=ghost))
    assert not scene.solid[scene.fine.geom("object/ghost").id]
    assert scene.solid[scene.geom_kind == GeomKind.PART].all()


def test_a_scene_without_arm_base_is_refused(scene_file):
    with pytest.raises(SceneFileError, match="no body or site 'arm_base'"):
        scene_of(scene_file(text=SCENE.replace("arm_base", "somewhere")))


def test_nan_in_the_scene_is_refused_by_field(scene_file):
    with pytest.raises(SceneFileError, match=r"dof_frictionloss\[0\]"):
        scene_of(scene_file(friction="nan"))


@pytest.mark.parametrize(
    ("joint", "target", "changes", "code", "text"),
    [
        ("tap", 2.0, {}, 4, "beyond its range"),
        ("tap", 0.0, {}, 4, "nothing to move"),
        ("tap", math.nan, {}, 4, "not a finite number"),
        ("lid", 0.5, {}, 2, "no joint 'lid'; it has tap"),
        ("tap", 0.5, {"target_type": "prismatic"}, 2, "joint 'tap' is a hinge, measured in deg or ° or rad"),
        ("tap", 0.5, {"q0": "1,2"}, 2, "--q0 has 2 numbers"),
        ("tap", 0.5, {"arm": "nowhere"}, 2, "no arm 'nowhere'"),
    ],
)
def test_absurd_requests_end_with_one_sentence_and_a_code(scene_file, joint, target, changes, code, text):
    got, sentence, out = refused(scene_file(), joint, target, **changes)
    assert got == code
    assert text in sentence
    if code == 4:
        answer = json.loads((out / "plan.json").read_text())
        assert answer["success"] is False
        assert text in answer["reason"]
        assert not (out / "plan.csv").exists()


def test_an_object_out_of_reach_is_refused_with_both_distances(scene_file):
    text = SCENE.replace("0.6 1.12 0.7", "0.6 3.0 0.7")
    code, stderr, _ = refused(scene_file(text=text), "tap", 0.5)
    assert code == 4
    assert "out of reach" in stderr


def test_a_lid_lighter_in_friction_than_gravity_is_refused(scene_file):
    text = SCENE.replace('axis="0 0 1"', 'axis="1 0 0"')
    code, stderr, _ = refused(scene_file(friction=0.01, text=text), "tap", 0.5)
    assert code == 4
    assert "does not stay" in stderr
    assert "friction holds only 0.01 N·m" in stderr


def test_a_plan_leaves_the_files_it_promises(scene_file):
    path = scene_file()
    out = path.parent / "out"
    result = CliRunner().invoke(
        plan, ["--scene", str(path), "--joint", "tap", "--target", "0.4", "--out", str(out), "--json"]
    )
    assert result.exit_code == 0, result.stderr
    answer = json.loads(result.stdout)
    assert answer["success"]
    assert answer["held"]
    assert abs(answer["error"]) < 0.02
    table = np.genfromtxt(out / "plan.csv", delimiter=",", names=True, deletechars="")
    assert table.dtype.names == ("t", *(f"q.{name}" for name in ARM.joint_names))
    assert np.diff(table["t"]).max() <= 0.002 + 1e-9
    (recorded,) = read_source(out / "plan.mcap", ARM)
    (knots,) = read_source(out / "knots.csv", ARM)
    np.testing.assert_allclose(recorded.trajectory.q, knots.trajectory.q, atol=1e-8)
    np.testing.assert_allclose(recorded.trajectory.t, knots.trajectory.t, atol=1e-8)
    model = mujoco.MjModel.from_xml_path(str(out / "model" / "scene.xml"))
    assert model.joint("object/tap").id >= 0
    for name in ("trace.csv", "knots.csv", "strip.png"):
        assert (out / name).stat().st_size > 1000


ALONE = """<mujoco><compiler angle="radian"/><worldbody><body name="arm_base"/><body pos=".6 0 0">
<geom type="cylinder" size=".02 .12" pos="0 0 .12"/><body name="part" pos="0 0 {height}">{part}</body>
</body></worldbody></mujoco>"""


def test_a_light_part_that_creeps_below_its_friction_is_refused_with_what_to_set(scene_file):
    flap = """<joint name="flap" axis="0 -1 0" range="0 .8" damping=".1" frictionloss=".3"/>
      <geom type="capsule" size=".009" fromto="0 0 .01 -.12 0 .02" mass=".1"/>"""
    path = scene_file(text=ALONE.replace("{part}", flap).replace("{height}", ".25"))
    code, text, _ = refused(path, "flap", 0.5)
    assert code == 4
    assert "creeps below its 0.30 N·m" in text
    assert 'solreffriction="0.004 1"' in text


def test_a_part_inside_its_own_scene_is_refused_with_what_it_overlaps(scene_file):
    cross = """<joint name="valve" axis="0 0 1" damping=".3"/>
      <geom name="wing" type="capsule" size=".01" fromto="-.12 0 0 .12 0 0" mass=".2"/>
      <geom type="capsule" size=".01" fromto="0 -.12 0 0 .12 0" mass=".2"/>"""
    thin = ALONE.replace('size=".02 .12"', 'size=".01 .12"')
    path = scene_file(text=thin.replace("{part}", cross).replace("{height}", ".1"))
    code, text, _ = refused(path, "valve", 0.5)
    assert code == 4
    assert "overlaps by" in text
    assert "wing" in text


@pytest.mark.parametrize(
    ("kind", "target", "text"),
    [
        ("hinge", 360, "57.3 turns away, more than the 4 that are planned; is it meant in degrees?"),
        ("slide", 50, "50 m away, farther than the arm 'xmate3pro' gets"),
    ],
)
def test_ways_that_no_arm_goes_along_with_are_refused_without_a_search(scene_file, kind, target, text):
    lever = SCENE.replace('range="-80 80"', f'type="{kind}"')
    code, sentence, _ = refused(scene_file(text=lever), "tap", target)
    assert code == 4
    assert text in sentence


def test_a_part_of_visual_geoms_alone_is_refused(scene_file):
    text = SCENE.replace('<geom type="capsule"', '<geom type="capsule" contype="0" conaffinity="0"')
    code, sentence, _ = refused(scene_file(text=text), "tap", 0.5)
    assert code == 4
    assert sentence.endswith("the part that joint 'tap' moves has no solid geom to push")


def test_a_joint_that_a_servo_of_the_scene_holds_is_refused_with_that_reason(scene_file):
    cup = '<body name="cup" pos="1.3 .5 .76"><freejoint/><geom type="box" size=".03 .03 .05"/></body>'
    text = SCENE.replace('<key qpos="0.5"/>', "").replace(
        "<keyframe>", '<actuator><position joint="tap" kp="50"/></actuator><keyframe>'
    )
    code, sentence, _ = refused(scene_file(text=text, more=cup), "tap", 0.5)
    assert code == 4
    assert "does not stay at target = 0.5000" in sentence
    assert "the scene's own actuator, told 0, pushes it with 25.00 N·m" in sentence


def test_a_range_in_degrees_that_was_meant_as_radians_is_named(scene_file):
    path = scene_file(text=SCENE.replace('range="-80 80"', 'range="-1.5 1.5"'))
    code, stderr, _ = refused(path, "tap", 1.0)
    assert code == 4
    assert "beyond its range [-0.0262, 0.0262] rad" in stderr
    assert '<compiler angle="radian"/>' in stderr


def test_a_way_that_is_to_be_gone_is_looked_at_finely(scene_file):
    # A bead between two postures of the stretched arm that are free, 20 mm from the middle of the fingertip at either.
    stretched = np.array([0.5, 0.8, 0.0, 0.9, 0.0, 0.9, 0.0])
    world = FineWorld(scene_of(scene_file()), stretched, 0.0)
    X, p_tip = world.scene.X_scene_base, world.data.site_xpos[world.scene.tool_site]
    assert np.linalg.norm(p_tip[:2]) > 0.65
    x, y, z = X[:3, :3] @ p_tip + X[:3, 3]
    space = FreeSpace(
        scene_of(scene_file(more=f'<geom type="sphere" size=".001" pos="{x} {y} {z}"/>')), threads=1
    )
    way = stretched + np.outer([-0.0299, 0.0299], np.eye(ARM.dof)[0])
    assert space.path_is_free(way, 0.0)
    assert not space.path_is_free(way, 0.0, FINE_STEP_RAD)


def test_what_is_no_description_is_told_by_its_name(tmp_path):
    """MuJoCo's own words for it are 'could not find decoder for resource'."""
    notes = tmp_path / "notes.txt"
    notes.write_text("plain words")
    with pytest.raises(SceneFileError, match=r"notes\.txt: .*its name should end in \.xml or \.urdf"):
        read_spec(notes, "lever")
    with pytest.raises(SceneFileError, match=r"it is a folder; name the \.xml or \.urdf in it"):
        read_spec(tmp_path, "lever")
