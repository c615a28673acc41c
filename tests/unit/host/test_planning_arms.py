"""Other arms, tools in the gripper, several movable parts."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from s2r_host.planning import OutOfReachError, PlanRefusedError, PlanRequest, PlanSettings
from s2r_host.planning.sample_objects import DrawerShape, drawer_mjcf, faucet_mjcf
from s2r_host.planning.tools import TOOLS, tool_named, write_arm_with_tool
from s2r_host.trajectory import plan_trajectory
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import UsageError

ARM = load_arm("xmate3pro")
SETTINGS = PlanSettings(threads=1)

TWO_DRAWERS = """<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 0.1"/>
    <site name="arm_base" pos="0 0 0"/>
    <body name="chest" pos="0.58 0 0">
      <geom name="back" type="box" pos="0.29 0 0.15" size="0.01 0.15 0.15"/>
      {drawers}
    </body>
  </worldbody>
</mujoco>
"""
DRAWER = """<body name="{name}" pos="0 0 {z}">
        <joint name="{name}_slide" type="slide" axis="-1 0 0" range="0 0.25" damping="15" frictionloss="4"/>
        <geom name="{name}_front" type="box" pos="-0.006 0 0" size="0.006 0.14 0.05" mass="0.6"/>
        <geom name="{name}_floor" type="box" pos="0.12 0 -0.04" size="0.12 0.13 0.004" mass="0.6"/>
        <geom name="{name}_bar" type="box" pos="-0.055 0 0.015" size="0.006 0.06 0.006" mass="0.05"/>
        <geom name="{name}_post_l" type="box" pos="-0.03 0.054 0.015" size="0.02 0.005 0.005" mass="0.01"/>
        <geom name="{name}_post_r" type="box" pos="-0.03 -0.054 0.015" size="0.02 0.005 0.005" mass="0.01"/>
      </body>"""


def drawer_at(folder: Path, x: float) -> Path:
    path = folder / "object.xml"
    path.write_text(drawer_mjcf(DrawerShape(x=x, front_height=0.12, bottom=0.08)))
    return path


def request(arm, path, s_target=0.08, **more) -> PlanRequest:
    return PlanRequest(
        arm, path, s_initial=0.0, s_target=s_target, q_initial=arm.q_home, settings=SETTINGS, **more
    )


def test_a_drawer_out_of_reach_of_the_bare_gripper_is_refused(tmp_path):
    with pytest.raises(OutOfReachError, match="out of reach"):
        plan_trajectory(request(ARM, drawer_at(tmp_path, 1.2)))


@pytest.mark.parametrize("tool", sorted(TOOLS))
def test_a_drawer_out_of_reach_is_opened_with_a_tool(tmp_path, tool):
    arm = write_arm_with_tool(ARM, tool_named(tool), tmp_path / "arm")
    result, delivery = plan_trajectory(request(arm, drawer_at(tmp_path, 1.2)), accept_fragile=True)
    assert result.success
    assert abs(delivery.replay.error) < 0.002
    assert delivery.replay.contact is None


def test_a_tool_makes_another_arm_with_the_fingers_no_longer_meant_to_touch(tmp_path):
    arm = write_arm_with_tool(ARM, tool_named("t_shape"), tmp_path)
    assert arm.model_hash != ARM.model_hash
    assert arm.limit_hash == ARM.limit_hash
    assert [s.name for s in arm.source.shapes if s.name.startswith("finger")] == [
        "finger_t_shape_0",
        "finger_t_shape_1",
    ]
    assert load_arm(tmp_path).model_hash == arm.model_hash
    tips = []
    for description in (ARM, arm):
        model = mujoco.MjModel.from_xml_string(description.mjcf)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        tips.append(data.site(description.tool_frame).xpos.copy())
    assert tips[1] - tips[0] == pytest.approx([0.0, 0.0, 0.18], abs=1e-9)


def test_an_unknown_tool_is_refused_with_those_there_are():
    with pytest.raises(UsageError, match="unknown tool 'spoon'; there are t_shape, semi_ring"):
        tool_named("spoon")


@pytest.mark.parametrize(("kind", "target"), [("drawer", 0.10), ("faucet", 0.5)])
def test_an_arm_with_six_joints_plans_from_its_description_alone(tmp_path, kind, target):
    arm = load_arm(Path(__file__).parent / "six_joint_arm")
    path = drawer_at(tmp_path, 0.55)
    if kind == "faucet":
        path.write_text(faucet_mjcf())
    result, delivery = plan_trajectory(request(arm, path, target), accept_fragile=True)
    assert result.q_cmd.shape[1] == 6
    assert abs(delivery.replay.error) < (0.002 if kind == "drawer" else 0.01)
    assert delivery.replay.contact is None


@pytest.mark.parametrize("name", ["low", "high"])
def test_one_of_two_drawers_is_opened_and_the_other_stays(tmp_path, name):
    path = tmp_path / "chest.xml"
    drawers = "".join(DRAWER.format(name=n, z=z) for n, z in (("low", 0.10), ("high", 0.21)))
    path.write_text(TWO_DRAWERS.format(drawers=drawers))
    asked = request(ARM, path, joint=f"{name}_slide", in_scene=True)
    result, delivery = plan_trajectory(asked, accept_fragile=True)
    assert result.success
    assert abs(delivery.replay.error) < 0.002
    assert delivery.replay.contact is None  # the other drawer is not the part: touching it would be one


def test_a_lid_that_is_lighter_in_friction_than_gravity_is_refused_with_both_numbers(tmp_path):
    path = tmp_path / "lid.xml"
    path.write_text(
        """<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
        <body name="object_base" pos="0.5 0 0"><geom type="box" pos="0 0 0.009" size="0.11 0.15 0.009"/>
        <body name="object_part" pos="0.11 0 0.022" euler="0 1.0 0">
        <joint name="object_joint" type="hinge" axis="0 1 0" range="-1 1.2" damping="0.3" frictionloss="0.05"/>
        <inertial pos="-0.1 0 0" mass="0.5" diaginertia="0.004 0.002 0.006"/>
        <geom type="box" pos="-0.108 0 0.004" size="0.108 0.15 0.004"/></body></body></worldbody></mujoco>"""
    )
    with pytest.raises(
        PlanRefusedError, match=r"does not stay at start = 0.0000: untouched it moves by"
    ) as caught:
        plan_trajectory(request(ARM, path, 0.5))
    assert "friction holds only 0.05 N·m" in str(caught.value)


def test_the_six_joint_arm_has_a_home_above_the_table():
    arm = load_arm(Path(__file__).parent / "six_joint_arm")
    model = mujoco.MjModel.from_xml_string(arm.mjcf)
    data = mujoco.MjData(model)
    data.qpos[:] = arm.q_home
    mujoco.mj_forward(model, data)
    assert data.site(arm.tool_frame).xpos[2] > 0.1
    assert np.isfinite(data.qpos).all()
