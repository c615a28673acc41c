"""The arm description: one source, two models that agree."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml

from s2r_protocol.arms import ArmDescription, ArmDescriptionError, load_arm
from s2r_protocol.arms.source import ArmSource

N_POSES = 1000


@pytest.fixture(scope="module")
def arm():
    return load_arm("xmate3pro")


@pytest.fixture(scope="module")
def models(arm):
    mj = mujoco.MjModel.from_xml_string(arm.mjcf)
    return mj, mujoco.MjData(mj), pin.buildModelFromXML(arm.urdf)


@pytest.fixture(scope="module")
def poses(arm):
    rng = np.random.default_rng(20)
    return rng.uniform(arm.limits.q_min, arm.limits.q_max, size=(N_POSES, arm.dof))


def _frames(arm):
    return [link.name for link in arm.source.links], arm.tool_frame


def test_forward_kinematics_agree_to_a_nanometre(arm, models, poses):
    mj, data, pn = models
    pn_data = pn.createData()
    links, tool = _frames(arm)
    worst = 0.0
    for q in poses:
        data.qpos[:] = q
        mujoco.mj_kinematics(mj, data)
        mujoco.mj_comPos(mj, data)
        pin.framesForwardKinematics(pn, pn_data, q)
        for name in links:
            frame = pn_data.oMf[pn.getFrameId(name)]
            worst = max(worst, np.abs(data.body(name).xpos - frame.translation).max())
            worst = max(worst, np.abs(data.body(name).xmat.reshape(3, 3) - frame.rotation).max())
        frame = pn_data.oMf[pn.getFrameId(tool)]
        worst = max(worst, np.abs(data.site(tool).xpos - frame.translation).max())
        worst = max(worst, np.abs(data.site(tool).xmat.reshape(3, 3) - frame.rotation).max())
    assert worst < 1e-9


def test_mass_matrices_agree_to_one_part_in_a_billion(models, poses):
    mj, data, pn = models
    pn_data = pn.createData()
    full = np.zeros((mj.nv, mj.nv))
    for q in poses:
        data.qpos[:] = q
        mujoco.mj_forward(mj, data)
        mujoco.mj_fullM(mj, data, full)
        upper = np.triu(pin.crba(pn, pn_data, q))
        symmetric = upper + np.triu(upper, 1).T
        assert np.abs(full - symmetric).max() < 1e-9 * np.abs(symmetric).max()


def test_gravity_torques_agree_to_one_part_in_a_billion(models, poses):
    mj, data, pn = models
    pn_data = pn.createData()
    for q in poses:
        data.qpos[:] = q
        data.qvel[:] = 0
        mujoco.mj_forward(mj, data)
        gravity = pin.computeGeneralizedGravity(pn, pn_data, q)
        assert np.abs(data.qfrc_bias - gravity).max() < 1e-9 * np.abs(gravity).max()


def test_both_models_carry_the_same_collision_volumes(arm, models):
    """URDF splits a capsule into a cylinder and two spheres; count and radii must match the source."""
    _, _, pn = models
    geometry = pin.buildGeomFromUrdfString(pn, arm.urdf, pin.GeometryType.COLLISION)
    capsules = sum(s.type == "capsule" for s in arm.source.shapes)
    assert geometry.ngeoms == len(arm.source.shapes) + 2 * capsules


def test_home_pose_touches_nothing(arm, models):
    mj, data, _ = models
    data.qpos[:] = arm.q_home
    mujoco.mj_forward(mj, data)
    assert data.ncon == 0


def test_gravity_torque_at_the_published_pose_is_near_the_real_arms(arm, models):
    """A public log of the real arm, without gripper, shows -23 and -13 N m on joints 2 and 4 at this pose."""
    mj, data, _ = models
    data.qpos[:] = [0, 0.157, 0, 0.314, 0, 0.471, 0]
    mujoco.mj_forward(mj, data)
    assert -27 < data.qfrc_bias[1] < -19
    assert -19 < data.qfrc_bias[3] < -10


def test_hashes_tell_models_and_limits_apart(arm, tmp_path):
    raw = yaml.safe_load((arm.directory / "arm.yaml").read_text())

    def variant(name):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "arm.yaml").write_text(yaml.safe_dump(raw))
        return load_arm(folder)

    same = variant("same")
    assert (same.model_hash, same.limit_hash) == (arm.model_hash, arm.limit_hash)
    raw["joints"][2]["dq_max"] = 3.0
    slower = variant("slower")
    assert slower.model_hash == arm.model_hash
    assert slower.limit_hash != arm.limit_hash
    raw["links"][3]["mass"] += 0.001
    heavier = variant("heavier")
    assert heavier.model_hash != arm.model_hash
    assert heavier.limit_hash == slower.limit_hash


def _break(raw, what):
    joints, links = raw["joints"], raw["links"]
    if what == "missing mass":
        del links[4]["mass"]
        return r"links\[4\] \(link4\).mass: is missing"
    if what == "negative limit":
        joints[1]["ddq_max"] = -6.0
        return r"joints\[1\] \(joint2\).ddq_max: Input should be greater than 0, it is -6.0"
    if what == "unknown key":
        joints[0]["speed"] = 1.0
        return r"joints\[0\] \(joint1\).speed: there is no such key"
    if what == "unknown parent":
        raw["tool"]["parent"] = "hand"
        return "tool: unknown link 'hand'; this arm has base, link1"
    if what == "impossible inertia":
        links[2]["inertia"] = [0.001, 0.001, 0.1]
        return "link2.*triangle inequality"
    if what == "empty range":
        joints[3]["q"] = [1.0, 1.0]
        return "joint 'joint4': q_min 1.0 is not below q_max 1.0"
    if what == "home outside":
        raw["q_home"][5] = 9.0
        return "q_home: joint 'joint6' = 9.0 rad is outside"
    if what == "two parents":
        raw["mounts"].append(dict(raw["mounts"][0], parent="link6"))
        return "link 'gripper' has 2 parents"
    if what == "nan":
        joints[0]["tau_max"] = float("nan")
        return r"joints\[0\] \(joint1\).tau_max: Input should be a finite number, it is nan"
    if what == "a link called world":
        links[0]["name"] = raw["base"] = joints[0]["parent"] = "world"
        raw["shapes"] = [s for s in raw["shapes"] if s["link"] != "base"]
        return "no link may be called 'world', which is what the arm stands in; call it base"
    if what == "long axis":
        joints[2]["axis"] = [1.0, 1.0, 0.0]
        return (
            r"joints\[2\] \(joint3\).axis: axis \[1.0, 1.0, 0.0\] has length 1.414, a direction has length 1"
        )
    if what == "unknown axis":
        joints[2]["axis"] = "w"
        return r"joint3\).axis: axis is 'w', expected one of x, y, z, -x, -y, -z or a direction"
    if what == "impossible products":
        links[2]["products"] = [1.0, 0.0, 0.0]
        return "link2.*triangle inequality"
    if what == "rod without length":
        raw["shapes"][1]["b"] = raw["shapes"][1]["a"]
        return "shape 'link1_body': a and b are 0 m apart, at least 0.001 m"
    raise AssertionError(what)


@pytest.mark.parametrize(
    "what",
    [
        "missing mass",
        "negative limit",
        "unknown key",
        "unknown parent",
        "impossible inertia",
        "empty range",
        "home outside",
        "two parents",
        "nan",
        "a link called world",
        "long axis",
        "unknown axis",
        "impossible products",
        "rod without length",
    ],
)
def test_an_incomplete_description_is_refused_by_name(arm, tmp_path, what):
    raw = yaml.safe_load((arm.directory / "arm.yaml").read_text())
    message = _break(raw, what)
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(raw))
    with pytest.raises(ArmDescriptionError, match=message):
        load_arm(tmp_path)


def test_slanted_axes_and_products_of_inertia_are_the_same_in_both_models(arm, poses):
    raw = arm.source.model_dump(mode="json")
    raw["joints"][1]["axis"], raw["joints"][3]["axis"] = [0.6, 0.0, -0.8], "-y"
    raw["links"][2]["products"] = [0.2 * v for v in raw["links"][2]["inertia"]]
    other = ArmDescription(ArmSource.model_validate(raw), arm.directory)
    model, mujoco_model = pin.buildModelFromXML(other.urdf), mujoco.MjModel.from_xml_string(other.mjcf)
    data, mujoco_data = model.createData(), mujoco.MjData(mujoco_model)
    full = np.zeros((model.nv, model.nv))
    for q in poses[:5]:
        mujoco_data.qpos[:] = q
        mujoco.mj_forward(mujoco_model, mujoco_data)
        mujoco.mj_fullM(mujoco_model, mujoco_data, full)
        M = np.triu(pin.crba(model, data, q))
        np.testing.assert_allclose(M + np.triu(M, 1).T, full, rtol=1e-9, atol=1e-12)


def test_an_unknown_arm_lists_the_shipped_ones():
    with pytest.raises(ArmDescriptionError, match=r"no arm 'ur99'.*xmate3pro"):
        load_arm("ur99")


def test_a_folder_without_a_description_is_refused(tmp_path):
    with pytest.raises(ArmDescriptionError, match="no arm description at"):
        load_arm(tmp_path)
