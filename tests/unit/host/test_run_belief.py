"""What execution teaches about the object changes exactly one face of the model."""

import mujoco
import numpy as np
import pytest

from s2r_host.errors import SceneError
from s2r_host.motion.nearest import nearest_to_tip
from s2r_host.motion.object_shapes import object_obstacles
from s2r_host.perception.motion import JointMotion
from s2r_host.run.belief import Belief
from s2r_host.run.contact import corrected, touched_by_push
from s2r_host.run.measure import PartTemplate
from s2r_host.run.object_file import with_face

# A bar 10 mm thick along the axis (-x is out of the cabinet), turned by half a turn about z like real models.
MJCF = """<mujoco><compiler angle="radian"/><worldbody><body name="object_base"><geom name="base_box" size="0.1 0.1 0.1"
 pos="1 0 0" type="box"/><body name="object_part"><joint name="object_joint" type="slide" axis="-1 0 0"
 range="-0.1 0.3"/><geom name="part_bar" type="box" pos="0.5 0 0.2" quat="0 0 0 1" size="0.005 0.05 0.006"/>
 <geom name="part_knob" type="sphere" pos="0.4 0 0.2" size="0.01"/></body></body></worldbody></mujoco>"""
OUT = np.array([-1.0, 0.0, 0.0])


@pytest.fixture
def belief(tmp_path):
    path = tmp_path / "object.xml"
    path.write_text(MJCF)
    slide = JointMotion("prismatic", np.zeros(3), OUT, 0.0)
    template = PartTemplate(np.zeros((1, 3)), np.array([OUT]), slide)
    return Belief(None, None, template, path, path, {})


def faces(path, name="part_bar"):
    """(inner, outer) face along the axis [m], + = out."""
    model = mujoco.MjModel.from_xml_path(str(path))
    geom = model.geom(name)
    middle = geom.pos @ OUT
    return middle - geom.size[0], middle + geom.size[0]


def test_drawer_further_out_than_foreseen_means_a_thicker_handle(belief, tmp_path):
    inner, outer = faces(belief.growing)
    after = corrected(belief, "part_bar", 0.003, positive=True, folder=tmp_path / "second")
    assert faces(after.growing) == pytest.approx((inner - 0.003, outer))
    assert after.shifts == {"part_bar": pytest.approx(-0.003)}


def test_drawer_less_far_out_means_a_thinner_handle(belief, tmp_path):
    inner, outer = faces(belief.growing)
    after = corrected(belief, "part_bar", -0.002, positive=True, folder=tmp_path / "second")
    assert faces(after.growing) == pytest.approx((inner + 0.002, outer))


def test_pushing_in_moves_the_outer_face(belief, tmp_path):
    inner, outer = faces(belief.growing)
    after = corrected(belief, "part_bar", -0.002, positive=False, folder=tmp_path / "second")
    assert faces(after.growing) == pytest.approx((inner, outer + 0.002))


def test_no_face_is_moved_through_the_other_one(belief, tmp_path):
    after = corrected(belief, "part_bar", -0.05, positive=True, folder=tmp_path / "second")
    inner, outer = faces(after.growing)
    assert outer - inner == pytest.approx(0.004)


def test_a_round_shape_moves_as_a_whole(belief, tmp_path):
    after = with_face(belief.growing, "part_knob", OUT, -0.004, tmp_path / "knob.xml", inner=True)
    model = mujoco.MjModel.from_xml_path(str(after))
    assert model.geom("part_knob").pos[0] == pytest.approx(0.404)


def test_corrections_add_up(belief, tmp_path):
    once = corrected(belief, "part_bar", 0.003, positive=True, folder=tmp_path / "second")
    twice = corrected(once, "part_bar", -0.001, positive=True, folder=tmp_path / "third")
    assert twice.shifts["part_bar"] == pytest.approx(-0.002)
    assert faces(twice.growing)[0] == pytest.approx(faces(belief.growing)[0] - 0.002)


def test_unknown_geom_is_refused_by_name(belief, tmp_path):
    with pytest.raises(SceneError, match="no geom 'part_lid'"):
        corrected(belief, "part_lid", 0.001, positive=True, folder=tmp_path)


def test_a_lid_that_went_further_than_foreseen_is_turned_back_about_its_hinge(tmp_path):
    path = tmp_path / "object.xml"
    path.write_text(MJCF)
    hinge = JointMotion("revolute", np.array([0.0, 0.0, 0.2]), np.array([0.0, 1.0, 0.0]), 0.0)
    belief = Belief(None, None, PartTemplate(np.zeros((1, 3)), np.array([OUT]), hinge), path, path, {})
    after = corrected(belief, "part_bar", np.pi / 2, positive=True, folder=tmp_path / "second")
    geom = mujoco.MjModel.from_xml_path(str(after.growing)).geom("part_bar")
    assert geom.pos == pytest.approx(
        [0.0, 0.0, 0.7], abs=1e-6
    )  # a quarter turn back about y through (0, 0, 0.2)
    assert list(after.shifts.values()) == [pytest.approx(-np.pi / 2)]
    assert after.falling == belief.falling  # the other side was not touched


@pytest.mark.parametrize("positive", [True, False])
def test_a_push_tells_where_the_side_of_the_lever_is_that_it_touched(lever_at_tip, arm, tmp_path, positive):
    belief, q = lever_at_tip, arm.arm.q_home

    def apart(path, s):
        shapes = [shape for shape in object_obstacles(path, s) if shape.name == "part_lever"]
        return nearest_to_tip(arm, q, shapes).distance_m

    s = 0.30 if positive else -0.30
    geom, offset = touched_by_push(belief, arm, q, s, positive, most=0.25)
    assert geom == "part_lever"
    after = corrected(belief, geom, offset, positive, tmp_path / "model-1")
    assert abs(apart(after.path(positive), s)) < 5e-4
    assert after.path(not positive) == belief.path(not positive)


def test_a_push_that_ended_far_from_the_part_tells_nothing(lever_at_tip, arm):
    belief, q = lever_at_tip, arm.arm.q_home
    assert touched_by_push(belief, arm, q, 1.2, True, most=0.1) is None
    assert touched_by_push(belief, arm, q, -0.9, True, most=0.1) is None
