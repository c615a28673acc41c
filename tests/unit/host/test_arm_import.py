"""From a URDF to an arm.yaml: the same arm, or a sentence that says what an arm.yaml cannot hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh
import yaml
from click.testing import CliRunner

from s2r_host.arm_import import Wishes, import_arm, to_yaml
from s2r_host.cli_import_arm import import_arm as command
from s2r_protocol.arms import ArmDescription, ArmDescriptionError, load_arm
from s2r_protocol.cli.doctor import check_arm

HERE = Path(__file__).parent

# Frames turned as Denavit and Hartenberg do, one axis that counts the other way, a pedestal below, a gripper of two
# fingers on top that is turned by 45 degrees.
TURNED = """
<robot name="my arm">
  <link name="world"/>
  <joint name="stands" type="fixed"><parent link="world"/><child link="foot"/><origin xyz="0 0 0.7"/></joint>
  <link name="foot"><collision><geometry><cylinder radius="0.08" length="0.1"/></geometry></collision></link>
  <joint name="j1" type="continuous"><parent link="foot"/><child link="l1"/><origin xyz="0 0 0.3" rpy="0 0 1.5708"/>
    <axis xyz="0 0 1"/><limit velocity="2" effort="50"/></joint>
  <link name="l1"><inertial><origin xyz="0.01 0.02 0.03" rpy="0.3 0 0"/><mass value="3"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.025" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><sphere radius="0.06"/></geometry></collision></link>
  <joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0 0.05 0" rpy="1.5708 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="1" velocity="2" effort="50"/></joint>
  <link name="l2"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
    <inertia ixx="0.003" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision name="upper"><origin xyz="0.2 0 0" rpy="0 1.5707963 0"/>
    <geometry><mesh filename="package://my_arm/upper.stl" scale="0.001 0.001 0.001"/></geometry></collision></link>
  <joint name="j3" type="revolute"><parent link="l2"/><child link="l3"/><origin xyz="0.4 0 0" rpy="0 0 1.5708"/>
    <axis xyz="0 0 -1"/><limit lower="0.5" upper="2.5" velocity="2" effort="30"/></joint>
  <link name="l3"><inertial><origin xyz="0 0.1 0"/><mass value="1"/>
    <inertia ixx="0.004" iyy="0.001" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0.1 0"/><geometry><box size="0.06 0.2 0.04"/></geometry></collision></link>
  <joint name="flange" type="fixed"><parent link="l3"/><child link="hand"/>
    <origin xyz="0 0.2 0" rpy="-1.5708 0.7854 0"/></joint>
  <link name="hand"><inertial><origin xyz="0 0 0.02"/><mass value="0.5"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.02 0.08 0.04"/></geometry></collision></link>
  <joint name="grip" type="prismatic"><parent link="hand"/><child link="left_finger"/><origin xyz="0 0 0.03"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.04" velocity="1" effort="9"/></joint>
  <link name="left_finger"><collision><origin xyz="0 0 0.03"/><geometry><box size="0.02 0.01 0.06"/></geometry>
    </collision></link>
  <joint name="follows" type="prismatic"><parent link="hand"/><child link="right_finger"/><origin xyz="0 0 0.03"/>
    <axis xyz="0 -1 0"/><limit lower="0" upper="0.04" velocity="1" effort="9"/><mimic joint="grip"/></joint>
  <link name="right_finger"><collision><origin xyz="0 0 0.03"/><geometry><box size="0.02 0.01 0.06"/></geometry>
    </collision></link>
  <joint name="tip" type="fixed"><parent link="hand"/><child link="tcp"/><origin xyz="0 0 0.09"/></joint>
  <link name="tcp"/>
