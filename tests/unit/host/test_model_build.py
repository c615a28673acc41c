"""The built drawer: it loads everywhere, its joint agrees, and a finger fits behind its handle."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

from s2r_host.model import ModelError, build_model
from s2r_host.model.belief import prior
from s2r_host.model.pieces import box, hull
from s2r_host.model.write import write_mjcf, write_urdf
from s2r_host.perception import DepthFrame, JointMotion, estimate_joint
from s2r_host.perception import synthetic as scenes
from s2r_sim.objects.pairs import draw_pair
from s2r_sim.objects.splits import Split


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Drawer 4 of the made-up ones: opening 69 mm, handle gap 42 mm, bar 10 mm, width 393 mm, front 124 mm."""
    pair = scenes.drawer_pair(np.random.default_rng(4))
    estimate = estimate_joint(pair.before, pair.after)
    folder = tmp_path_factory.mktemp("drawer")
    return pair, estimate, build_model(estimate, folder, outward=True)


@pytest.fixture(scope="module")
def laptop(tmp_path_factory):
    pair = scenes.laptop_pair(np.random.default_rng(8))
    return build_model(estimate_joint(pair.before, pair.after), tmp_path_factory.mktemp("laptop"))


@pytest.fixture(scope="module")
def faucet(tmp_path_factory):
    pair = draw_pair("faucet", Split.VALIDATION, 1000)
    before, after = (DepthFrame(d, pair.K, pair.X_base_camera) for d in (pair.depth_before, pair.depth_after))
    return build_model(estimate_joint(before, after), tmp_path_factory.mktemp("faucet"))


@pytest.fixture(params=["drawer", "laptop", "faucet"])
def model(request):
    """The built model of each kind."""
    return (
        request.getfixturevalue("built")[2]
        if request.param == "drawer"
        else request.getfixturevalue(request.param)
    )


@pytest.fixture(scope="module")
def compiled(built):
    return mujoco.MjModel.from_xml_path(str(built[2].mjcf_path))


def test_bodies_joint_and_geoms_have_the_agreed_names(compiled):
    names = {compiled.body(i).name for i in range(compiled.nbody)}
    assert {"object_base", "object_part"} <= names
    assert compiled.joint("object_joint").type == mujoco.mjtJoint.mjJNT_SLIDE
    geoms = [compiled.geom(i).name for i in range(compiled.ngeom)]
    assert all(name.startswith(("base_", "part_")) for name in geoms)
    assert {"part_front", "part_handle_bar", "base_cabinet"} <= set(geoms)


def test_the_joint_grows_out_of_the_cabinet(built, compiled):
    pair, _, model = built
    assert compiled.jnt_axis[0] @ pair.motion.direction < -0.99  # the push went in
    assert model.s_after == pytest.approx(-pair.motion.delta, abs=0.001)
    assert model.range[0] < model.s_after < 0 < model.range[1]


def test_measures_agree_with_the_object(built):
    drawer = built[2].drawer
    size = drawer.front_high - drawer.front_low
    assert size[1] == pytest.approx(0.393, abs=0.012)
    assert size[2] == pytest.approx(0.124, abs=0.010)
    assert drawer.closing_m == pytest.approx(0.069, abs=0.015)
    assert drawer.handle.gap_m == pytest.approx(0.042, abs=0.006)
    assert drawer.handle.bar_high[0] - drawer.handle.bar_low[0] == pytest.approx(0.010, abs=0.006)


