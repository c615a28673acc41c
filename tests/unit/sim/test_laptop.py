"""The laptop whose lid gives: two plates on a spring hinge, felt and seen as one part."""

import json

import mujoco
import numpy as np
import pytest

from s2r_sim.errors import WorldFileError
from s2r_sim.objects.laptop import draw_bend
from s2r_sim.objects.naming import BEND_JOINT, FAR_BODY, JOINT, PART_BODY
from s2r_sim.objects.scene import qpos_at, table_scene
from s2r_sim.objects.splits import Split, draw_object
from s2r_sim.physics import Physics
from s2r_sim.world import draw_world, load_world


def bent(seed):
    spec = draw_object("laptop", Split.TRAIN, seed)
    return spec.model_copy(update={"bend": draw_bend(np.random.default_rng(seed), spec)})


@pytest.mark.parametrize("seed", range(4))
def test_two_plates_are_the_same_lid_when_they_are_flat(seed):
    spec = bent(seed)
    rigid = table_scene(spec.model_copy(update={"bend": None})).compile()
    model = table_scene(spec).compile()
    assert model.nq == rigid.nq + 1
    plates = model.body(PART_BODY), model.body(FAR_BODY)
    assert sum(plate.mass[0] for plate in plates) == pytest.approx(rigid.body(PART_BODY).mass[0])
    whole, near, far = rigid.geom("part_lid"), model.geom("part_lid"), model.geom("part_lid_far")
    assert near.pos[0] - near.size[0] == pytest.approx(whole.pos[0] - whole.size[0])
    assert near.pos[0] + near.size[0] == pytest.approx(far.pos[0] - far.size[0])
    assert far.pos[0] + far.size[0] == pytest.approx(whole.pos[0] + whole.size[0])


@pytest.mark.parametrize("seed", range(8))
def test_a_fingertip_bends_the_lid_by_degrees_and_it_rings_down(seed):
    spec = bent(seed)
    model = table_scene(spec).compile()
    model.dof_frictionloss[model.joint(JOINT).dofadr[0]] = 1e3  # the hinge holds: what moves is the lid
    data, bend = mujoco.MjData(model), int(model.joint(BEND_JOINT).qposadr[0])
    data.qpos[:] = qpos_at(model, spec.q_start)
    mujoco.mj_step(model, data, 1000)
    at_rest = data.qpos[bend]
    assert abs(at_rest) < np.deg2rad(3)  # by its own weight
    data.qfrc_applied[model.joint(BEND_JOINT).dofadr[0]] = 5.0 * (1.0 - spec.bend.at) * spec.depth_m
    mujoco.mj_step(model, data, 1500)
    given = data.qpos[bend] - at_rest
    assert np.deg2rad(0.5) < given < np.deg2rad(5)
    data.qfrc_applied[:] = 0.0
    left = []
    for _ in range(800):
        mujoco.mj_step(model, data)
        left.append(abs(data.qpos[bend] - at_rest))
    assert max(left[350:]) < 0.4 * given
    assert max(left[750:]) < 0.15 * given
    assert data.qpos[model.joint(JOINT).qposadr[0]] == pytest.approx(spec.q_start, abs=1e-3)


def test_touching_the_far_plate_is_touching_the_part(arm):
    world = draw_world(2, "laptop", salt="a")
    tip = Physics(arm, world).data.site("tool_tip").xpos.copy()
    flat = {"q_start": np.pi / 2, "q_max": np.pi, "yaw_rad": 0.0, "y_m": float(tip[1])}
    spec = world.object.model_copy(update=flat | {"x_m": float(tip[0]), "stand_m": float(tip[2]) - 0.2})
    spec = spec.model_copy(update={"bend": draw_bend(np.random.default_rng(0), spec)})
    with pytest.raises(WorldFileError, match="where the arm is in its home pose"):
        Physics(arm, world.model_copy(update={"object": spec}))


def test_a_rigid_lid_is_written_and_sealed_as_before_lids_could_bend(tmp_path):
    world = draw_world(2, "laptop", salt="a")
    assert "bend" not in json.loads(world.to_json())["object"]
    hidden = world.model_copy(update={"object": bent(2)})
    hidden.save(tmp_path / "world.json")
    assert load_world(tmp_path / "world.json") == hidden
    assert load_world(tmp_path / "world.json").commitment == hidden.commitment != world.commitment


def test_a_bend_at_the_hinge_is_refused_by_name(tmp_path):
    content = json.loads(draw_world(2, "laptop").to_json())
    content["object"]["bend"] = {"at": 0.1, "stiffness_Nm_rad": 20.0, "damping_Nms_rad": 0.1}
    (tmp_path / "w.json").write_text(json.dumps(content))
    with pytest.raises(WorldFileError, match=r"bend\.at: Input should be greater than or equal to 0\.3"):
        load_world(tmp_path / "w.json")
