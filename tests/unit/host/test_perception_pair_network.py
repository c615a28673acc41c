"""The pair network: its input, its votes, its training and its export. Training parts need torch (extra 'learn')."""

import os
import shutil
from dataclasses import replace

import numpy as np
import pytest

from s2r_host.learn.pair_draws import draw, exchanged
from s2r_host.learn.pair_files import load_pairs, pair_files
from s2r_host.perception import synthetic
from s2r_host.perception.change import Change
from s2r_host.perception.errors import InputError, NothingMovedError
from s2r_host.perception.estimate import prepare
from s2r_host.perception.evidence import Scene
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.pair_cloud import FEATURES, POINTS, SHARES, facing, pool, sample
from s2r_host.perception.pair_network import PairNetworkRuntime
from s2r_host.perception.pair_space import beside
from s2r_host.perception.pair_votes import PART, VOTES, Votes, errors, flow, true_votes

UNIT_M = 1e-4


@pytest.fixture(scope="module")
def pair():
    return synthetic.laptop_pair(np.random.default_rng(3), turn_rad=0.6)


@pytest.fixture(scope="module")
def scene(pair):
    return prepare(pair.before, pair.after, None, None, None, np.random.default_rng(0))[0]


@pytest.fixture(scope="module")
def cloud(scene):
    return sample(pool(scene, np.random.default_rng(0)), np.random.default_rng(1))


def test_sample_has_its_size_and_its_shares(cloud):
    assert cloud.points.shape == (2, POINTS, 3)
    assert cloud.features().shape == (2, POINTS, FEATURES)
    moved = cloud.flags[..., 2].mean(axis=1)
    assert (moved >= SHARES[Change.MOVED] - 0.01).all()
    assert (cloud.flags[..., 2] * cloud.flags[..., 3] == 0).all()


def test_points_lie_around_what_moved(scene, cloud):
    moved = scene.moved_points()
    low, high = np.percentile(moved, [2, 98], axis=0)
    np.testing.assert_allclose(cloud.centre, 0.5 * (low + high))
    assert (cloud.points >= low - 0.1501).all()
    assert (cloud.points <= high + 0.1501).all()


def test_a_region_that_one_view_alone_shows_is_nothing_to_have_an_opinion_on(pair):
    """The place that a lid left: the second view has no point there. It ended as a bug."""
    gone = prepare(pair.before, pair.after, None, None, None, np.random.default_rng(0))[0]
    nowhere = np.zeros(len(gone.after.points), dtype=bool)
    assert (
        PairNetworkRuntime().belief(replace(gone, candidate_after=nowhere), np.random.default_rng(0)) is None
    )


def test_a_view_with_few_points_gives_some_twice(scene):
    pools = pool(scene, np.random.default_rng(0))
    few = replace(pools.after, **{name: getattr(pools.after, name)[:100] for name in vars(pools.after)})
    small = sample(replace(pools, after=few), np.random.default_rng(1))
    assert small.points.shape == (2, POINTS, 3)
    assert set(small.chosen[1]) == set(range(100))


def test_where_nothing_changed_there_is_no_input(scene):
    still = replace(
        scene.changes, before=np.ones_like(scene.changes.before), after=np.ones_like(scene.changes.after)
    )
    same = Scene(scene.before, scene.after, still, scene.candidate_before, scene.candidate_after)
    with pytest.raises(NothingMovedError):
        pool(same, np.random.default_rng(0))


MOTIONS = [
    JointMotion("revolute", np.array([0.4, 0.1, 0.2]), np.array([0.0, 0.6, 0.8]), 0.7),
    JointMotion("prismatic", np.array([0.4, 0.1, 0.2]), np.array([0.6, 0.0, -0.8]), 0.12),
]


def _votes(points, motion, share_wrong, rng):
    """True votes of all points with logits, some of them nonsense."""
    output = true_votes(points, motion).astype(float)
    output[:, PART] = 3.0
    output[:, 1] = 4.0 if motion.joint_type == "prismatic" else -4.0
    wrong = rng.uniform(size=len(points)) < share_wrong
    output[wrong, 2:] = rng.normal(size=(int(wrong.sum()), VOTES - 2))
    return Votes(points, output, np.zeros(len(points), bool))