def test_the_gap_behind_the_handle_is_free(built, compiled):
    """A ray straight down behind the bar, between the posts, meets nothing of the drawer."""
    handle, X = built[2].drawer.handle, built[2].drawer.X_base_D
    data = mujoco.MjData(compiled)
    mujoco.mj_forward(compiled, data)
    middle = 0.5 * (handle.posts[0][1] + handle.posts[-1][0])
    top = X[:3, :3] @ [0.5 * handle.gap_m, middle, 0.2] + X[:3, 3]
    geom = np.array([-1], dtype=np.int32)
    mujoco.mj_ray(compiled, data, top, -X[:3, 2], None, 1, -1, geom, None)
    assert geom[0] == -1
    height = 0.5 * (handle.bar_low[2] + handle.bar_high[2])
    behind = X[:3, :3] @ [0.5 * handle.gap_m, middle, height] + X[:3, 3]
    mujoco.mj_ray(compiled, data, behind, X[:3, 0], None, 1, -1, geom, None)
    assert compiled.geom(int(geom[0])).name == "part_handle_bar"


def test_mujoco_and_pinocchio_agree_on_mass_and_motion(built, compiled):
    model = pin.buildModelFromUrdf(str(built[2].urdf_path))
    data = model.createData()
    mj = mujoco.MjData(compiled)
    s = 0.07
    mj.qpos[0] = s
    mujoco.mj_forward(compiled, mj)
    pin.forwardKinematics(model, data, np.array([s]))
    frame = model.getFrameId("object_part")
    pin.updateFramePlacements(model, data)
    expected = mj.xpos[compiled.body("object_part").id]
    np.testing.assert_allclose(data.oMf[frame].translation, expected, atol=1e-6)
    np.testing.assert_allclose(model.inertias[1].mass, compiled.body("object_part").mass[0], rtol=1e-5)
    com = data.oMi[1].act(model.inertias[1].lever)
    np.testing.assert_allclose(com, mj.xipos[compiled.body("object_part").id], atol=1e-5)


def test_pinocchio_loads_both_files_with_their_shapes(model):
    count = len(model.pieces)
    urdf = pin.buildModelFromUrdf(str(model.urdf_path))
    shapes = pin.buildGeomFromUrdf(
        urdf, str(model.urdf_path), pin.GeometryType.COLLISION, [str(model.urdf_path.parent)]
    )
    mjcf = pin.buildModelFromMJCF(str(model.mjcf_path))
    same = pin.buildGeomFromMJCF(mjcf, str(model.mjcf_path), pin.GeometryType.COLLISION)
    assert shapes.ngeoms == same.ngeoms == count
    for read in (urdf, mjcf):
        assert (read.nq, read.names[1]) == (1, "object_joint")
        assert read.lowerPositionLimit[0] == pytest.approx(model.range[0], abs=1e-5)
        assert read.upperPositionLimit[0] == pytest.approx(model.range[1], abs=1e-5)
    # Pinocchio weighs no hull of an MJCF: docs/perception.md sends its users to the URDF for masses.
    assert urdf.inertias[1].mass == pytest.approx(model.mass_kg, rel=1e-4)
    q = np.array([model.s_after])
    corners = [_farthest(read, geometry, q) for read, geometry in ((urdf, shapes), (mjcf, same))]
    np.testing.assert_allclose(corners[0], corners[1], atol=1e-4)


def _farthest(read, geometry, q) -> np.ndarray:
    """Corners of the box around all shapes at a joint value, (2, 3)."""
    data, placed = read.createData(), geometry.createData()
    pin.updateGeometryPlacements(read, data, geometry, placed, q)
    ends = []
    for shape, X in zip(geometry.geometryObjects, placed.oMg, strict=True):
        shape.geometry.computeLocalAABB()
        low, high = shape.geometry.aabb_local.min_, shape.geometry.aabb_local.max_
        signs = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        ends.append((low + signs * (high - low)) @ X.rotation.T + X.translation)
    cloud = np.concatenate(ends)
    return np.stack([cloud.min(axis=0), cloud.max(axis=0)])


def test_mujoco_loads_both_files(model):
    mjcf = mujoco.MjModel.from_xml_path(str(model.mjcf_path))
    urdf = mujoco.MjModel.from_xml_path(str(model.urdf_path))
    for read in (mjcf, urdf):
        assert read.joint("object_joint").range == pytest.approx(model.range, abs=1e-5)
        assert read.body("object_part").mass[0] == pytest.approx(model.mass_kg, rel=1e-4)
        assert read.ngeom == len(model.pieces)
    np.testing.assert_allclose(
        mjcf.body("object_part").inertia, urdf.body("object_part").inertia, rtol=1e-3, atol=1e-9
    )


