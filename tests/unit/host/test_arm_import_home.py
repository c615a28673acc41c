"""The home pose of an imported arm: what is asked of it, where it comes from, and what is said about it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from s2r_host.arm_import import Wishes, import_arm, with_home
from s2r_host.arm_import.home_asked import LIMIT_RAD, LINKS_M, TABLE_M, TORQUE_SHARE
from s2r_host.arm_import.home_search import HomeSearch
from s2r_host.cli_import_arm import import_arm as command
from s2r_host.motion.arm_model import ArmModel
from s2r_protocol.arms import ArmDescription, load_arm
from s2r_protocol.arms.home_pose import holding_torques, lowest_shape, nearest_links
from s2r_protocol.cli.doctor import check_arm
from s2r_protocol.machine import Level

HERE = Path(__file__).parent
SHIPPED = "xmate3pro"
SIX = HERE / "six_joint_arm"

# Two joints that turn the hand about the vertical only: it never points down.
FLAT = """
<robot name="flat">
  <link name="foot"><collision><geometry><cylinder radius="0.05" length="0.1"/></geometry></collision></link>
  <joint name="j1" type="revolute"><parent link="foot"/><child link="l1"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="2" effort="50"/></joint>
  <link name="l1"><inertial><origin xyz="0.15 0 0"/><mass value="1"/>
    <inertia ixx="0.002" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0.15 0 0"/><geometry><box size="0.3 0.05 0.05"/></geometry></collision></link>
  <joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0.3 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="2" effort="50"/></joint>
  <link name="l2"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
    <inertia ixx="0.002" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision name="finger"><origin xyz="0.1 0 0"/><geometry><box size="0.2 0.02 0.02"/></geometry></collision></link>
  <joint name="tip" type="fixed"><parent link="l2"/><child link="tcp"/><origin xyz="0.2 0 0" rpy="0 1.5708 0"/></joint>
  <link name="tcp"/>