@pytest.mark.parametrize("motion", MOTIONS, ids=["turn", "slide"])
def test_votes_of_which_a_quarter_is_nonsense_still_name_the_joint(motion):
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.2, 0.5, (400, 3))
    found = _votes(points, motion, 0.25, rng).opinion()
    assert found is not None
    best = found.best()
    assert best.joint_type == motion.joint_type
    angle, line, delta = errors(best, motion, points.mean(axis=0))
    assert np.degrees(angle) < 1.0
    assert abs(delta) < 0.02 * motion.delta
    if motion.joint_type == "revolute":
        assert line < 0.003


def test_reversed_joint_is_180_degrees_off():
    turn = MOTIONS[0]
    angle, line, _ = errors(replace(turn, direction=-turn.direction), turn, np.zeros(3))
    assert angle == pytest.approx(np.pi)
    assert line == pytest.approx(0.0, abs=1e-9)


def test_hardly_any_point_of_a_part_is_no_opinion():
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.2, 0.5, (400, 3))
    votes = _votes(points, MOTIONS[0], 0.0, rng)
    votes.output[20:, PART] = -3.0
    assert votes.opinion() is None


def test_missing_weights_name_the_command_that_makes_them(tmp_path):
    with pytest.raises(InputError, match="s2r train model"):
        PairNetworkRuntime(tmp_path)


def _solid(pair):
    """A box around what is seen of the part, as one exact solid."""
    p = pair.before.points_base()[pair.part_before]
    p = p[np.isfinite(p).all(axis=1)]
    low, high = np.percentile(p, [2, 98], axis=0)
    pose = np.c_[np.eye(3), (low + high) / 2]
    return np.concatenate([[6], (high - low) / 2, pose.ravel()])[None]


def write_pair(path, k, spokes=1, **left_out):
    """Two views of a laptop or a drawer."""
    make = synthetic.laptop_pair if k % 2 else synthetic.drawer_pair
    pair = make(np.random.default_rng(k))
    frames, X = (pair.before, pair.after), pair.motion.transform()
    part = [pair.part_before]
    # Pixels of the part in the second view: those near where its points of the first view went.
    p = pair.before.points_base()[pair.part_before]
    p = p[np.isfinite(p).all(axis=1)] @ X[:3, :3].T + X[:3, 3]
    view = pair.after
    p_C = (p - view.X_base_camera[:3, 3]) @ view.X_base_camera[:3, :3]
    u, v = (np.rint(view.K[i, i] * p_C[:, i] / p_C[:, 2] + view.K[i, 2]).astype(int) for i in (0, 1))
    inside = (u >= 0) & (u < view.depth_m.shape[1]) & (v >= 0) & (v < view.depth_m.shape[0])
    after = np.zeros(view.depth_m.shape, bool)
    after[v[inside], u[inside]] = True
    part.append(after)
    content = {
        "depth": np.stack([np.rint(f.depth_m / UNIT_M) for f in frames]).astype(np.uint16),
        "part": np.packbits(np.stack(part), axis=-1), "q": np.array([0.0, pair.motion.delta]),
        "K": view.K, "T_base_camera": view.X_base_camera, "slides": pair.motion.joint_type == "prismatic",
        "axis_origin": pair.motion.origin, "axis_direction": pair.motion.direction, "spokes": spokes,
        "kind": "laptop" if k % 2 else "chest", "solids": _solid(pair),
    }  # fmt: skip
    np.savez(path, **{name: value for name, value in content.items() if name not in left_out})


@pytest.fixture(scope="module")
def pair_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    for k in range(8):
        write_pair(folder / f"object-{'train' if k < 6 else 'validation'}-{k:05d}.npz", k)
    return folder


@pytest.mark.parametrize("motion", MOTIONS, ids=["turn", "slide"])
def test_flow_of_either_view_leads_into_the_other(motion):
    p = np.random.default_rng(0).uniform(size=(20, 3))
    there = p + flow(p, motion, back=False)
    np.testing.assert_allclose(there + flow(there, motion, back=True), p, atol=1e-12)
    assert np.linalg.norm(there - p, axis=1).min() > 0.01


