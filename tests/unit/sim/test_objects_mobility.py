"""Objects from folders laid out like PartNet-Mobility and Shape2Motion; the folders are written here."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

from s2r_sim.cli_data import data
from s2r_sim.errors import ShapelessError, WorldFileError
from s2r_sim.objects.mobility import read_mobility
from s2r_sim.objects.mobility_scene import MobilityPlace, mobility_scene, mobility_truth, movable
from s2r_sim.objects.naming import PART_BODY

URDF = """<robot name="partnet_cabinet">
  <link name="base"/>
  <link name="link_0">
    <visual><origin xyz="0 0 -0.5"/><geometry><mesh filename="textured_objs/door.obj"/></geometry></visual>
  </link>
  <joint name="joint_0" type="revolute">
    <origin xyz="0 0 0.5"/><axis xyz="0 1 0"/><parent link="link_2"/><child link="link_0"/>
    <limit lower="0" upper="1.57"/>
  </joint>
  <link name="link_1">
    <visual><geometry><mesh filename="textured_objs/drawer.obj"/></geometry></visual>
  </link>
  <joint name="joint_1" type="prismatic">
    <origin xyz="0 0 0"/><axis xyz="0 0 1"/><parent link="link_2"/><child link="link_1"/>
    <limit lower="0" upper="0.4"/>
  </joint>
  <link name="link_2">
    <visual><geometry><mesh filename="textured_objs/body.obj"/></geometry></visual>
  </link>
  <joint name="joint_2" type="fixed">
    <origin rpy="1.570796326794897 0 -1.570796326794897" xyz="0 0 0"/><parent link="base"/><child link="link_2"/>
  </joint>
