"""The push network: its input, its training and its export. Training parts need torch (extra 'learn')."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from s2r_host.learn.calibrate import Calibration, calibrate, expected_error
from s2r_host.learn.push_files import load_pushes
from s2r_host.perception import synthetic
from s2r_host.perception.affordance import WEIGHTS, PushNetworkRuntime, _best
from s2r_host.perception.errors import BadViewError, InputError
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.object_cloud import COARSE, NEIGHBOURS, POINTS, object_cloud, pyramid


@pytest.fixture(scope="module")
def frame():
    return synthetic.laptop_pair(np.random.default_rng(3)).before


@pytest.fixture(scope="module")
def cloud(frame):
    return object_cloud(frame, np.random.default_rng(0))


def test_cloud_leaves_the_table_out_and_has_the_asked_size(cloud):
    assert cloud.points.shape == (POINTS, 3)
    assert cloud.points[:, 2].min() > 0.0
    assert np.ptp(cloud.points, axis=0).max() < 0.6
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1.0, atol=1e-6)


def test_features_are_centred_and_keep_the_height(cloud):
    x = cloud.features()
    np.testing.assert_allclose(x[:, :3].mean(axis=0), 0.0, atol=1e-4)
    np.testing.assert_allclose(x[:, 6], 10 * cloud.points[:, 2], rtol=1e-5)


def test_empty_table_is_refused_by_name(frame):
    far = DepthFrame(np.full_like(frame.depth_m, 1.0), frame.K, frame.X_base_camera, None)
    nothing = far.X_base_camera.copy()
    nothing[2, 3] -= 5.0
    with pytest.raises(BadViewError, match="points lie above the table"):
        object_cloud(DepthFrame(far.depth_m, far.K, nothing, None), np.random.default_rng(0))


def test_every_point_is_its_own_first_neighbour_and_weights_sum_to_one(cloud):
    near = pyramid(cloud.points)
    assert near.down[0].shape == (COARSE[0], NEIGHBOURS)
    assert near.down[1].shape == (COARSE[1], NEIGHBOURS)
    np.testing.assert_array_equal(cloud.points[near.down[0][:, 0]], cloud.points[: COARSE[0]])
    for weight, up in zip(near.weight, near.up, strict=True):
        np.testing.assert_allclose(weight.sum(axis=1), 1.0, rtol=1e-5)
        assert up.shape == weight.shape


def test_missing_weights_name_the_command_that_makes_them(tmp_path):
    with pytest.raises(InputError, match="s2r train affordance"):
        PushNetworkRuntime(tmp_path)


def test_the_same_points_in_another_order_have_the_same_features(cloud):
    order = np.random.default_rng(1).permutation(POINTS)
    np.testing.assert_array_equal(cloud.reordered(order).features(), cloud.features()[order])


def test_flat_places_have_no_relief_and_edges_have(cloud):
    relief, bend = np.abs(cloud.shape[:, 2]), cloud.shape[:, 3]
    flat = (cloud.shape[:, 1] > 0) & (bend < 0.01)
    assert flat.mean() > 0.4
    assert np.median(relief[flat]) < 0.1  # cm
    assert np.median(relief[cloud.shape[:, 0] > 0]) > np.median(relief[flat])


def test_directions_of_one_place_are_kept_apart_and_the_best_come_first():
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(300, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    at, likelihood = rng.integers(20, size=300), rng.uniform(size=300)
    chosen = _best(at, direction, likelihood, 5, 4)
    assert len(set(at[chosen])) == 5
    assert chosen[0] == likelihood.argmax()
    for place in set(at[chosen]):
        mine = [i for i in chosen if at[i] == place]
        assert len(mine) <= 4
        cosine = direction[mine] @ direction[mine].T - np.eye(len(mine))
        assert cosine.max() < np.cos(np.radians(10))


def test_calibration_makes_promises_that_are_kept():
    rng = np.random.default_rng(0)
    logit = rng.normal(0, 3, 5000)
    truth = rng.uniform(size=5000) < 1 / (1 + np.exp(-(0.4 * logit - 1)))
    found = calibrate(logit, truth)
    assert found.slope == pytest.approx(0.4, abs=0.05)
    assert found.offset == pytest.approx(-1, abs=0.1)
    assert (
        expected_error(found.likelihood(logit), truth)
        < 0.02
        < expected_error(1 / (1 + np.exp(-logit)), truth)
    )


def test_a_logit_that_says_the_opposite_is_not_turned_round():
    logit = np.linspace(-2, 2, 100)
    assert calibrate(logit, logit < 0) == Calibration()


def write_pushes(path, k, **left_out):
    """One view of a laptop; pushes that go down are useful."""
    pair = synthetic.laptop_pair(np.random.default_rng(k))
    view, rng = pair.before, np.random.default_rng([k, 1])
    cloud = object_cloud(view, np.random.default_rng(k))
    label = 1 + pair.part_before.astype(np.uint8)
    direction = rng.normal(size=(24, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    chosen = rng.integers(POINTS, size=24)
    content = {
        "depth": np.rint(1e4 * view.depth_m).astype(np.uint16), "K": view.K, "T_base_camera": view.X_base_camera,
        "point": cloud.points[chosen],
        "direction": direction, "useful": direction[:, 2] < 0, "blocked": np.arange(24) < 2,
        "on_part": label.ravel()[cloud.pixels[chosen]] == 2, "label": label, "slides": False,
        "axis_origin": pair.motion.origin, "axis_direction": pair.motion.direction, "kind": "laptop",
    }  # fmt: skip
    np.savez(path, **{name: value for name, value in content.items() if name not in left_out})


@pytest.fixture(scope="module")
def push_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pushes")
    for k in range(6):
        write_pushes(folder / f"laptop-{'train' if k < 4 else 'validation'}-{k:05d}.npz", k)
    return folder


def test_samples_know_the_part_and_how_it_moves_and_leave_blocked_pushes_out(push_folder):
    (sample,) = load_pushes(push_folder / "laptop-train-00000.npz", 0)
    motion = synthetic.laptop_pair(np.random.default_rng(0)).motion
    assert 0.1 < sample.part.mean() < 0.9
    np.testing.assert_allclose(np.linalg.norm(sample.motion[sample.part], axis=1), 1.0, atol=1e-5)
    assert not sample.motion[~sample.part].any()
    np.testing.assert_allclose(
        sample.motion @ motion.direction, 0.0, atol=1e-5
    )  # hinges move across their axis
    assert len(sample.at) <= 22


def test_two_samplings_of_a_view_differ(push_folder):
    first, second = load_pushes(push_folder / "laptop-train-00000.npz", 0, times=2)
    assert not np.array_equal(first.cloud.pixels, second.cloud.pixels)


def test_push_data_of_an_older_version_is_refused_by_name(tmp_path):
    write_pushes(tmp_path / "old.npz", 0, label=None)
    with pytest.raises(InputError, match="has no label; make it anew"):
        load_pushes(tmp_path / "old.npz", 0)


def test_push_data_with_depth_in_metres_is_refused(tmp_path):
    write_pushes(tmp_path / "old.npz", 0)
    with np.load(tmp_path / "old.npz") as archive:
        content = dict(archive)
    np.savez(tmp_path / "old.npz", **content | {"depth": 1e-4 * content["depth"]})
    with pytest.raises(InputError, match="has depth of an older version; make it anew"):
        load_pushes(tmp_path / "old.npz", 0)


def test_what_lies_far_from_the_object_in_the_image_changes_nothing(tmp_path):
    write_pushes(tmp_path / "whole.npz", 0)
    with np.load(tmp_path / "whole.npz") as archive:
        content = dict(archive)
    seen = object_cloud(
        DepthFrame(1e-4 * content["depth"], content["K"], content["T_base_camera"], None),
        np.random.default_rng(1),
    )
    label = np.zeros(content["label"].size, np.uint8)
    label[seen.pixels] = content["label"].ravel()[seen.pixels]
    np.savez(tmp_path / "object.npz", **content | {"label": label.reshape(content["label"].shape)})
    (cropped,) = load_pushes(tmp_path / "object.npz", 0)
    assert cropped.cloud.pixels.max() < content["depth"].size / 2  # the image did become smaller
    index = cKDTree(cropped.cloud.points).query(seen.points)[0]
    assert np.quantile(index, 0.95) < 0.02
    np.testing.assert_allclose(cropped.cloud.centre, seen.centre, atol=0.01)


def has_traces(folder):
    """Whether a graph names source files of the machine it was exported on."""
    return [path.name for path in folder.glob("*.onnx") if b"stack_trace" in path.read_bytes()]


def test_the_shipped_graphs_name_no_files_of_the_machine_that_wrote_them():
    assert len(list(WEIGHTS.glob("*.onnx"))) == 3
    assert has_traces(WEIGHTS) == []


@pytest.fixture(scope="module")
def learn():
    """Torch and its exporter; the training half of this file."""
    for name in ("torch", "safetensors", "onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(name, reason="training needs the extra 'learn'")


@pytest.fixture(scope="module")
def trained(learn, push_folder, tmp_path_factory):
    from rich.progress import Progress

    from s2r_host.learn.train import TrainSettings, train_affordance

    out = tmp_path_factory.mktemp("run")
    settings = TrainSettings(epochs=12, batch=4, pushes=24, rate=5e-3)
    with Progress(disable=True) as progress:
        return out, settings, train_affordance(push_folder, out, settings, progress)


def test_network_learns_what_pushes_are_useful(trained):
    _, _, state = trained
    assert state["metrics"][-1]["validation_auc"] > 0.9
    assert state["metrics"][-1]["critic"] < state["metrics"][0]["critic"]
    assert state["metrics"][-1]["validation_part_auc"] > 0.6


def test_interrupted_training_goes_on_with_its_epochs(trained, push_folder, tmp_path, monkeypatch):
    from rich.progress import Progress

    from s2r_host.learn import checkpoint
    from s2r_host.learn.train import train_affordance

    save, (_, settings, _) = checkpoint.save, trained

    def interrupted(*arguments):
        save(*arguments)
        raise KeyboardInterrupt

    settings = replace(settings, epochs=2)
    with Progress(disable=True) as progress:
        whole = train_affordance(push_folder, tmp_path / "whole", settings, progress)
        with monkeypatch.context() as patched:
            patched.setattr(checkpoint, "save", interrupted)
            with pytest.raises(KeyboardInterrupt):
                train_affordance(push_folder, tmp_path, settings, progress)
        state = train_affordance(push_folder, tmp_path, settings, progress)
    assert [row["epoch"] for row in state["metrics"]] == [1, 2]
    untimed = [[row | {"seconds": 0.0} for row in run["metrics"]] for run in (whole, state)]
    assert untimed[0] == untimed[1]


def test_data_of_which_no_push_can_begin_is_refused(learn, push_folder, tmp_path):
    from rich.progress import Progress

    from s2r_host.learn.train import TrainSettings, train_affordance

    for file in push_folder.glob("*-train-*.npz"):
        content = dict(np.load(file))
        np.savez(tmp_path / file.name, **content | {"blocked": np.ones_like(content["blocked"])})
    with (
        Progress(disable=True) as progress,
        pytest.raises(InputError, match="none shows its part and a push"),
    ):
        train_affordance(tmp_path, tmp_path / "run", TrainSettings(epochs=1), progress)


def test_picture_of_one_epoch_shows_its_points(tmp_path, monkeypatch):
    plt = pytest.importorskip("matplotlib.pyplot")
    from s2r_host.learn.plot import plot_metrics

    names = ("critic", "part", "line", "proposal", "actionability")
    row = dict.fromkeys([*names, "validation_critic", "validation_part"], 0.7)
    row |= {"epoch": 1, "validation_auc": 0.3, "validation_part_auc": 0.6}
    monkeypatch.setattr(plt, "close", lambda figure: None)
    plot_metrics([row], tmp_path / "metrics.png")
    (left, right), _ = plt.gcf().axes, monkeypatch.undo()
    assert all(line.get_marker() == "." for line in left.get_lines())
    assert right.get_ylim()[0] <= 0.3
    plt.close("all")


def test_run_with_other_settings_is_refused_by_name(trained, push_folder):
    from rich.progress import Progress

    from s2r_host.learn.train import train_affordance

    out, settings, _ = trained
    other = replace(settings, seed=settings.seed + 1, epochs=settings.epochs + 1)
    with (
        Progress(disable=True) as progress,
        pytest.raises(InputError, match=r"epochs .*, here .*; seed 0, here 1"),
    ):
        train_affordance(push_folder, out, other, progress)


def test_run_on_other_data_is_refused(trained, push_folder, tmp_path):
    from rich.progress import Progress

    from s2r_host.learn.train import train_affordance

    out, settings, _ = trained
    for file in sorted(push_folder.glob("*.npz"))[1:]:
        (tmp_path / file.name).write_bytes(file.read_bytes())
    with Progress(disable=True) as progress, pytest.raises(InputError, match="run on other data"):
        train_affordance(tmp_path, out, settings, progress)


def test_run_with_other_validation_data_is_refused(trained, push_folder, tmp_path):
    from rich.progress import Progress

    from s2r_host.learn.train import train_affordance

    out, settings, _ = trained
    for file in sorted(push_folder.glob("*.npz"))[:-1]:  # the last is a validation file
        (tmp_path / file.name).write_bytes(file.read_bytes())
    with Progress(disable=True) as progress, pytest.raises(InputError, match="other validation data"):
        train_affordance(tmp_path, out, settings, progress)


def test_exported_network_says_the_same_as_torch_and_proposes_good_pushes(trained, frame):
    from safetensors.torch import load_file

    from s2r_host.learn.export import MOST_DIFFERENCE, export
    from s2r_host.learn.network import PushNetwork

    out, _, state = trained
    network = PushNetwork()
    network.load_state_dict(load_file(out / "weights.safetensors"))
    about = {name: state[name] for name in ("data_sha256", "calibration")}
    assert export(network, out, about) < MOST_DIFFERENCE
    assert json.loads((out / "about.json").read_text())["data_sha256"] == state["data_sha256"]
    assert has_traces(out) == []
    found = PushNetworkRuntime(out).affordance(frame, np.random.default_rng(1))
    assert 30 <= len(found.proposals) <= 100
    worth = [p.worth for p in found.proposals]
    assert worth == sorted(worth, reverse=True)
    down = np.mean([p.direction[2] < 0 for p in found.proposals[:20]])
    assert down > 0.8