</robot>
"""
FINGERS_CLOSED = Wishes(tip="tcp", held={"grip": 0.005})


@pytest.fixture
def turned(tmp_path):
    """The URDF above in a package, with a mesh that is a bar of 40 x 5 x 5 cm in millimetres, along z."""
    (tmp_path / "my_arm" / "urdf").mkdir(parents=True)
    trimesh.creation.box((50.0, 50.0, 400.0)).export(tmp_path / "my_arm" / "upper.stl")
    path = tmp_path / "my_arm" / "urdf" / "arm.urdf"
    path.write_text(TURNED)
    return path


def _tip_and_torques(urdf: str, frame: str, base: str, q: np.ndarray) -> tuple[pin.SE3, np.ndarray]:
    """Pose of a frame in the base, and gravity's torques with the mass matrix below them."""
    model = pin.buildModelFromXML(urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    X = data.oMf[model.getFrameId(base)].inverse() * data.oMf[model.getFrameId(frame)]
    M = np.triu(pin.crba(model, data, q))
    return X, np.vstack([pin.computeGeneralizedGravity(model, data, q), M + np.triu(M, 1).T])


@pytest.mark.parametrize("arm", ["xmate3pro", HERE / "six_joint_arm"])
def test_the_urdf_of_an_arm_gives_back_its_own_source(arm, tmp_path):
    source = load_arm(arm).source
    (tmp_path / "arm.urdf").write_text(load_arm(arm).urdf)
    found = import_arm(tmp_path / "arm.urdf", Wishes(home=source.q_home)).source
    got, expected = found.model_dump(), source.model_dump()
    for key in ("name", "base", "links", "tool", "q_home"):
        assert got[key] == expected[key], key
    for one, other in zip(got["joints"], expected["joints"], strict=True):
        assert {**one, "ddq_max": 0, "dddq_max": 0} == {**other, "ddq_max": 0, "dddq_max": 0}
    for key in ("mounts", "shapes"):
        for one, other in zip(got[key], expected[key], strict=True):
            for name, value in other.items():
                if isinstance(value, str):
                    assert one[name] == value
                else:
                    np.testing.assert_allclose(one[name], value, atol=1e-6)


def test_a_turned_arm_moves_and_weighs_as_its_urdf_says(turned):
    found = import_arm(turned, FINGERS_CLOSED)
    arm = ArmDescription(found.source, turned.parent)
    fixed = TURNED.replace('type="prismatic"', 'type="fixed"').replace('type="continuous"', 'type="revolute"')
    for q in np.random.default_rng(1).uniform(-1.0, 1.0, (5, 3)):
        there, torques = _tip_and_torques(fixed, "tcp", "foot", q)
        here, own = _tip_and_torques(arm.urdf, arm.tool_frame, "foot", q)
        np.testing.assert_allclose(here.homogeneous, there.homogeneous, atol=1e-4)
        np.testing.assert_allclose(own, torques, atol=1e-3)


def test_joints_keep_the_sense_and_the_angles_that_the_urdf_gives_them(turned):
    found = import_arm(turned, FINGERS_CLOSED)
    (j1, j2, j3) = found.source.joints
    assert (j1.axis, j2.axis, j3.axis) == ("z", "x", "-x")
    assert j1.q == pytest.approx((-2 * np.pi, 2 * np.pi))
    assert j2.q == (-2.0, 1.0)
    assert j3.q == (0.5, 2.5)
    assert found.source.q_home == (0.0, 0.0, 1.5)


def test_an_axis_across_the_frames_is_taken_over(turned):
    turned.write_text(TURNED.replace('<axis xyz="0 0 -1"/>', '<axis xyz="0 3 4"/>'))
    found = import_arm(turned, FINGERS_CLOSED)
    assert found.source.joints[2].axis == pytest.approx((0.8, -0.6, 0.0), abs=1e-4)
    fixed = turned.read_text().replace("prismatic", "fixed").replace("continuous", "revolute")
    arm = ArmDescription(found.source, turned.parent)
    there, torques = _tip_and_torques(fixed, "tcp", "foot", np.array([0.3, -0.4, 0.9]))
    here, own = _tip_and_torques(arm.urdf, arm.tool_frame, "foot", np.array([0.3, -0.4, 0.9]))
    np.testing.assert_allclose(here.homogeneous, there.homogeneous, atol=1e-4)
    np.testing.assert_allclose(own, torques, atol=1e-3)


def test_products_of_inertia_are_taken_over(turned):
    link = import_arm(turned, FINGERS_CLOSED).source.link_named("l1")
    assert np.linalg.eigvalsh(link.tensor) == pytest.approx([0.02, 0.025, 0.03])
    assert np.abs(link.products).max() > 0.001


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<robot", "\n<!-- ours -->\n<robot"),
        ("<robot", '\n<?xml version="1.0" encoding="latin-1"?><!-- f\xfcr uns -->\n<robot'),
        ("</robot>", "<gazebo><sensor:camera><hfov>1</hfov></sensor:camera></gazebo></robot>"),
        ('<robot name="my arm"', '<robot name="my arm" xmlns:xacro="http://www.ros.org/wiki/xacro"'),
        ('<origin xyz="0 0 0.7"/>', '<origin xyz="0 0 0.7"/><axis xyz="0 0 0"/>'),
    ],
)
def test_what_real_urdf_writers_write_is_read(turned, old, new):
    turned.write_bytes(TURNED.replace(old, new, 1).encode("latin-1"))
    assert len(import_arm(turned, FINGERS_CLOSED).source.joints) == 3