</robot>
"""
SEMANTICS = "link_0 hinge rotation_door\nlink_1 slider drawer\nlink_2 heavy furniture_body\n"


def write_box(path: Path, low: tuple[float, float, float], high: tuple[float, float, float]) -> None:
    """A box as a Wavefront file without its last face: the data sets' meshes are not closed either."""
    x, y, z = zip(low, high, strict=True)
    corners = [(x[i], y[j], z[k]) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    faces = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5"]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(f"v {a} {b} {c}\n" for a, b, c in corners) + "".join(f"f {f}\n" for f in faces))


@pytest.fixture
def partnet(tmp_path):
    """A cabinet 2 units high with a door and a drawer; y is up in its meshes, z its front."""
    folder = tmp_path / "45001"
    (folder / "textured_objs").mkdir(parents=True)
    (folder / "mobility.urdf").write_text(URDF)
    (folder / "semantics.txt").write_text(SEMANTICS)
    write_box(folder / "textured_objs" / "body.obj", (-0.6, -1.0, -0.5), (0.6, 1.0, 0.45))
    write_box(folder / "textured_objs" / "door.obj", (0.0, -0.9, 0.45), (0.6, 0.0, 0.5))
    write_box(folder / "textured_objs" / "drawer.obj", (-0.5, 0.2, 0.0), (0.5, 0.8, 0.5))
    return folder


@pytest.fixture
def shape2motion(tmp_path):
    folder = tmp_path / "faucet" / "0007"
    write_box(folder / "part_objs" / "none_motion.obj", (-0.1, 0.0, -0.1), (0.1, 0.8, 0.1))
    write_box(folder / "part_objs" / "dof_rootd_Aa001_r.obj", (-0.05, 0.8, -0.05), (0.05, 1.0, 0.4))
    lever = {
        "dof_name": "dof_rootd_Aa001_r", "motion_type": "R", "center": [0.0, 0.8, 0.0], "direction": [0.0, 2.0, 0.0],
        "children": [],
    }  # fmt: skip
    tree = {
        "dof_name": "dof_rootd",
        "motion_type": "none",
        "center": [],
        "direction": [],
        "children": [lever],
    }
    (folder / "motion_attributes.json").write_text(json.dumps(tree))
    return folder


def test_partnet_links_come_with_meanings_limits_and_parents_first(partnet):
    links = {link.name: link for link in read_mobility(partnet)}
    assert list(links)[:2] == ["base", "link_2"]
    assert links["link_0"].meaning == "rotation_door"
    assert links["link_1"].limits == (0.0, 0.4)
    assert [link.name for link in movable(tuple(links.values()))] == ["link_0", "link_1"]


def test_partnet_drawer_slides_out_of_its_front_in_real_size(partnet):
    place = MobilityPlace(height_m=0.5, x_m=0.7, y_m=0.1)
    model = mobility_scene(partnet, "drawer", place).compile()
    truth = mobility_truth(model)
    assert truth.joint_type == "prismatic"
    np.testing.assert_allclose(np.abs(truth.direction), [1.0, 0.0, 0.0], atol=1e-6)
    assert truth.q_max == pytest.approx(0.4 * 0.5 / 2.0)
    assert truth.q_start == pytest.approx(0.3 * truth.q_max)


def test_partnet_object_stands_on_the_table_at_its_place(partnet):
    model = mobility_scene(partnet, "drawer", MobilityPlace(height_m=0.5, x_m=0.7, y_m=0.1)).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = []
    for geom in range(1, model.ngeom):
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        vertices = model.mesh_vert[first : first + count]
        points.append(vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
    cloud = np.concatenate(points)
    np.testing.assert_allclose(cloud[:, 2].min(), 0.0, atol=1e-6)
    np.testing.assert_allclose(cloud[:, 2].max(), 0.5, atol=1e-6)
    np.testing.assert_allclose((cloud.min(axis=0) + cloud.max(axis=0))[:2] / 2, [0.7, 0.1], atol=1e-6)


def test_shape2motion_lever_turns_about_its_centre_upright(shape2motion):
    model = mobility_scene(shape2motion, place=MobilityPlace(height_m=0.25)).compile()
    truth = mobility_truth(model)
    assert truth.joint_type == "revolute"
    np.testing.assert_allclose(truth.direction, [0.0, 0.0, 1.0], atol=1e-6)
    part = model.body(PART_BODY).id
    assert (model.geom_bodyid == part).sum() == 1
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    tip = data.geom_xpos[np.flatnonzero(model.geom_bodyid == part)[0]]
    assert np.linalg.norm(tip[:2] - np.array(truth.origin_m)[:2]) > 0.02


def test_which_part_is_asked_for_when_several_move(partnet):
    with pytest.raises(
        WorldFileError, match=r"one moving part is needed, there are 2.*rotation_door.*drawer"
    ):
        mobility_scene(partnet)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda f: (f / "mobility.urdf").unlink(), "neither mobility.urdf"),
        (lambda f: (f / "mobility.urdf").write_text("<robot>"), "no element found"),
        (lambda f: (f / "textured_objs" / "door.obj").unlink(), "door.obj, which is missing"),
        (lambda f: (f / "textured_objs" / "body.obj").write_text("v 0 0 0\n"), "1 vertices"),
        (
            lambda f: (f / "mobility.urdf").write_text(URDF.replace('parent link="base"', 'parent link="x"')),
            "joint 'joint_2' names the parent 'x', and no link is called that",
        ),
        (
            lambda f: (f / "mobility.urdf").write_text(
                URDF.replace('parent link="base"', 'parent link="link_2"')
            ),
            "hang on no root",
        ),
        (lambda f: (f / "mobility.urdf").write_text("<html/>"), "is no URDF; .* found a <html>"),
        (
            lambda f: (f / "semantics.txt").write_bytes(b"link_0 hinge T\xfcr\n"),
            "semantics.txt: is not UTF-8",
        ),
        (
            lambda f: (f / "textured_objs" / "body.obj").write_text(4 * "v 0 0 nan\n"),
            "a vertex is not finite",
        ),
        (
            lambda f: (f / "mobility.urdf").write_text(URDF.replace('"prismatic"', '"floating"')),
            "joint 'joint_1' is 'floating'",
        ),
    ],
)
def test_a_folder_that_cannot_be_used_is_refused_by_name(partnet, spoil, reason):
    spoil(partnet)
    with pytest.raises(WorldFileError, match=reason):
        mobility_scene(partnet, "drawer")


