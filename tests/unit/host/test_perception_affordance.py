"""The push network: its input, its training and its export. Training parts need torch (extra 'learn')."""

import json

import numpy as np
import pytest

from s2r_host.perception import synthetic
from s2r_host.perception.affordance import PushNetworkRuntime
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


@pytest.fixture(scope="module")
def push_folder(tmp_path_factory):
    """Six views; pushes that go down are useful."""
    folder = tmp_path_factory.mktemp("pushes")
    for k in range(6):
        view = synthetic.laptop_pair(np.random.default_rng(k)).before
        cloud = object_cloud(view, np.random.default_rng(k))
        rng = np.random.default_rng([k, 1])
        direction = rng.normal(size=(24, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        split = "train" if k < 4 else "validation"
        np.savez(
            folder / f"laptop-{split}-{k:05d}.npz", depth=view.depth_m, K=view.K,
            T_base_camera=view.X_base_camera, point=cloud.points[rng.integers(POINTS, size=24)],
            direction=direction, useful=direction[:, 2] < 0, kind="laptop",
        )  # fmt: skip
    return folder


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


def test_interrupted_training_goes_on_with_its_epochs(trained, push_folder, tmp_path):
    from dataclasses import replace

    from rich.progress import Progress

    from s2r_host.learn.train import train_affordance

    _, settings, _ = trained
    with Progress(disable=True) as progress:
        train_affordance(push_folder, tmp_path, replace(settings, epochs=1), progress)
        state = train_affordance(push_folder, tmp_path, replace(settings, epochs=2), progress)
    assert [row["epoch"] for row in state["metrics"]] == [1, 2]


def test_run_on_other_data_is_refused(trained, push_folder, tmp_path):
    from rich.progress import Progress

    from s2r_host.learn.train import train_affordance

    out, settings, _ = trained
    for file in sorted(push_folder.glob("*.npz"))[1:]:
        (tmp_path / file.name).write_bytes(file.read_bytes())
    with Progress(disable=True) as progress, pytest.raises(InputError, match="run on other data"):
        train_affordance(tmp_path, out, settings, progress)


def test_exported_network_says_the_same_as_torch_and_proposes_good_pushes(trained, frame):
    from safetensors.torch import load_file

    from s2r_host.learn.export import MOST_DIFFERENCE, export
    from s2r_host.learn.network import PushNetwork

    out, _, state = trained
    network = PushNetwork()
    network.load_state_dict(load_file(out / "weights.safetensors"))
    assert export(network, out, {"data_sha256": state["data_sha256"]}) < MOST_DIFFERENCE
    assert json.loads((out / "about.json").read_text())["data_sha256"] == state["data_sha256"]
    found = PushNetworkRuntime(out).affordance(frame, np.random.default_rng(1))
    assert len(found.proposals) == 100
    likelihood = [p.likelihood for p in found.proposals]
    assert likelihood == sorted(likelihood, reverse=True)
    down = np.mean([p.direction[2] < 0 for p in found.proposals[:20]])
    assert down > 0.8