def test_a_moving_frame_without_mass_takes_that_of_what_it_carries(turned):
    found = import_arm(turned, FINGERS_CLOSED).source
    frame = """<link name="l3"/>
  <joint name="shell" type="fixed"><parent link="l3"/><child link="l3_shell"/><origin xyz="0 0.1 0"/></joint>
  <link name="l3_shell"><inertial><mass value="1"/>"""
    turned.write_text(
        TURNED.replace('<link name="l3"><inertial><origin xyz="0 0.1 0"/><mass value="1"/>', frame)
    )
    other = import_arm(turned, FINGERS_CLOSED).source
    alone, fused = found.link_named("l3"), other.link_named("l3")
    hand = found.link_named("hand")
    assert fused.mass == alone.mass + hand.mass
    np.testing.assert_allclose(
        fused.com, (np.array(alone.com) * 1.0 + _hand_com(found) * hand.mass) / fused.mass, atol=1e-6
    )
    assert not other.mounts


def _hand_com(source) -> np.ndarray:
    mount = source.mounts[0]
    R = pin.rpy.rpyToMatrix(*mount.rpy)
    return np.array(mount.origin) + R @ np.array(source.link_named("hand").com)


@pytest.mark.parametrize("moment", [0.0, 1e-4])
def test_a_mass_without_a_shape_that_is_fixed_to_a_link_is_a_part_of_it(turned, moment):
    frame = (
        '<link name="tcp"><inertial><mass value="0.5"/>'
        f'<inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/>'
    )
    turned.write_text(TURNED.replace('<link name="tcp"/>', frame + "</inertial></link>"))
    hand = import_arm(turned, FINGERS_CLOSED).source.link_named("hand")
    assert hand.mass == 1.0
    assert hand.com == pytest.approx((0.0, 0.0, 0.055))


def test_a_mass_without_inertia_counts_as_a_point_and_is_told(turned):
    frame = '<link name="tcp"><inertial><origin xyz="0 0 0.01"/><mass value="5"/></inertial></link>'
    turned.write_text(TURNED.replace('<link name="tcp"/>', frame))
    found = import_arm(turned, FINGERS_CLOSED)
    hand = found.source.link_named("hand")
    assert hand.mass == 5.5
    assert hand.com == pytest.approx((0.0, 0.0, (0.5 * 0.02 + 5.0 * 0.1) / 5.5))
    assert "link 'tcp' has a mass of 5 kg and no inertia: it counts as a point" in found.told


def test_moments_of_inertia_that_are_off_by_little_are_raised_and_told(turned):
    turned.write_text(
        TURNED.replace('ixx="0.003" iyy="0.02" izz="0.02"', 'ixx="0.003" iyy="0.02" izz="0.0235"')
    )
    found = import_arm(turned, FINGERS_CLOSED)
    assert sum(sorted(found.source.link_named("l2").inertia)[:2]) >= 0.0235
    assert "link 'l2': no body has principal moments of inertia 0.003, 0.02, 0.0235 kg m²" in "\n".join(
        found.told
    )


def test_an_inertia_far_wider_than_the_shapes_is_made_as_small_and_told(turned):
    turned.write_text(TURNED.replace('ixx="0.001" iyy="0.001" izz="0.001"', 'ixx="1" iyy="1" izz="1"'))
    found = import_arm(turned, FINGERS_CLOSED)
    hand = found.source.link_named("hand")
    assert max(hand.inertia) < 0.5 * 0.2**2
    assert "link 'hand' has the inertia of a body 1.41 m around, its shapes reach 0." in "\n".join(found.told)


def test_what_cannot_move_may_have_any_inertia(turned):
    odd = '<link name="foot"><inertial><mass value="1"/><inertia ixx="1" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
    turned.write_text(TURNED.replace('<link name="foot">', odd + "</inertial>"))
    found = import_arm(turned, FINGERS_CLOSED)
    assert "1 kg stands for it, as it does not move" in "\n".join(found.told)


def test_the_base_is_what_carries_the_tip(turned):
    head = """<link name="head"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
      </inertial></link><joint name="neck" type="fixed"><parent link="world"/><child link="head"/></joint>"""
    turned.write_text(TURNED.replace('<link name="world"/>', '<link name="world"/>' + head))
    assert import_arm(turned, FINGERS_CLOSED).source.base == "foot"