OWN = """<robot name="box_with_drawer">
  <link name="body">
    <visual><origin xyz="0 0 0.1"/><geometry><box size="0.3 0.4 0.2"/></geometry></visual>
  </link>
  <link name="drawer">
    <visual><geometry><box size="0.02 0.3 0.1"/></geometry></visual>
    <visual><origin xyz="-0.02 0 0" rpy="0 1.5707963 0"/><geometry>
      <cylinder radius="0.01" length="0.02"/></geometry></visual>
    <visual><origin xyz="-0.03 0 0"/><geometry><sphere radius="0.015"/></geometry></visual>
  </link>
  <joint name="slide" type="prismatic">
    <origin xyz="-0.16 0 0.1"/><axis xyz="-1 0 0"/><parent link="body"/><child link="drawer"/>
    <limit lower="0" upper="0.2"/>
  </joint>
</robot>
"""


@pytest.fixture
def own(tmp_path):
    """An ordinary URDF: z up, primitive shapes, no mesh and no fixed joint."""
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "box_with_drawer.urdf").write_text(OWN)
    return folder


def test_an_own_urdf_of_boxes_cylinders_and_spheres_stands_upright_in_its_own_size(own):
    model = mobility_scene(own, place=MobilityPlace(height_m=0.2, x_m=0.65)).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    body = data.geom("body_0")
    np.testing.assert_allclose(model.geom("body_0").size, [0.15, 0.2, 0.1], atol=1e-9)
    assert body.xpos[2] == pytest.approx(0.1)
    np.testing.assert_allclose(model.geom("drawer_1").size[:2], [0.01, 0.01], atol=1e-9)
    # From the sphere's front to the body's back it is 0.355 deep; its middle stands at x.
    assert data.geom("drawer_2").xpos[0] - 0.015 == pytest.approx(0.65 - 0.355 / 2)
    truth = mobility_truth(model)
    np.testing.assert_allclose(truth.direction, [-1.0, 0.0, 0.0], atol=1e-9)
    assert truth.q_max == pytest.approx(0.2)


def test_the_urdf_of_the_how_to_becomes_a_scene(tmp_path):
    page = Path(__file__).parents[3] / "docs" / "how-to" / "own-object.md"
    (tmp_path / "chest.urdf").write_text(page.read_text().split("```xml\n")[1].split("```")[0])
    assert mobility_scene(tmp_path).compile().njnt == 1


def test_what_collides_stands_for_what_is_not_drawn_and_a_mesh_keeps_its_own_scale(own):
    write_box(own / "front.obj", (-10.0, -150.0, -50.0), (10.0, 150.0, 50.0))
    mesh = '<mesh filename="front.obj" scale="0.001 0.001 0.001"/>'
    text = OWN.replace('<box size="0.02 0.3 0.1"/>', mesh).replace("visual>", "collision>")
    (own / "box_with_drawer.urdf").write_text(text)
    model = mobility_scene(own, place=MobilityPlace(height_m=0.2)).compile()
    half = sorted(model.geom_aabb[model.geom("drawer_0").id][3:])  # along the axes of inertia
    assert half == pytest.approx([0.01, 0.05, 0.15], abs=1e-6)


def test_a_part_without_a_shape_is_refused_by_the_names_of_its_links(own, tmp_path):
    start, end = OWN.index("    <visual><geometry><box size"), OWN.index('  </link>\n  <joint name="slide"')
    (own / "box_with_drawer.urdf").write_text(OWN[:start] + OWN[end:])
    ended = CliRunner().invoke(data, ["import", str(own), "--out", str(tmp_path / "o")])
    assert isinstance(ended.exception, ShapelessError)
    assert ended.exception.exit_code == 4
    assert "drawer would move and has no shape" in str(ended.exception)
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (
            "sphere radius",
            "capsule radius",
            "'drawer' has a 'capsule'; known are mesh, box, cylinder, sphere",
        ),
        (' length="0.02"', "", "the cylinder of link 'drawer' lacks or misstates its size"),
        ("0.3 0.4 0.2", "0.3 -0.4 0.2", "the box of link 'body' must have sizes above 0"),
        ('<sphere radius="0.015"/>', '<mesh filename="knob.obj"/>', "knob.obj, which is missing"),
        (
            '<sphere radius="0.015"/>',
            '<mesh filename="k" scale="0.1"/>',
            "scale '0.1' must be three finite numbers",
        ),
        ('<sphere radius="0.015"/>', '<mesh filename="k" scale="1 1 0"/>', "'1 1 0' makes its mesh flat"),
        ('xyz="-1 0 0"', 'xyz="-1 0"', "joint 'slide': xyz '-1 0' must be three finite numbers"),
        ('xyz="-1 0 0"', 'xyz="0 0 0"', "joint 'slide': its axis has no direction"),
        (
            'xyz="-0.16 0 0.1"',
            'xyz="nan 0 0.1"',
            "joint 'slide': xyz 'nan 0 0.1' must be three finite numbers",
        ),
        (
            'upper="0.2"',
            'upper="-0.2"',
            "joint 'slide': its limits go from 0 to -0.2; lower must not be above upper",
        ),
        ('upper="0.2"', 'upper="wide"', "joint 'slide': its limit is no number"),
        ('<link name="drawer">', '<link name="body"/><link name="drawer">', "2 links are named 'body'"),
    ],
)
def test_a_shape_that_cannot_be_read_is_refused_by_its_link(own, old, new, reason):
    (own / "box_with_drawer.urdf").write_text(OWN.replace(old, new))
    with pytest.raises(WorldFileError, match=reason):
        mobility_scene(own)


