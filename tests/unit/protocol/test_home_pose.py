"""Against MuJoCo, and what `s2r doctor --arm` makes of absurd descriptions."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from s2r_protocol.arms import ArmDescription, load_arm
from s2r_protocol.arms.home_pose import holding_torques, longest_offset, lowest_shape
from s2r_protocol.cli.doctor import check_arm
from s2r_protocol.machine import Level

ARM = load_arm("xmate3pro")


def edited(tmp_path, old: str, new: str):
    text = (ARM.directory / "arm.yaml").read_text()
    assert old in text
    (tmp_path / "arm.yaml").write_text(text.replace(old, new))
    return load_arm(tmp_path)


def problems(arm) -> dict[str, str]:
    return {f.topic: f.text for f in check_arm(arm) if f.level == Level.PROBLEM}


@pytest.mark.parametrize("seed", range(5))
def test_holding_torques_are_mujocos(seed):
    rng = np.random.default_rng(seed)
    q = rng.uniform(ARM.limits.q_min, ARM.limits.q_max)
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(ARM.mjcf))
    data.qpos = q
    mujoco.mj_forward(data.model, data)
    np.testing.assert_allclose(holding_torques(ARM, q), data.qfrc_bias, atol=1e-9)


def test_lowest_shape_follows_the_arm_down():
    up, down = ARM.q_home, np.array([0.0, 2.0, 0.0, 2.05, 0.0, 2.05, 0.0])
    assert lowest_shape(ARM, up)[1] > 0.1
    name, height = lowest_shape(ARM, down)
    assert height < 0.0
    assert name != "base_body"


def test_the_shipped_arm_has_no_problem():
    assert problems(ARM) == {}
    assert longest_offset(ARM.source) == ("joint2", pytest.approx(0.3426))


@pytest.mark.parametrize(
    ("old", "new", "topic", "says"),
    [
        ("inertia: [0.0239, 0.0216, 0.0207]", "inertia: [23900, 21600, 20700]", "inertias", "'link2'"),
        ("origin: [0.0, 0.0, 0.34260]", "origin: [0.0, 0.0, 342.60]", "lengths", "'joint2'"),
        ("tau_max: 108.0", "tau_max: 9.0", "torque", "'joint2' holds"),
        ("q_home: [0.45, -0.3,", "q_home: [0.45, 1.9,", "table", "lowest shape"),
    ],
)
def test_an_absurd_description_is_told_with_its_place(old, new, topic, says, tmp_path):
    found = problems(edited(tmp_path, old, new))
    assert next(iter(found)) == topic
    assert says in found[topic]


def test_a_tool_frame_that_is_not_at_the_fingertip_is_told(tmp_path):
    assert not [f for f in check_arm(ARM) if f.topic == "fingertip"]
    tool = ARM.source.tool
    back = tool.model_copy(update={"origin": (*tool.origin[:2], tool.origin[2] - 0.009)})
    arm = ArmDescription(ARM.source.model_copy(update={"tool": back}), tmp_path)
    told = [f.text for f in check_arm(arm) if f.topic == "fingertip"]
    assert told == [f"the finger's shapes end 9 mm beyond '{ARM.tool_frame}', along its z axis"]


@pytest.mark.parametrize("name", ["my arm", "lab/arm", "**", ""])
def test_a_name_that_is_no_part_of_a_key_is_refused(name, tmp_path):
    with pytest.raises(ValueError, match="name: String should match"):
        edited(tmp_path, "name: xmate3pro", f'name: "{name}"')


def test_links_nearer_than_admission_allows_at_home_are_told(tmp_path):
    close = problems(edited(tmp_path, "  - [link5, link7]", "  - [link1, link7]"))
    assert close == {}  # 29 mm are enough
    thick = edited(tmp_path, "b: [0.0, 0.0, 0.1451], radius: 0.055}", "b: [0.0, 0.0, 0.1451], radius: 0.155}")
    assert "'link5'" in problems(thick)["links"]


def test_an_inertia_far_wider_than_the_shapes_is_a_problem(tmp_path):
    arm = edited(tmp_path, "inertia: [0.0029, 0.0026, 0.0015]", "inertia: [3.0, 3.0, 3.0]")
    assert problems(arm)["inertias"].startswith("'gripper' has the inertia of a body 1.59 m around")
    assert "inertias" not in problems(ARM)


PEDESTAL = """  - {parent: base, child: pedestal, origin: [0.0, 0.0, -0.9], rpy: [0.0, 0.0, 0.0]}
"""


def with_pedestal(tmp_path):
    """The shipped arm on a pedestal that is mounted on its base and reaches 0.9 m below the table."""
    text = (ARM.directory / "arm.yaml").read_text()
    text = text.replace("mounts:\n", f"mounts:\n{PEDESTAL}")
    link = "  - {name: pedestal, mass: 20.0, com: [0.0, 0.0, 0.4], inertia: [1.0, 1.0, 1.0]}\n"
    shape = (
        "  - {link: pedestal, name: pedestal, type: box, center: [0.0, 0.0, 0.4], half: [0.1, 0.1, 0.4]}\n"
    )
    text = text.replace("\njoints:\n", f"{link}\njoints:\n").replace("\nshapes:\n", f"\nshapes:\n{shape}")
    (tmp_path / "arm.yaml").write_text(text)
    return load_arm(tmp_path)


def test_what_is_mounted_on_the_base_stands_and_is_no_hand(tmp_path):
    arm = with_pedestal(tmp_path)
    assert arm.source.standing == {"base", "pedestal"}
    assert arm.source.hand == {"gripper"}
    assert not problems(arm)
    assert lowest_shape(arm, arm.q_home) == lowest_shape(ARM, ARM.q_home)


def test_the_first_link_may_reach_into_the_base_in_mujoco_as_in_admission(tmp_path):
    """Neighbours are not checked; MuJoCo pushed the first link of such an arm out of its base."""
    arm = edited(tmp_path, "b: [0.0, 0.0, 0.13],   radius: 0.085", "b: [0.0, 0.0, 0.26],   radius: 0.085")
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(arm.mjcf))
    data.qpos = arm.q_home
    mujoco.mj_forward(data.model, data)
    assert data.ncon == 0
    assert not problems(arm)