</robot>
"""


def urdf_of(arm, folder: Path) -> Path:
    path = folder / "arm.urdf"
    path.write_text(load_arm(arm).urdf)
    return path


def srdf(name: str, q, joints) -> str:
    values = "".join(f'<joint name="{j}" value="{v}"/>' for j, v in zip(joints, q, strict=True))
    return f'<robot name="r"><group_state name="{name}" group="arm">{values}</group_state></robot>'


@pytest.fixture(scope="module", params=[SHIPPED, SIX], ids=["seven", "six"])
def searched(request, tmp_path_factory):
    """An arm whose home pose is known to serve, imported without it."""
    urdf = urdf_of(request.param, tmp_path_factory.mktemp("arm"))
    found = import_arm(urdf, Wishes())
    return load_arm(request.param), with_home(found, urdf, Wishes()), found, urdf


def test_a_sought_home_keeps_all_that_is_asked(searched):
    _, found, _, urdf = searched
    arm = ArmDescription(found.source, urdf.parent)
    q, limits = arm.q_home, arm.limits
    assert np.minimum(q - limits.q_min, limits.q_max - q).min() >= LIMIT_RAD
    nearest = nearest_links(arm, q)
    assert nearest is not None
    assert nearest[2] >= LINKS_M
    assert lowest_shape(arm, q)[1] >= TABLE_M
    assert np.all(np.abs(holding_torques(arm, q)) <= TORQUE_SHARE * limits.tau_max)
    X = ArmModel(arm).tool_pose(q)
    assert X[2, 2] < -0.95
    assert 0.2 < X[0, 3] < 0.5
    assert 0.2 < X[2, 3] < 0.5
    assert not {f.topic for f in check_arm(arm) if f.level == Level.PROBLEM} & {"torque", "table", "links"}


def test_a_sought_home_is_as_good_as_one_chosen_by_hand(searched):
    shipped, found, _, _ = searched
    search = HomeSearch(shipped)
    by_hand, sought = search.judge(shipped.q_home), search.judge(np.array(found.source.q_home))
    assert not by_hand.faults
    assert not sought.faults
    assert sought.reached.reached >= by_hand.reached.reached
    assert sought.reached.straight >= by_hand.reached.straight


def test_a_sought_home_is_the_same_every_time_and_told(searched):
    _, found, without, urdf = searched
    again = with_home(without, urdf, Wishes())
    assert again.source.q_home == found.source.q_home
    told = "\n".join(found.told)
    assert "home was looked for: the fingertip " in told
    assert "are reached from there" in told
    assert "change it with --home" in told


def test_an_arm_that_cannot_point_down_gets_the_best_and_is_told_what_fails(tmp_path):
    urdf = tmp_path / "flat.urdf"
    urdf.write_text(FLAT)
    found = with_home(import_arm(urdf, Wishes()), urdf, Wishes())
    assert "no home pose was found that keeps all that is asked; the best: " in "\n".join(found.told)
    assert "home: the hand points 90° off straight down" in found.told
    ArmDescription(found.source, tmp_path)
    limits = ArmDescription(found.source, tmp_path).limits
    assert np.all((limits.q_min <= found.source.q_home) & (found.source.q_home <= limits.q_max))


def test_a_given_home_is_kept_and_told_about(tmp_path):
    urdf, q = urdf_of(SIX, tmp_path), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    wishes = Wishes(home=q)
    found = with_home(import_arm(urdf, wishes), urdf, wishes)
    assert found.source.q_home == q
    told = "\n".join(found.told)
    assert "home is as given: " in told
    assert "home: the hand points 90° off straight down" in told


@pytest.mark.parametrize(("name", "folder"), [("ready", "."), ("Home", "../srdf"), ("home", "config")])
def test_a_fit_pose_of_the_srdf_is_taken(tmp_path, name, folder):
    (tmp_path / "urdf").mkdir()
    urdf, arm = urdf_of(SIX, tmp_path / "urdf"), load_arm(SIX)
    (urdf.parent / folder).mkdir(exist_ok=True)
    (urdf.parent / folder / "six.srdf").write_text(srdf(name, arm.q_home, arm.joint_names))
    found = with_home(import_arm(urdf, Wishes()), urdf, Wishes())
    assert found.source.q_home == tuple(arm.q_home)
    assert f"home is '{name}' of six.srdf: " in "\n".join(found.told)


def test_an_unfit_pose_of_the_srdf_is_told_and_passed_over(tmp_path):
    urdf, arm = urdf_of(SIX, tmp_path), load_arm(SIX)
    (tmp_path / "six.srdf").write_text(srdf("home", np.zeros(6), arm.joint_names))
    found = with_home(import_arm(urdf, Wishes()), urdf, Wishes())
    told = "\n".join(found.told)
    assert "'home' of six.srdf is not taken for home: " in told
    assert "home was looked for" in told


@pytest.mark.parametrize(
    "text", ["<robot", '<robot><group_state name="home"><joint name="pan" value="x"/></group_state></robot>']
)
def test_an_srdf_that_says_nothing_of_use_is_passed_over(tmp_path, text):
    from s2r_host.arm_import.srdf import named_poses

    (tmp_path / "six.srdf").write_text(text)
    assert list(named_poses(urdf_of(SIX, tmp_path), load_arm(SIX).source)) == []


def test_links_that_spoil_most_poses_are_named_and_may_be_excluded(tmp_path):
    wide = load_arm(SIX).urdf.replace(
        'radius="0.045"', 'radius="0.047"'
    )  # 11 mm from wrist_2 wherever it points down
    assert wide != load_arm(SIX).urdf
    urdf = tmp_path / "wide.urdf"
    urdf.write_text(wide)
    found = with_home(import_arm(urdf, Wishes()), urdf, Wishes())
    assert "home: most poses fell out only as 'forearm' and 'wrist_2'" in "\n".join(found.told)
    wishes = Wishes(exclude=(("forearm", "wrist_2"),))
    assert ("forearm", "wrist_2") in import_arm(urdf, wishes).source.collision_exclude


def test_the_command_writes_a_home_that_the_doctor_passes(tmp_path):
    urdf, out = urdf_of(SIX, tmp_path), tmp_path / "out"
    result = CliRunner().invoke(command, [str(urdf), "--out", str(out)], standalone_mode=False)
    assert result.return_value == 0, result.exception
    assert "problem  shapes" in result.output  # of its shoulder, which has none
    assert not re.search("problem +(torque|table|links)", result.output)
    assert "# - home was looked for" in (out / "arm.yaml").read_text()
    assert load_arm(out).q_home.any()