def test_an_encoding_that_nobody_knows_is_refused(own):
    (own / "box_with_drawer.urdf").write_text('<?xml version="1.0" encoding="latin-9x"?>' + OWN)
    with pytest.raises(WorldFileError, match=r"box_with_drawer\.urdf: unknown encoding: latin-9x"):
        mobility_scene(own)


def test_a_hinge_in_degrees_is_refused(own):
    hinge = OWN.replace("prismatic", "revolute").replace('upper="0.2"', 'upper="90"')
    (own / "box_with_drawer.urdf").write_text(hinge)
    with pytest.raises(
        WorldFileError, match=r"from 0 to 90, that is 14\.3 times around; a URDF counts radians"
    ):
        mobility_scene(own)


def test_a_limit_that_is_left_out_is_zero_as_in_every_urdf(own):
    (own / "box_with_drawer.urdf").write_text(OWN.replace('lower="0" upper="0.2"', 'upper="0.15"'))
    assert mobility_scene(own, place=MobilityPlace(height_m=0.2)).compile().joint(0).range.tolist() == [
        0.0,
        0.15,
    ]


def with_knob(own: Path, mesh: str) -> None:
    (own / "knob.obj").write_text(mesh)
    (own / "box_with_drawer.urdf").write_text(
        OWN.replace('<sphere radius="0.015"/>', '<mesh filename="knob.obj" scale="0.1 0.1 0.1"/>')
    )


@pytest.mark.parametrize(
    ("mesh", "area_m2"),
    [
        ("v 0 0 0\nv 0 1 0\nv 0 1 1\nv 0 0 1\nf 1 2 3 4\n", 0.01),
        (
            "v 0 0 0\nv 0 1 0\nv 0 1 1\nv 0 0 1\nf -4/1 -3/2 -2/3 -1/4\nf 1 4 3 2\n",
            0.01,
        ),  # shown from both sides
        ("v 0 0 0\nv 0 1 0\nv 0 0 1\nf 1//1 2//1 3//1\n", 0.005),
    ],
)
def test_a_flat_mesh_becomes_a_closed_solid_of_two_millimetres_and_the_user_is_told(
    own, tmp_path, mesh, area_m2
):
    with_knob(own, mesh)
    out = tmp_path / "o"
    ended = CliRunner().invoke(data, ["import", str(own), "--height", "0.2", "--out", str(out)])
    assert ended.exit_code == 0, ended.output
    assert "flat, made 2 mm thick: drawer_2" in ended.output
    assert json.loads((out / "object.json").read_text())["thickened"] == ["drawer_2"]
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    vertices = model.mesh_vert[: model.mesh_vertnum[0]].astype(float)
    faces = model.mesh_face[: model.mesh_facenum[0]]
    a, b, c = np.swapaxes(vertices[faces], 0, 1)
    volume = np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(area_m2 * 0.002, rel=1e-3)  # of a closed surface that faces outwards
    edges = [(f[k], f[(k + 1) % 3]) for f in faces.tolist() for k in range(3)]
    assert sorted(edges) == sorted((j, i) for i, j in edges)


