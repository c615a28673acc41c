"""The baseline in the manner of Ditto: shapes, what it is asked to tell, that it learns, and its refusals."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra 'learn'")
pytest.importorskip("safetensors", reason="needs the extra 'learn'")

from s2r_host.learn.baseline import BaselineRuntime, in_views, mean_joint  # noqa: E402
from s2r_host.learn.baseline_draws import (  # noqa: E402
    QUERIES,
    baseline_batch,
    draw_plain,
    in_cube,
    true_joint,
)
from s2r_host.learn.baseline_loss import baseline_losses  # noqa: E402
from s2r_host.learn.baseline_network import (  # noqa: E402
    JOINT,
    PART,
    SIZES,
    SLIDES,
    BaselineNetwork,
    Size,
)
from s2r_host.learn.pair_files import load_pairs, pair_files  # noqa: E402
from s2r_host.learn.pair_loss import INPUTS, varied  # noqa: E402
from s2r_host.learn.planes_grids import GRID, PLANES, look_up, put  # noqa: E402
from s2r_host.perception.errors import InputError  # noqa: E402
from s2r_host.perception.pair_votes import errors  # noqa: E402
from s2r_sim.objects.pair_data import pair_object  # noqa: E402
from s2r_sim.objects.splits import Split  # noqa: E402

BENCH = Path(__file__).parents[2] / "bench"
TINY = Size(96, (32, 16), 8, 16, 16, 16, 2, 16, 8, 2, 8, 8, 2)


@pytest.fixture(scope="module")
def pair_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    for kind, split in (("laptop", Split.TRAIN), ("chest", Split.TRAIN), ("laptop", Split.VALIDATION)):
        pair_object(kind, int(split), 0, str(folder), quick=True)
    return folder


@pytest.fixture(scope="module")
def pairs(pair_folder):
    """A slide and a turn."""
    return [load_pairs(file)[0] for file in pair_files(pair_folder, "train")]


@pytest.fixture(scope="module")
def data(pairs):
    rng = np.random.default_rng(0)
    return baseline_batch([draw_plain(one, TINY, rng) for one in pairs], rng, vary=False)


def test_network_tells_of_every_place_in_the_first_view(data):
    network = BaselineNetwork(TINY)
    planes, grid = network(*(data[name] for name in INPUTS))
    assert [tuple(m.shape) for m in planes] == [(2, 16, 16, 16)] * 3
    assert tuple(grid.shape) == (2, 16, 8, 8, 8)
    assert tuple(network.joint(planes, data["x"][:, 0]).shape) == (2, TINY.points, JOINT)
    assert tuple(network.occupied(grid, data["query"]).shape) == (2, QUERIES)


def test_grid_of_the_published_size_has_its_number_of_weights():
    """16.5 million in the U-Net over the grid, as counted in the published code."""
    network = BaselineNetwork(SIZES["ditto"])
    assert sum(p.numel() for p in network.grid.parameters()) == pytest.approx(16.5e6, rel=0.01)
    assert sum(p.numel() for p in BaselineNetwork(SIZES["small"]).parameters()) < 1e6


@pytest.mark.parametrize("axes", [*PLANES, GRID])
def test_what_is_put_at_a_place_is_found_there_and_nowhere_else(axes):
    p = torch.tensor([[[0.3, -0.5, 0.8], [-0.7, 0.1, -0.2]]])
    maps = put(torch.tensor([[[1.0, 0.0], [0.0, 1.0]]]), p, axes, 8)
    middle = (torch.floor((p + 1) / 2 * 8) + 0.5) / 8 * 2 - 1
    np.testing.assert_allclose(look_up(maps, middle, axes)[0].numpy(), np.eye(2), atol=1e-5)


@pytest.mark.parametrize("back", [False, True])
def test_joint_that_is_told_rightly_comes_out_as_it_is(pairs, back):
    for k, one in enumerate(pairs):
        drawn = draw_plain(one, TINY, np.random.default_rng(k), back)
        cloud, (motion, *_), _ = varied(drawn.cloud, drawn.motions, 0.0, False, 1.0)
        half_m = in_cube(cloud.points, cloud)[1]
        told = true_joint(cloud.points[0], motion, half_m)
        told[:, PART] = np.where(drawn.part, 4.0, -4.0)
        told[:, SLIDES] = 4.0 if motion.joint_type == "prismatic" else -4.0
        joint = mean_joint(cloud, told, half_m)
        assert joint is not None
        found = in_views(joint, drawn.cloud)
        assert found.joint_type == drawn.motions[0].joint_type
        angle, line, delta = errors(found, drawn.motions[0], drawn.cloud.centre)
        assert angle < 1e-3
        assert abs(delta) < 1e-5
        assert line < 1e-3 or found.joint_type == "prismatic"


def test_first_view_of_an_exchanged_pair_is_the_second(pairs):
    for one in pairs:
        drawn = draw_plain(one, TINY, np.random.default_rng(1), back=True)
        chosen = drawn.cloud.chosen[0]
        np.testing.assert_allclose(drawn.cloud.points[0], one.pools().after.points[chosen], atol=1e-6)
        np.testing.assert_array_equal(drawn.part, one.part()[1][chosen])
        X, back = one.motion.transform(), drawn.motions[0].transform()
        np.testing.assert_allclose(back @ X, np.eye(4), atol=1e-9)


def test_no_point_of_a_part_is_no_joint(pairs):
    drawn = draw_plain(pairs[0], TINY, np.random.default_rng(0))
    told = np.full((TINY.points, JOINT), -1.0)
    assert mean_joint(drawn.cloud, told, 1.0) is None


def test_a_few_steps_on_one_batch_lower_the_loss(data):
    torch.manual_seed(0)
    network = BaselineNetwork(TINY)
    optimiser = torch.optim.AdamW(network.parameters(), lr=3e-3)
    totals, parts = [], []
    for _ in range(25):
        total, part, _ = baseline_losses(network, data)
        optimiser.zero_grad()
        total.backward()
        optimiser.step()
        totals.append(total.item())
        parts.append(part)
    assert totals[-1] < 0.7 * totals[0]
    for name in ("part", "type", "direction", "state"):
        assert parts[-1][name] < parts[0][name], name


@pytest.fixture
def tiny(monkeypatch):
    """Small is smaller still."""
    monkeypatch.setitem(SIZES, "small", TINY)


def test_command_trains_goes_on_and_its_weights_give_a_joint(
    pair_folder, tmp_path, tiny, monkeypatch, capsys
):
    from click.testing import CliRunner

    from s2r_host.learn.cli import train

    run, out = tmp_path / "run", tmp_path / "out"
    args = ["baseline", "--data", str(pair_folder), "--out", str(run), "--epochs", "2"]
    done = CliRunner().invoke(train, args)
    assert done.exit_code == 0, done.output
    state = json.loads((run / "state.json").read_text())
    assert [row["epoch"] for row in state["metrics"]] == [1, 2]
    assert state["settings"]["size"] == "small"
    assert len(state["data_sha256"]) == 64
    assert (run / "metrics.png").stat().st_size > 1000
    again = CliRunner().invoke(train, args)
    assert again.exit_code == 0, again.output
    assert len(json.loads((run / "state.json").read_text())["metrics"]) == 2
    other = CliRunner().invoke(train, [*args, "--size", "ditto"])
    assert isinstance(other.exception, InputError)
    assert "size small, here ditto" in str(other.exception)

    monkeypatch.syspath_prepend(str(BENCH))
    bench = importlib.import_module("bench_perception")
    options = ["--kinds", "laptop", "--split", "validation", "--first", "1", "--count", "1", "--json"]
    options += ["--route", "baseline", "--baseline", str(run), "--out", str(out)]
    monkeypatch.setattr("sys.argv", ["bench", *options])
    bench.main()
    (row,) = json.loads(capsys.readouterr().out)
    found = row["routes"]["baseline"]
    assert "abstained" in found or found["type"] in ("revolute", "prismatic")
    conditions = json.loads((out / "routes.conditions.json").read_text())
    assert conditions["--baseline"] == bench.weights_hash(run, "weights.safetensors")
    (out / "routes.conditions.json").write_text(json.dumps(conditions | {"--baseline": "another"}))
    with pytest.raises(SystemExit):
        bench.main()
    assert "--baseline 'another', not" in capsys.readouterr().err


def test_missing_weights_name_the_command_that_makes_them(tmp_path):
    with pytest.raises(InputError, match=r"weights.safetensors is missing.*s2r train baseline"):
        BaselineRuntime(tmp_path)


def test_weights_of_another_network_are_no_baseline(tmp_path):
    (tmp_path / "weights.safetensors").write_bytes(b"")
    (tmp_path / "state.json").write_text('{"settings": {"epochs": 16}}')
    with pytest.raises(InputError, match="holds no baseline: its size is None, known are small, ditto"):
        BaselineRuntime(tmp_path)