def test_points_beside_a_query_come_from_both_views_in_the_first_pose(cloud, pair):
    part = np.zeros((2, POINTS), np.float32)
    part[1, 5] = 1.0
    X = np.linalg.inv(pair.motion.transform())
    back = cloud.points[1, 5] @ X[:3, :3].T + X[:3, 3]
    query = np.stack([back, cloud.points[0, 3]])
    near = beside(query, cloud, part, pair.motion)
    assert POINTS + 5 in near.index[0]
    assert near.index[1, 0] == 3
    k = list(near.index[0]).index(POINTS + 5)
    np.testing.assert_allclose(near.geometry[0, k, :3], 0.0, atol=1e-5)
    assert near.geometry[0, k, 7] == 1.0
    assert (np.delete(near.index, [0], axis=0) < POINTS).all() or POINTS + 5 in near.index[1]


def test_points_are_kept_beside_the_views_and_say_the_same(pair_folder):
    (file, *_) = pair_files(pair_folder, "train")
    (first,) = load_pairs(file)
    kept = pair_folder / "points" / file.name
    assert kept.exists()
    (again,) = load_pairs(file)
    np.testing.assert_array_equal(first.place, again.place)
    np.testing.assert_array_equal(first.flag, again.flag)
    assert again.motion.joint_type == first.motion.joint_type
    assert again.motion.delta == first.motion.delta > 0
    assert again.kind == first.kind


def test_points_of_a_file_that_was_put_in_the_place_of_another_are_not_those_of_the_other(tmp_path):
    """As one from an archive, which is older than the points that are kept beside it."""
    file, other = tmp_path / "a-train-0.npz", tmp_path / "other" / "a-train-0.npz"
    other.parent.mkdir()
    write_pair(file, 1)
    write_pair(other, 2)
    (first,) = load_pairs(file)
    shutil.copyfile(other, file)
    os.utime(file, (1e9, 1e9))
    (again,) = load_pairs(file)
    (true,) = load_pairs(other)
    assert again.motion.delta != first.motion.delta
    assert again.motion.delta == true.motion.delta


@pytest.mark.parametrize("kept", [b"PK\x03\x04 damaged", b"", None], ids=["damaged", "empty", "old"])
def test_kept_points_that_cannot_be_read_are_made_anew(tmp_path, kept):
    file = tmp_path / "a-train-0.npz"
    write_pair(file, 1)
    (first,) = load_pairs(file)
    place = tmp_path / "points" / file.name
    if kept is None:
        np.savez(place, points=np.zeros(3))
    else:
        place.write_bytes(kept)
    (again,) = load_pairs(file)
    np.testing.assert_array_equal(again.place, first.place)


def test_two_trainings_that_prepare_the_same_pairs_at_a_time_do_not_meet(tmp_path, monkeypatch):
    """The other one writes while this one does: what it writes into must not be moved away from it."""
    file = tmp_path / "a-train-0.npz"
    write_pair(file, 1)
    savez, mine = np.savez, os.getpid()

    def with_another(target, **arrays):
        savez(target, **arrays)
        monkeypatch.setattr(np, "savez", savez)
        monkeypatch.setattr(os, "getpid", lambda: mine + 1)
        load_pairs(file)

    monkeypatch.setattr(np, "savez", with_another)
    (first,) = load_pairs(file)
    (again,) = load_pairs(file)
    np.testing.assert_array_equal(again.place, first.place)
    assert [path.name for path in (tmp_path / "points").iterdir()] == [file.name]


def test_the_part_is_mostly_what_moved_and_its_motion_carries_it_over(pair_folder):
    file = pair_files(pair_folder, "train")[1]  # a laptop
    (one,) = load_pairs(file)
    pools, (before, after) = one.pools(), one.part()
    assert before[pools.before.change == Change.MOVED].mean() > 0.8
    assert before[pools.before.change == Change.STATIC].mean() < 0.2
    X = one.motion.transform()
    carried = pools.before.points[before] @ X[:3, :3].T + X[:3, 3]
    gap = np.linalg.norm(carried[:, None] - pools.after.points[after][None], axis=2).min(axis=1)
    assert np.median(gap) < 0.01


def test_equal_spokes_leave_a_second_turn(tmp_path):
    write_pair(tmp_path / "a-train-0.npz", 1, spokes=3)
    (one,) = load_pairs(tmp_path / "a-train-0.npz")
    assert one.other is not None
    np.testing.assert_allclose(one.other.direction, -one.motion.direction)
    assert one.other.delta + one.motion.delta == pytest.approx(2 * np.pi / 3)
    (again,) = load_pairs(tmp_path / "a-train-0.npz")
    assert again.other is not None
    assert again.other.delta == pytest.approx(one.other.delta)