@pytest.mark.parametrize(
    "mesh",
    [
        "v 0 0 0\nv 0 1 0\nv 0 2 0\nv 0 3 0\nf 1 2 3 4\n",
        "v 0 0 0\nv 0 1 0\nv 0 1 1\nv 0 0 1\n",
    ],
)
def test_a_mesh_without_area_is_refused_by_its_link_before_anything_is_written(own, tmp_path, mesh):
    with_knob(own, mesh)
    ended = CliRunner().invoke(data, ["import", str(own), "--out", str(tmp_path / "o")])
    assert isinstance(ended.exception, WorldFileError)
    assert "knob.obj: shape 'drawer_2' has no area" in str(ended.exception)
    assert not (tmp_path / "o").exists()


def test_an_object_that_lies_flat_as_a_whole_has_no_height_to_scale(own):
    (own / "sheet.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    (own / "box_with_drawer.urdf").write_text(
        '<robot name="sheet"><link name="table"/><link name="sheet"><visual><geometry><mesh filename="sheet.obj"/>'
        '</geometry></visual></link><joint name="slide" type="prismatic"><parent link="table"/><child link="sheet"/>'
        '<axis xyz="1 0 0"/><limit lower="0" upper="0.2"/></joint></robot>'
    )
    with pytest.raises(WorldFileError, match="has no height that could be scaled"):
        mobility_scene(own)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"direction": [0.0, 0.0, 0.0]}, "'dof_rootd_Aa001_r': its axis has no direction"),
        ({"direction": [0.0, 1.0]}, r"direction \[0.0, 1.0\]; each must be three finite numbers"),
        ({"motion_type": "X"}, "misstates 'X'"),
        ({"children": None}, None),
        ({"children": 5}, "'dof_rootd_Aa001_r': its children are 5; they must be a list of parts"),
    ],
)
def test_a_part_of_shape2motion_that_is_misstated_is_refused_by_name(shape2motion, change, reason):
    file = shape2motion / "motion_attributes.json"
    tree = json.loads(file.read_text())
    tree["children"][0] |= change
    file.write_text(json.dumps(tree))
    if reason is None:
        assert mobility_scene(shape2motion).compile().njnt == 1
        return
    with pytest.raises(WorldFileError, match=reason):
        mobility_scene(shape2motion)


def test_words_of_a_mesh_may_be_set_apart_by_tabs(partnet):
    files = list((partnet / "textured_objs").iterdir())
    as_before = mobility_scene(partnet, "drawer").compile()
    for file in files:
        file.write_text("".join(f" {line}\n" for line in file.read_text().replace(" ", "\t").splitlines()))
    with_tabs = mobility_scene(partnet, "drawer").compile()
    np.testing.assert_allclose(with_tabs.geom_aabb, as_before.geom_aabb, atol=1e-9)


def test_a_mesh_of_another_format_is_refused_with_what_to_write(own):
    (own / "knob.stl").write_bytes(b"\x80\xff")
    (own / "box_with_drawer.urdf").write_text(
        OWN.replace('<sphere radius="0.015"/>', '<mesh filename="knob.stl"/>')
    )
    with pytest.raises(WorldFileError, match=r"knob\.stl: meshes are read as Wavefront files"):
        mobility_scene(own)


def test_import_command_writes_a_scene_that_loads(partnet, tmp_path):
    result = CliRunner().invoke(
        data, ["import", str(partnet), "--part", "drawer", "--out", str(tmp_path / "o")]
    )
    assert result.exit_code == 0, result.output
    assert "prismatic joint" in result.output
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "o" / "scene.xml"))
    assert model.site("arm_base").pos.tolist() == [0.0, 0.0, 0.0]  # s2r plan puts the arm there
    assert json.loads((tmp_path / "o" / "object.json").read_text())["joint"]["joint_type"] == "prismatic"


LID = """<robot name="lid">
  <link name="base"><visual><origin xyz="0.12 0 0.01"/><geometry><box size="0.24 0.34 0.02"/></geometry></visual></link>
  <link name="lid">
    <visual><origin xyz="0.12 0 0.004"/><geometry><box size="0.24 0.34 0.008"/></geometry></visual></link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="lid"/>
    <origin xyz="0 0 0.02"/><axis xyz="0 -1 0"/><limit lower="0" upper="2.3"/></joint>
</robot>
"""


