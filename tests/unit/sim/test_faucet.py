"""The faucet whose lever lies below a ledge: as found only what is near its axis is open to a fingertip."""

import json

import mujoco
import numpy as np
import pytest

from s2r_sim.errors import WorldFileError
from s2r_sim.objects.faucet import draw_ledge, has_room_for_ledge
from s2r_sim.objects.naming import JOINT
from s2r_sim.objects.scene import qpos_at, table_scene
from s2r_sim.objects.splits import Split, draw_object
from s2r_sim.world import draw_world, load_world

ROOMY = [spec for seed in range(60) if has_room_for_ledge(spec := draw_object("faucet", Split.TRAIN, seed))]


def below_ledge(spec):
    return spec.model_copy(update={"ledge": draw_ledge(np.random.default_rng(1), spec)})


def seen_from_above(model, q, share):
    """Geom that is first met from above at this share of the lever, with the joint at q."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos_at(model, q)
    mujoco.mj_kinematics(model, data)
    lever, joint = data.geom("part_lever_0"), model.joint(JOINT).id
    root = data.xanchor[joint] + data.xaxis[joint] * ((lever.xpos - data.xanchor[joint]) @ data.xaxis[joint])
    above = root + 2.0 * share * (lever.xpos - root) + (0.0, 0.0, 0.3)  # its centre is half-way along
    met = np.zeros(1, dtype=np.int32)
    mujoco.mj_ray(model, data, above, np.array([0.0, 0.0, -1.0]), None, 1, -1, met, None)
    return model.geom(int(met[0])).name


@pytest.mark.parametrize("spec", ROOMY[:8], ids=lambda spec: spec.style)
def test_a_ledge_leaves_only_what_is_near_the_axis_until_the_lever_has_turned(spec):
    model = table_scene(below_ledge(spec)).compile()
    assert seen_from_above(model, spec.q_start, 0.35) == "part_lever_0"
    met = {seen_from_above(model, spec.q_start, share) for share in (0.65, 0.8, 0.95)}
    assert "base_ledge" in met
    assert "part_lever_0" not in met  # where it is not the ledge, it is the spout
    turned = spec.q_start + np.deg2rad(50) * (1.0 if spec.q_start < spec.q_max / 2 else -1.0)
    assert seen_from_above(model, turned, 0.8) == "part_lever_0"


def test_a_lever_turns_below_its_ledge_as_without():
    spec = next(spec for spec in ROOMY if spec.style == "top")
    ends = []
    for one in (spec, below_ledge(spec)):
        model = table_scene(one).compile()
        data = mujoco.MjData(model)
        data.qpos[:] = qpos_at(model, spec.q_start)
        data.qfrc_applied[:] = -2.0 * spec.coulomb
        mujoco.mj_step(model, data, 100)
        ends.append(float(data.joint(JOINT).qpos[0]))
    assert ends[0] < spec.q_start - 0.05
    assert ends[1] == ends[0]


def test_a_ledge_over_a_lever_at_the_side_is_refused_by_name(tmp_path):
    seed = next(seed for seed in range(50) if draw_world(seed, "faucet").object.style == "side")
    content = json.loads(draw_world(seed, "faucet").to_json())
    assert "ledge" not in content["object"]
    content["object"]["ledge"] = {"begins": 0.5, "gap_m": 0.015, "width_m": 0.05}
    (tmp_path / "w.json").write_text(json.dumps(content))
    with pytest.raises(WorldFileError, match="a ledge needs one lever that turns about an upright axis"):
        load_world(tmp_path / "w.json")