def test_pairs_of_another_version_are_refused_by_name(tmp_path):
    write_pair(tmp_path / "a-train-0.npz", 1, q=None)
    with pytest.raises(InputError, match="has no q; make it anew"):
        load_pairs(tmp_path / "a-train-0.npz")


def test_no_data_names_the_command_that_makes_it(tmp_path):
    with pytest.raises(InputError, match="s2r data pairs --split train"):
        pair_files(tmp_path, "train")


@pytest.fixture(scope="module")
def learn():
    """Torch and its exporter; the training half of this file."""
    for name in ("torch", "safetensors", "onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(name, reason="training needs the extra 'learn'")


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("motion", MOTIONS, ids=["turn", "slide"])
def test_a_varied_pair_still_moves_as_it_says(learn, cloud, motion, mirror, back):
    from s2r_host.learn.pair_loss import varied

    X = motion.transform()
    p = cloud.points[0]
    moved = replace(cloud, points=np.stack([p, p @ X[:3, :3].T + X[:3, 3]]))
    if back:
        moved, motion = exchanged(moved), replace(motion, direction=-motion.direction)
    new, (turned,), _ = varied(moved, [motion], 0.2, mirror, 1.1)
    T = turned.transform()
    np.testing.assert_allclose(new.points[0] @ T[:3, :3].T + T[:3, 3], new.points[1], atol=1e-9)


def test_the_network_sees_pairs_from_its_camera(scene, cloud):
    to_camera = facing(cloud.heading) @ (scene.before.p_camera - cloud.centre)
    assert to_camera[0] > 0.3
    assert to_camera[1] == pytest.approx(0.0, abs=1e-9)
    assert to_camera[2] == pytest.approx(scene.before.p_camera[2] - cloud.centre[2])


def test_loss_takes_the_nearer_of_two_turns_and_is_least_at_the_truth(learn, pair_folder):
    import torch

    from s2r_host.learn.pair_loss import INPUTS, batch, losses

    (one,) = load_pairs(pair_files(pair_folder, "train")[1])
    other = replace(one.motion, direction=-one.motion.direction, delta=1.0)
    rng = np.random.default_rng(0)
    data = batch([draw(replace(one, other=other), rng)], rng, vary=False)
    assert tuple(data["votes"].shape) == (1, 2, 2, POINTS, VOTES)

    def of(votes):
        class Says(torch.nn.Module):
            def forward(self, *inputs):
                assert len(inputs) == len(INPUTS)
                return votes, torch.zeros(1, 2, POINTS, 1)

            def occupied(self, beside):
                return beside[:, 0, 0]

        return losses(Says(), data)[1]

    for k in (0, 1):
        right = of(data["votes"][:, k])
        assert right["direction"] < 1e-6
        assert right["line"] < 1e-6
        assert right["state"] < 1e-6
        assert right["flow"] < 1e-6
    assert of(0.5 * (data["votes"][:, 0] + data["votes"][:, 1]))["direction"] > 0.5


@pytest.fixture(scope="module")
def trained(learn, pair_folder, tmp_path_factory):
    from rich.progress import Progress

    from s2r_host.learn.train_model import ModelSettings, train_model

    out = tmp_path_factory.mktemp("run")
    settings = ModelSettings(epochs=8, batch=3)
    with Progress(disable=True) as progress:
        return out, settings, train_model(pair_folder, out, settings, progress)


def test_network_learns_the_part_and_the_joint(trained):
    _, _, state = trained
    first, last = state["metrics"][0], state["metrics"][-1]
    assert last["part"] < 0.95 * first["part"]
    assert last["validation_part"] < first["validation_part"]
    assert last["spread"] < first["spread"]
    assert state["kinds"] == {"chest": 3, "laptop": 3}
    assert state["parameters"] < 1_000_000


def test_interrupted_training_goes_on_with_its_epochs(trained, pair_folder, tmp_path, monkeypatch):
    from rich.progress import Progress

    from s2r_host.learn import checkpoint
    from s2r_host.learn.train_model import train_model

    save, (_, settings, _) = checkpoint.save, trained

    def interrupted(*arguments):
        save(*arguments)
        raise KeyboardInterrupt

    settings = replace(settings, epochs=2)
    with Progress(disable=True) as progress:
        with monkeypatch.context() as patched:
            patched.setattr(checkpoint, "save", interrupted)
            with pytest.raises(KeyboardInterrupt):
                train_model(pair_folder, tmp_path, settings, progress)
        state = train_model(pair_folder, tmp_path, settings, progress)
    assert [row["epoch"] for row in state["metrics"]] == [1, 2]


def test_run_with_other_settings_is_refused_by_name(trained, pair_folder):
    from rich.progress import Progress

    from s2r_host.learn.train_model import train_model

    out, settings, _ = trained
    other = replace(settings, seed=settings.seed + 1, epochs=settings.epochs + 1)
    with (
        Progress(disable=True) as progress,
        pytest.raises(InputError, match=r"epochs .*, here .*; seed 0, here 1"),
    ):
        train_model(pair_folder, out, other, progress)


def test_run_with_other_validation_data_is_refused(trained, pair_folder, tmp_path):
    from rich.progress import Progress

    from s2r_host.learn.train_model import train_model

    out, settings, _ = trained
    for file in sorted(pair_folder.glob("*.npz"))[:-1]:  # the last is a validation file
        (tmp_path / file.name).write_bytes(file.read_bytes())
    with Progress(disable=True) as progress, pytest.raises(InputError, match="other validation data"):
        train_model(tmp_path, out, settings, progress)


def test_command_trains_exports_and_goes_on(learn, pair_folder, tmp_path, scene):
    import json

    from click.testing import CliRunner
    from safetensors.torch import load_file

    from s2r_host.learn.cli import train
    from s2r_host.learn.export import MOST_DIFFERENCE, PAIR, example_pair, graph_difference
    from s2r_host.learn.pair_network import PairNetwork

    args = ["model", "--data", str(pair_folder), "--out", str(tmp_path), "--epochs", "1", "--device", "cpu"]
    done = CliRunner().invoke(train, args)
    assert done.exit_code == 0, done.output
    about = json.loads((tmp_path / "about.json").read_text())
    assert about["pairs"] == 6
    assert about["onnx_difference"] < MOST_DIFFERENCE
    assert (tmp_path / "metrics.png").stat().st_size > 1000
    import torch

    network = PairNetwork().eval()
    network.load_state_dict(load_file(tmp_path / "weights.safetensors"))
    inputs = example_pair(torch.Generator().manual_seed(7))
    assert graph_difference(network, inputs, tmp_path / PAIR) < MOST_DIFFERENCE
    runtime = PairNetworkRuntime(tmp_path)
    assert runtime.about["data_sha256"] == about["data_sha256"]
    belief = runtime.belief(scene, np.random.default_rng(0))
    assert belief is None or np.isfinite(belief.opinion.turn.origin).all()
    pools = pool(scene, np.random.default_rng(0))
    found = runtime.space(pools, MOTIONS[0], pools.before.points[:7], np.random.default_rng(0))
    assert found.shape == (7,)
    assert (found > 0).all()
    assert (found < 1).all()


def test_turned_scene_gets_turned_votes(learn, tmp_path, scene):
    """The passes turn the cloud at random and the votes back: the direction must come out in the frame of the views."""
    import torch

    from s2r_host.learn.export import PAIR, write_graph
    from s2r_host.learn.pair_loss import INPUTS

    class Normals(torch.nn.Module):
        """Every point votes for its own normal as the direction of a turn, and for its own place as the foot."""

        def forward(self, x, *rest):
            kept = sum(t.flatten()[0] * 0 for t in rest)
            logit = torch.full_like(x[..., :1], 5.0) + kept
            zero = torch.zeros_like(x[..., :3])
            rest = torch.cat([zero, logit, logit, logit, logit], -1)
            return torch.cat([logit, -logit, x[..., 3:6], zero, logit, zero, logit, rest], -1), x

    from s2r_host.learn.export import example_pair, export_pair
    from s2r_host.learn.pair_network import PairNetwork

    export_pair(PairNetwork(), tmp_path, {})
    write_graph(
        Normals(),
        example_pair(torch.Generator().manual_seed(0)),
        INPUTS,
        ("votes", "feature"),
        tmp_path / PAIR,
        many=False,
    )
    pools = pool(scene, np.random.default_rng(0))
    runtime = PairNetworkRuntime(tmp_path)
    cloud = sample(pools, np.random.default_rng(5))
    votes = runtime._pass(cloud, np.random.default_rng(6))
    np.testing.assert_allclose(votes.output[:, 2:5], cloud.normals.reshape(-1, 3), atol=1e-5)
