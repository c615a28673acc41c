"""The procedural objects: every kind builds, moves as its truth says, and stays in its split."""

import json

import mujoco
import numpy as np
import pytest

from s2r_protocol.arms import load_arm
from s2r_sim.errors import WorldFileError
from s2r_sim.objects.catalogue import KINDS
from s2r_sim.objects.naming import JOINT, PART_BODY
from s2r_sim.objects.pairs import draw_pair, part_points
from s2r_sim.objects.scene import joint_truth, qpos_at, table_scene, write_object
from s2r_sim.objects.solids import Finish, box, rod, share_mass
from s2r_sim.objects.splits import Split, draw_object
from s2r_sim.physics import Physics
from s2r_sim.world import draw_world, load_world

SEEDS = range(12)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_every_object_starts_between_its_stops(kind, seed):
    spec = draw_object(kind, Split.TRAIN, seed)
    assert 0 <= spec.q_start <= spec.q_max


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_part_moves_by_the_true_joint(kind, seed):
    spec = draw_object(kind, Split.TRAIN, seed)
    model = table_scene(spec).compile()
    truth = joint_truth(model, spec)
    a, b = part_points(model, 0.2 * spec.q_max), part_points(model, 0.5 * spec.q_max)
    moved = 0.3 * spec.q_max
    axis, origin = np.array(truth.direction), np.array(truth.origin_m)
    if truth.joint_type == "prismatic":
        expected = a + moved * axis
    else:
        quat, R = np.empty(4), np.empty(9)
        mujoco.mju_axisAngle2Quat(quat, axis, moved)
        mujoco.mju_quat2Mat(R, quat)
        expected = (a - origin) @ R.reshape(3, 3).T + origin
    np.testing.assert_allclose(b, expected, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_part_stays_where_it_is_put(kind):
    for seed in range(4):
        spec = draw_object(kind, Split.TRAIN, seed)
        model = table_scene(spec).compile()
        data = mujoco.MjData(model)
        data.qpos[:] = qpos_at(model, spec.q_start)
        mujoco.mj_step(model, data, 500)
        moved = abs(data.qpos[model.joint(JOINT).qposadr[0]] - spec.q_start)
        assert moved < 0.003, f"{kind} {seed} crept by {moved:.4f}"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_but_the_table_is_below_zero(kind, seed):
    spec = draw_object(kind, Split.TRAIN, seed)
    model = table_scene(spec).compile()
    for q in np.linspace(0, spec.q_max, 5):
        assert part_points(model, q)[:, 2].min() > -1e-3


def test_door_opens_towards_the_arm():
    for seed in SEEDS:
        spec = draw_object("door", Split.TRAIN, seed)
        model = table_scene(spec).compile()
        ajar, open_ = part_points(model, 0.0), part_points(model, 1.0)
        assert open_[:, 0].min() < ajar[:, 0].min() - 0.05


def test_lids_and_screens_rise_as_they_open():
    for kind in ("laptop", "lid"):
        spec = draw_object(kind, Split.TRAIN, 1)
        model = table_scene(spec).compile()
        assert part_points(model, 1.2)[:, 2].max() > part_points(model, 0.0)[:, 2].max() + 0.1


def test_a_mass_is_shared_as_one_density_would():
    """The caps of a capsule have their share, too; by MuJoCo's own volumes, with a body for each solid."""
    metal, end = Finish((0.5, 0.5, 0.5), 0.5), (0.1, 0.02, 0.03)
    world = mujoco.MjSpec()
    bodies = [world.worldbody.add_body() for _ in range(3)]
    geoms = [box(bodies[0], "box", (0.0, 0.0, 0.0), end, metal)]
    geoms.append(rod(bodies[1], "cylinder", (0.0, 0.0, 0.0), end, 0.02, metal))
    geoms.append(rod(bodies[2], "capsule", (0.0, 0.0, 0.0), end, 0.02, metal, round_ends=True))
    of_one_density = world.compile().body_mass.copy()
    share_mass(geoms, float(of_one_density.sum()))
    assert world.compile().body_mass == pytest.approx(of_one_density)


def test_splits_never_share_an_object():
    drawn = [draw_object("faucet", split, seed) for split in Split for seed in range(20)]
    assert len({spec.model_dump_json() for spec in drawn}) == len(drawn)


def test_same_number_is_the_same_object():
    assert draw_object("door", Split.TEST, 3) == draw_object("door", Split.TEST, 3)


def test_sizes_really_vary():
    widths = [draw_object("chest", Split.TRAIN, seed).width_m for seed in range(40)]
    assert min(widths) < 0.27
    assert max(widths) > 0.45
    assert {draw_object("faucet", Split.TRAIN, seed).style for seed in range(40)} == {"top", "side", "pair"}


@pytest.mark.parametrize("kind", KINDS)
def test_hidden_world_can_hold_any_kind(kind, tmp_path):
    world = draw_world(2, kind, salt="a")
    world.save(tmp_path / "world.json")
    assert load_world(tmp_path / "world.json") == world
    physics = Physics(load_arm("xmate3pro"), world)
    assert physics.object_value == pytest.approx(world.object.q_start)


def test_unknown_kind_of_object_is_refused_by_name():
    with pytest.raises(WorldFileError, match="'toaster'; known are drawer, chest, laptop"):
        draw_object("toaster", Split.TRAIN, 0)


def test_written_object_loads_and_names_its_joint(tmp_path):
    spec = draw_object("laptop", Split.VALIDATION, 5)
    write_object(spec, tmp_path)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    content = json.loads((tmp_path / "object.json").read_text())
    assert model.body(PART_BODY).id > 0
    assert model.joint(JOINT).range[1] == pytest.approx(spec.q_max, rel=1e-4)
    assert content["joint"]["joint_type"] == "revolute"
    assert content["parameters"]["kind"] == "laptop"


def test_pair_moves_as_much_as_it_says_and_shows_it():
    pair = draw_pair("laptop", Split.TRAIN, 0, noise=False)
    assert abs(pair.delta) >= np.deg2rad(15)
    both = (pair.depth_before > 0) & (pair.depth_after > 0)
    changed = both & (np.abs(pair.depth_before - pair.depth_after) > 0.01)
    union = pair.part_before | pair.part_after
    assert (changed & union).sum() > 500
    assert not (changed & ~union).any()