def test_what_is_left_out_is_gone_with_all_that_hangs_off_it(turned):
    found = import_arm(turned, Wishes(tip="hand", left_out=("left_finger", "right_finger")))
    assert not [s for s in found.source.shapes if "finger" in s.name]
    with pytest.raises(ArmDescriptionError, match="--leave-out l3 takes --tip 'tcp' away"):
        import_arm(turned, Wishes(tip="tcp", left_out=("l3",)))
    with pytest.raises(ArmDescriptionError, match="--leave-out: there is no link 'arm'"):
        import_arm(turned, Wishes(tip="tcp", left_out=("arm",)))


@pytest.mark.parametrize("axis", ["x", "y", "-x", "-y", "-z", "z"])
def test_another_axis_of_the_tip_may_point_out_of_the_gripper(turned, axis):
    found = import_arm(turned, Wishes(tip="tcp", tip_axis=axis))
    own, turned_tool = import_arm(turned, FINGERS_CLOSED).source.tool, found.source.tool
    R, R_turned = (pin.rpy.rpyToMatrix(*tool.rpy) for tool in (own, turned_tool))
    sign = -1.0 if axis.startswith("-") else 1.0
    np.testing.assert_allclose(R_turned[:, 2], sign * R[:, "xyz".index(axis[-1])], atol=1e-9)
    assert np.linalg.det(R_turned) == pytest.approx(1.0)
    says = "the z axis of tool_tip does not point the way in which 'tcp' lies from the last joint"
    assert (says in "\n".join(found.told)) == (axis != "z")


def _follower(name: str, leader: str, factor: float) -> str:
    """One more finger that slides as another one does."""
    return f"""<joint name="{name}" type="prismatic"><parent link="hand"/><child link="{name}_finger"/>
      <axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="9"/>
      <mimic joint="{leader}" multiplier="{factor}" offset="0.001"/></joint>
      <link name="{name}_finger"><collision><geometry><sphere radius="0.005"/></geometry></collision></link>"""


@pytest.mark.parametrize(
    ("range_m", "wishes", "held"),
    [
        (
            'lower="0.01" upper="0.04"',
            Wishes(tip="tcp"),
            "grip 0.01, follows 0.01, third 0.021, fourth -0.02",
        ),
        ('lower="0" upper="0.04"', FINGERS_CLOSED, "grip 0.005, follows 0.005, third 0.011, fourth -0.01"),
        ('lower="0" upper="0.04"', Wishes(tip="tcp"), "grip 0, follows 0, third 0.001, fourth 0"),
    ],
)
def test_a_follower_stands_where_its_leader_has_it(turned, range_m, wishes, held):
    more = _follower("third", "follows", 2.0) + _follower("fourth", "third", -1.0)
    text = TURNED.replace("</robot>", more + "</robot>").replace('lower="0" upper="0.04"', range_m, 1)
    turned.write_text(text)
    told = import_arm(turned, wishes).told
    for one in held.split(", "):
        name, value = one.split()
        assert f"joint '{name}' is held at {value} m" in told


def test_followers_in_a_circle_are_refused(turned):
    more = _follower("third", "fourth", 1.0) + _follower("fourth", "third", 1.0)
    turned.write_text(TURNED.replace("</robot>", more + "</robot>"))
    with pytest.raises(
        ArmDescriptionError, match="joint 'third' follows itself by way of <mimic>: third, fourth"
    ):
        import_arm(turned, FINGERS_CLOSED)


def test_a_joint_held_beyond_its_limits_is_told(turned):
    told = import_arm(turned, Wishes(tip="tcp", held={"grip": 0.0, "j3": 40.0})).told
    assert "joint 'j3' is held at 40 rad, beyond its limits [0.5, 2.5] rad, degrees?" in told
    assert "joint 'grip' is held at 0 m" in told


def test_an_arm_that_hangs_from_the_ceiling_hangs(turned):
    turned.write_text(TURNED.replace('xyz="0 0 0.7"', 'xyz="0 0 0.7" rpy="3.14159265 0 0"'))
    found = import_arm(turned, FINGERS_CLOSED)
    assert found.source.base == found.source.joints[0].parent == "base"
    assert "link 'world' is called 'base' here" in found.told
    assert found.source.joints[0].axis == "-z"
    assert mujoco.MjModel.from_xml_string(ArmDescription(found.source, turned.parent).mjcf).njnt == 3
    own = import_arm(turned, Wishes(base="foot", tip="tcp"))
    assert "base 'foot' is tilted by 180° in the URDF" in "\n".join(own.told)