def test_yourdfpy_loads_the_urdf_with_its_meshes(model):
    robot = yourdfpy.URDF.load(
        str(model.urdf_path), build_collision_scene_graph=True, load_collision_meshes=True
    )
    assert robot.actuated_joint_names == ["object_joint"]
    assert len(robot.scene.geometry) == len(model.pieces)
    np.testing.assert_allclose(robot.collision_scene.bounds, robot.scene.bounds, atol=1e-5)
    limit = robot.joint_map["object_joint"].limit
    assert (limit.lower, limit.upper) == pytest.approx(model.range, abs=1e-5)


def test_joint_limits_are_the_same_in_both_files(built, compiled):
    model = pin.buildModelFromUrdf(str(built[2].urdf_path))
    low, high = compiled.jnt_range[0]
    assert model.lowerPositionLimit[0] == pytest.approx(low, abs=1e-5)
    assert model.upperPositionLimit[0] == pytest.approx(high, abs=1e-5)


def test_the_simulated_drawer_stays_put_and_can_be_pulled(compiled):
    data = mujoco.MjData(compiled)
    for _ in range(500):
        mujoco.mj_step(compiled, data)
    assert abs(data.qpos[0]) < 1e-3
    for _ in range(1000):
        data.qfrc_applied[0] = 15.0
        mujoco.mj_step(compiled, data)
    assert data.qpos[0] > 0.05


def test_a_laptop_becomes_two_plates(laptop):
    compiled = mujoco.MjModel.from_xml_path(str(laptop.mjcf_path))
    assert compiled.joint("object_joint").type == mujoco.mjtJoint.mjJNT_HINGE
    assert {piece.body for piece in laptop.pieces} == {"base", "part"}


def test_a_hinge_written_to_both_files_moves_points_alike(tmp_path):
    motion = JointMotion("revolute", np.array([0.5, 0.1, 0.2]), np.array([0.0, 0.6, 0.8]), 0.3)
    corners = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3)) + np.array([0.6, 0.1, 0.25])
    pieces = [hull("lid", "part", corners), box("body", "base", np.eye(4), [0.4, 0, 0], [0.6, 0.2, 0.2])]
    write_mjcf(tmp_path / "o.xml", pieces, motion, (-1, 1), prior("revolute"))
    write_urdf(tmp_path / "o.urdf", pieces, motion, (-1, 1), prior("revolute"), tmp_path / "o.xml")
    compiled = mujoco.MjModel.from_xml_path(str(tmp_path / "o.xml"))
    data = mujoco.MjData(compiled)
    data.qpos[0] = 0.3
    mujoco.mj_forward(compiled, data)
    model = pin.buildModelFromUrdf(str(tmp_path / "o.urdf"))
    placed = model.createData()
    pin.forwardKinematics(model, placed, np.array([0.3]))
    com = placed.oMi[1].act(model.inertias[1].lever)
    np.testing.assert_allclose(com, data.xipos[compiled.body("object_part").id], atol=1e-6)
    X = motion.transform()
    body = compiled.body("object_part").id
    R, p = data.xmat[body].reshape(3, 3), data.xpos[body]
    np.testing.assert_allclose(corners @ R.T + p, corners @ X[:3, :3].T + X[:3, 3], atol=1e-9)


def test_a_part_of_a_few_points_is_refused(built, tmp_path):
    from dataclasses import replace

    estimate = built[1]
    nothing = replace(
        estimate.parts, before=np.zeros_like(estimate.parts.before), after=np.zeros_like(estimate.parts.after)
    )
    with pytest.raises(ModelError, match="only 0 points"):
        build_model(replace(estimate, parts=nothing), tmp_path)