@pytest.fixture
def lid(tmp_path):
    """Of 0.65 kg, its weight 0.77 N·m about the hinge where it lies."""
    folder = tmp_path / "lid"
    folder.mkdir()
    (folder / "lid.urdf").write_text(LID)
    return folder


def test_a_lid_stays_where_it_was_found(lid, tmp_path):
    written = CliRunner().invoke(
        data, ["import", str(lid), "--height", "0.028", "--out", str(tmp_path / "o")]
    )
    assert "revolute joint, found at 0.690, goes from 0.000 to 2.300" in written.output
    told = json.loads((tmp_path / "o" / "object.json").read_text())
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "o" / "scene.xml"))
    state = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, state, 0)
    assert state.qpos[0] == pytest.approx(told["joint"]["q_start"])
    assert told["place"]["coulomb"] == pytest.approx(1.3 * 0.6528 * 9.81 * np.hypot(0.12, 0.004), rel=1e-4)
    for _ in range(1000):
        mujoco.mj_step(model, state)
    assert state.qpos[0] == pytest.approx(told["joint"]["q_start"], abs=np.deg2rad(0.05))


def test_below_its_dry_friction_an_imported_joint_does_not_creep(lid):
    model = mobility_scene(lid, place=MobilityPlace(height_m=0.028, coulomb=0.5)).compile()
    model.opt.gravity[:] = 0.0
    state = mujoco.MjData(model)
    state.qpos[0], state.qfrc_applied[0] = 1.0, 0.45
    for _ in range(1000):
        mujoco.mj_step(model, state)
    assert state.qpos[0] == pytest.approx(1.0, abs=np.deg2rad(0.1))


def test_what_has_no_stop_is_told_with_the_lower_limit_it_gets(lid, tmp_path):
    (lid / "lid.urdf").write_text(LID.replace('"revolute"', '"continuous"'))
    written = CliRunner().invoke(data, ["import", str(lid), "--out", str(tmp_path / "o")])
    assert "found at -1.257, goes from -3.142 to 3.142" in written.output
    assert json.loads((tmp_path / "o" / "object.json").read_text())["joint"]["q_min"] == pytest.approx(-np.pi)


def mass_of_part(out: Path) -> float:
    """Of what moves in a written scene [kg]."""
    return float(mujoco.MjModel.from_xml_path(str(out / "scene.xml")).body(PART_BODY).mass[0])


L_SHAPE = (
    "v 0 0 0\nv 1 0 0\nv 1 0.2 0\nv 0.2 0.2 0\nv 0.2 1 0\nv 0 1 0\n"
    "v 0 0 1\nv 1 0 1\nv 1 0.2 1\nv 0.2 0.2 1\nv 0.2 1 1\nv 0 1 1\n"
    "f 1 2 8 7\nf 2 3 9 8\nf 3 4 10 9\nf 4 5 11 10\nf 5 6 12 11\nf 6 1 7 12\n"
)


def test_an_open_mesh_weighs_what_the_solid_within_it_weighs(own, tmp_path):
    """A bracket of 0.1 m without its two ends: 0.36 of the cube around it, where its hull has 0.68."""
    with_knob(own, L_SHAPE)
    written = CliRunner().invoke(data, ["import", str(own), "--height", "0.2", "--out", str(tmp_path / "o")])
    assert written.exit_code == 0, written.output
    rest = 1000 * (0.02 * 0.3 * 0.1 + np.pi * 0.01**2 * 0.02)  # its box and its cylinder [kg]
    assert mass_of_part(tmp_path / "o") - rest == pytest.approx(0.36, rel=1e-3)
    assert json.loads((tmp_path / "o" / "object.json").read_text())["hulled"] == []


def test_a_mesh_that_bounds_no_solid_weighs_as_its_hull_and_is_named(own, tmp_path):
    """A tetrahedron of 0.1 m with a fin: three faces at one edge."""
    with_knob(
        own, "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 1 1 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\nf 2 3 5\n"
    )
    ended = CliRunner().invoke(data, ["import", str(own), "--height", "0.2", "--out", str(tmp_path / "o")])
    assert ended.exit_code == 0, ended.output
    assert "bounding no solid, weighed as their convex hulls: drawer_2" in ended.output
    assert json.loads((tmp_path / "o" / "object.json").read_text())["hulled"] == ["drawer_2"]