def test_a_base_that_had_to_get_another_name_has_it_everywhere(turned):
    ceiling = TURNED.replace('xyz="0 0 0.7"', 'xyz="0 0 0.7" rpy="3.14159265 0 0"')
    solid = '<link name="world"><collision><geometry><sphere radius="2"/></geometry></collision></link>'
    turned.write_text(ceiling.replace('<link name="world"/>', solid))
    found = import_arm(turned, replace(FINGERS_CLOSED, exclude=(("world", "l2"),)))
    excluded = found.source.collision_exclude
    assert excluded[0] == ("base", "l2")
    assert ("base", "l3") in [tuple(sorted(pair)) for pair in excluded]
    assert "links 'base' and 'l3' touch in every pose and are not checked" in found.told


def test_the_narrower_of_soft_and_hard_limits_are_kept(turned):
    soft = 'effort="30"/><safety_controller soft_lower_limit="0.6" soft_upper_limit="9" k_velocity="1"/>'
    turned.write_text(TURNED.replace('effort="30"/>', soft))
    found = import_arm(turned, FINGERS_CLOSED)
    assert found.source.joints[2].q == (0.6, 2.5)
    assert "joint 'j3' keeps the soft limits of its <safety_controller>, [0.6, 2.5] rad" in "\n".join(
        found.told
    )


def test_a_joint_may_have_the_name_of_a_link(turned, tmp_path):
    turned.write_text(TURNED.replace('"j3"', '"l3"'))
    arm = ArmDescription(import_arm(turned, FINGERS_CLOSED).source, tmp_path)
    assert all(finding.text for finding in check_arm(arm))


def test_what_was_decided_is_told(turned):
    told = "\n".join(import_arm(turned, FINGERS_CLOSED).told)
    for sentence in (
        "joint 'grip' is held at 0.005 m",
        "joint 'follows' is held at 0.005 m",
        "links that do not hang off 'foot' are left out",
        "link 'foot' has no mass; 1 kg stands for it",
        "'j1' turns without end",
        "1 meshes became",
        "tool_tip is the frame of 'tcp'",
    ):
        assert sentence in told


def test_shapes_enclose_and_fingers_may_touch(turned):
    shapes = {s.name: s for s in import_arm(turned, FINGERS_CLOSED).source.shapes}
    assert {n for n in shapes if n.startswith("finger")} == {"finger_left_finger_0", "finger_right_finger_0"}
    left = shapes["finger_left_finger_0"]
    assert (left.link, left.half) == ("hand", (0.01, 0.005, 0.03))
    np.testing.assert_allclose(left.center, (0.0, 0.005, 0.06), atol=1e-9)
    assert sorted(shapes["upper"].half) == pytest.approx([0.025, 0.025, 0.2], abs=1e-5)


def test_a_bent_mesh_is_cut_into_shapes_that_hold_it_closely(turned):
    along, across = trimesh.creation.box((50.0, 50.0, 400.0)), trimesh.creation.box((300.0, 50.0, 50.0))
    across.apply_translation((125.0, 0.0, 175.0))
    bent = trimesh.util.concatenate([along, across])
    bent.export(turned.parents[1] / "upper.stl")
    shapes = [s for s in import_arm(turned, FINGERS_CLOSED).source.shapes if s.name.startswith("upper")]
    assert [s.name for s in shapes] == ["uppera", "upperb", "upperc"]
    assert sum(8.0 * np.prod(s.half) for s in shapes) < 1.2e-9 * bent.volume  # one box: 4.2 times as much


