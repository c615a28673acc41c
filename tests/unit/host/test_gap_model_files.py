"""Models whose shapes are files of their own: beside the model, in a package of ROS, or not there."""

import mujoco
import pytest

from s2r_host.gap.effects.base import Context
from s2r_host.gap.errors import GapModelError
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.output.answer import write_model
from s2r_host.gap.simulation.replay import build_twin

TETRAHEDRON = "".join(f"v {v}\n" for v in ("0 0 0", ".1 0 0", "0 .1 0", "0 0 .1")) + "".join(
    f"f {f}\n" for f in ("1 3 2", "1 2 4", "1 4 3", "2 3 4")
)
INERTIAL = '<inertial mass="1" pos="0 0 -.2" diaginertia=".01 .01 .001"/>'
URDF_INERTIAL = """<inertial><origin xyz="0 0 -.2"/><mass value="1"/>
<inertia ixx=".01" iyy=".01" izz=".001" ixy="0" ixz="0" iyz="0"/></inertial>"""
PACKAGE_MESH = '<geometry><mesh filename="package://arm_description/meshes/link.obj"/></geometry>'


def mjcf(folder, inertial=INERTIAL):
    path = folder / "arm.xml"
    path.write_text(
        f'<mujoco><compiler meshdir="meshes"/><asset><mesh file="link.obj"/></asset><worldbody><body name="arm">'
        f'<joint name="elbow" axis="0 1 0"/>{inertial}<geom type="mesh" mesh="link"/></body></worldbody></mujoco>',
        encoding="utf-8",
    )
    return path


def urdf(folder, inertial=URDF_INERTIAL):
    path = folder / "arm.urdf"
    path.write_text(
        f'<robot name="r"><link name="base"/><link name="arm">{inertial}<visual>{PACKAGE_MESH}</visual>'
        f'<collision>{PACKAGE_MESH}</collision></link><joint name="elbow" type="continuous"><parent link="base"/>'
        '<child link="arm"/><axis xyz="0 1 0"/></joint></robot>',
        encoding="utf-8",
    )
    return path


def mesh_in(folder):
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes" / "link.obj").write_text(TETRAHEDRON, encoding="utf-8")


def patched(model, folder):
    """What stock MuJoCo reads of the patched model, written elsewhere."""
    folder.mkdir()
    write_model(build_twin(model, Context(model, []), []), folder)
    return mujoco.MjModel.from_xml_path(str(folder / "model_patched.xml"))


def test_the_patched_model_of_one_with_meshes_loads_from_its_folder(tmp_path, monkeypatch):
    mesh_in(tmp_path)
    mjcf(tmp_path)
    monkeypatch.chdir(tmp_path)
    model = RigidModel(mjcf(tmp_path).relative_to(tmp_path))
    assert model.left_out == []
    assert patched(model, tmp_path / "out").nmesh == 1


def test_meshes_of_a_ros_package_are_found_among_the_folders_above(tmp_path):
    for package, beside in (("arm_description", "urdf"), ("src/arm_description", "src/robots")):
        mesh_in(tmp_path / "ws" / package)
        folder = tmp_path / "ws" / (beside if package.startswith("src") else f"{package}/{beside}")
        folder.mkdir(parents=True)
        model = RigidModel(urdf(folder))
        assert model.left_out == []
        assert patched(model, folder / "out").nmesh == 1


@pytest.mark.parametrize("write", [mjcf, urdf])
def test_meshes_that_are_not_there_are_told_where_inertia_is_stated(tmp_path, write):
    model = RigidModel(write(tmp_path))
    (said,) = model.left_out
    assert "1 mesh file(s) are not found and left out" in said
    assert "link.obj" in said
    assert patched(model, tmp_path / "out").body_mass[1] == pytest.approx(1.0)


@pytest.mark.parametrize("write", [mjcf, urdf])
def test_a_mesh_that_gives_a_link_its_mass_has_to_be_there(tmp_path, write):
    with pytest.raises(
        GapModelError, match=r"'arm' states no inertia of its own, and the mesh .*link.obj.* not found"
    ):
        RigidModel(write(tmp_path, inertial=""))