def test_a_collada_mesh_is_read_in_the_unit_it_says(turned):
    metres = trimesh.creation.box((5.0, 5.0, 40.0)).export(file_type="dae")
    centimetres = metres.replace(b"<asset>", b'<asset><unit name="centimeter" meter="0.01"/>')
    (turned.parents[1] / "upper.dae").write_bytes(centimetres)
    turned.write_text(TURNED.replace('upper.stl" scale="0.001 0.001 0.001"', 'upper.dae"'))
    shapes = {s.name: s for s in import_arm(turned, FINGERS_CLOSED).source.shapes}
    assert sorted(shapes["upper"].half) == pytest.approx([0.025, 0.025, 0.2], abs=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_the_smallest_shape_holds_every_point(seed):
    from s2r_host.arm_import.enclosing import enclose

    rng = np.random.default_rng(seed)
    points = rng.normal(size=(200, 3)) * rng.uniform(0.01, 0.2, 3)
    points /= np.maximum(1.0, np.linalg.norm(points / points.std(axis=0), axis=1, keepdims=True) / 2.0)
    shape = enclose(points)
    if shape["type"] == "box":
        away = np.abs(points - shape["center"]) - shape["half"]
    else:
        a, b = np.array(shape["a"]), np.array(shape["b"])
        along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        away = np.linalg.norm(points - a - along[:, None] * (b - a), axis=1) - shape["radius"]
    assert away.max() <= 1e-9


def test_the_text_reads_back_to_the_same_arm(turned, tmp_path):
    found = import_arm(turned, FINGERS_CLOSED)
    (tmp_path / "arm.yaml").write_text(to_yaml(found.source, "arm.urdf", found.told))
    assert load_arm(tmp_path).source == found.source


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("<robot", "<model", "is no readable URDF|begins with <model>"),
        (
            'name="my arm"',
            'name="x" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:if value="1"/><link name="y"/',
            "holds xacro",
        ),
        ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 0"/>', "joint 'j3': axis 0 0 0 has no direction"),
        ('velocity="2" effort="30"', 'velocity="0"', "joint 'j3' has no velocity, effort above 0"),
        ('name="j3" type="revolute"', 'name="j3" type="prismatic"', "'j3' is prismatic.*--hold j3=0"),
        ('<mass value="2"/>', "", "link 'l2' has no mass; it moves: say it in its <inertial>"),
        ('ixx="0.003" iyy="0.02"', 'ixx="0.5" iyy="0.02"', "link 'l2'.*triangle"),
        (
            'effort="30"/>',
            'effort="30"/><mimic joint="j2"/>',
            "'j3' on the way to the tip follows 'j2', which moves",
        ),
        ("package://my_arm/upper.stl", "", "link 'l2': a <mesh> names no file"),
        ("<robot", "<sdf", "is no readable URDF|begins with <sdf>"),
        ("upper.stl", "lower.stl", "mesh package://my_arm/lower.stl is not there; give --packages"),
        ('child link="tcp"', 'child link="tool"', "joint 'tip' names a link 'tool', which is not there"),
        ('upper="2.5"', 'upper="far"', "joint 'j3': upper 'far' of its <limit> is no finite number"),
        ('box size="0.06 0.2 0.04"', 'box size="0.06 0.2"', "link 'l3': size '0.06 0.2' must be three"),
    ],
)
def test_what_cannot_be_said_is_refused_by_name(turned, old, new, says):
    assert old in TURNED
    turned.write_text(TURNED.replace(old, new))
    with pytest.raises(ArmDescriptionError, match=f"(?s){says}"):
        import_arm(turned, FINGERS_CLOSED)


@pytest.mark.parametrize(
    ("wishes", "says"),
    [
        (Wishes(), "--tip"),
        (Wishes(tip="hnd"), "--tip: there is no link 'hnd'; there are world, foot"),
        (Wishes(tip="tcp", held={"g": 0.0}), "--hold: there is no joint 'g'"),
        (Wishes(tip="l1", base="l2"), "--tip l1 does not hang off the base 'l2'"),
        (Wishes(tip="tcp", home=(0.0,)), "--home has 1 values; this arm has 3 joints: j1, j2, j3"),
        (Wishes(tip="tcp", home=(0.0, 3.0, -1.0)), "joint 'j2' = 3.0 rad is outside"),
    ],
)
def test_wishes_that_cannot_be_met_are_refused_by_name(turned, wishes, says):
    with pytest.raises(ArmDescriptionError, match=says):
        import_arm(turned, wishes)


def test_the_command_writes_an_arm_that_the_doctor_reads(turned, tmp_path):
    out = tmp_path / "out"
    arguments = [str(turned), "--tip", "tcp", "--hold", "grip=0.005", "--out", str(out)]
    result = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert result.return_value == 0, result.exception
    assert "model hash" in result.output
    assert f"wrote {out / 'arm.yaml'}" in result.output
    assert yaml.safe_load((out / "arm.yaml").read_text())["name"] == "my_arm"


def test_a_refused_urdf_leaves_nothing_behind(turned, tmp_path):
    out = tmp_path / "out"
    result = CliRunner().invoke(command, [str(turned), "--out", str(out)], standalone_mode=False)
    assert isinstance(result.exception, ArmDescriptionError)
    assert not out.exists()
