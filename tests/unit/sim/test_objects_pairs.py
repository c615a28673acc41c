"""Before/after views for training: what is stored is the object as it is, and jobs go on where they stopped."""

import numpy as np
import pytest
from click.testing import CliRunner

from s2r_sim.cli_data import data
from s2r_sim.objects.pair_data import UNIT_M, draw_states, pair_object
from s2r_sim.objects.splits import Split, draw_object


@pytest.fixture(scope="module")
def laptop(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    row = pair_object("laptop", int(Split.TRAIN), 4, str(folder))
    with np.load(folder / row["file"]) as archive:
        return row, {name: archive[name] for name in archive.files}


def test_every_state_has_a_view_and_its_part(laptop):
    row, content = laptop
    states = len(content["q"])
    assert row["states"] == states
    assert row["pairs"] == states * (states - 1) // 2
    assert content["depth"].shape == (states, 480, 672)
    part = np.unpackbits(content["part"], axis=-1).astype(bool)
    assert part.shape == content["depth"].shape
    assert (part.sum(axis=(1, 2)) > 200).all()


def test_turned_about_the_stored_joint_the_part_lands_where_it_is_seen(laptop):
    _, content = laptop
    clouds = []
    for depth, part in zip(content["depth"], np.unpackbits(content["part"], axis=-1), strict=True):
        v, u = np.nonzero(part & (depth > 0))
        z = depth[v, u] * UNIT_M
        K, X = content["K"], content["T_base_camera"]
        p = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=1)
        clouds.append(p @ X[:3, :3].T + X[:3, 3])
    axis, origin = content["axis_direction"], content["axis_origin"]
    reach = []
    for p, q in zip(clouds, content["q"], strict=True):  # in the frame of joint value 0
        c, s = np.cos(-q), np.sin(-q)
        k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        R = np.eye(3) + s * k + (1 - c) * (k @ k)
        reach.append(np.percentile((p - origin) @ R.T, [5, 95], axis=0))
    across = np.ptp(np.array(reach), axis=0)
    assert across.max() < 0.02
    assert np.abs(np.ptp(content["q"])) > 0.2


PARTS = {"laptop": 2, "faucet": 1}


@pytest.mark.parametrize("kind", ["laptop", "faucet"])
def test_drawn_errors_look_like_those_of_a_stereo_camera(tmp_path, kind):
    """Noise, holes and fattened edges: small on faces, and hardly any pixel is exact."""
    row = pair_object(kind, int(Split.TRAIN), 4, str(tmp_path), True)
    with np.load(tmp_path / row["file"]) as archive:
        depth, part, K = archive["depth"] * UNIT_M, archive["part"], archive["K"]
        X, solids = archive["T_base_camera"], archive["solids"]
    seen = np.unpackbits(part, axis=-1)[0, :, : depth.shape[-1]].astype(bool) & (depth[0] > 0)
    assert 0.6 < (depth[0] > 0).mean() < 0.999
    v, u = np.nonzero(seen)
    z = depth[0][seen]
    p = (
        np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=1) @ X[:3, :3].T
        + X[:3, 3]
    )
    inside = np.zeros(len(p), bool)
    for row in solids:
        pose = row[4:].reshape(3, 4)
        local = (p - pose[:, 3]) @ pose[:, :3]
        reach = row[1:4] if row[0] == 6 else np.array([row[1], row[1], row[2] + row[1]])
        inside |= np.all(np.abs(local) < reach + 0.006, axis=1)
    assert inside.mean() > 0.8
    assert len(solids) >= PARTS[kind]


@pytest.mark.parametrize("kind", ["chest", "laptop", "faucet", "dial"])
def test_states_lie_within_the_range_and_apart(kind):
    three = 0
    for seed in range(40):
        spec = draw_object(kind, Split.TRAIN, seed)
        least = max(0.08 * spec.q_max, 0.03 if kind == "chest" else np.deg2rad(15))
        q = draw_states(np.random.default_rng(seed), spec, least)
        assert (q >= -1e-9).all()
        assert (q <= spec.q_max + 1e-9).all()
        gap = np.abs(q[:, None] - q[None])[np.triu_indices(len(q), 1)]
        assert gap.min() >= least - 1e-9
        three += len(q) == 3
    assert three > 20


def test_command_makes_files_and_does_nothing_twice(tmp_path):
    args = ["pairs", "--kinds", "dial", "--objects", "2", "--split", "validation", "--out", str(tmp_path)]
    first = CliRunner().invoke(data, args)
    assert first.exit_code == 0, first.output
    files = sorted(tmp_path.glob("dial-validation-*.npz"))
    assert len(files) == 2
    written = [file.stat().st_mtime_ns for file in files]
    again = CliRunner().invoke(data, args)
    assert again.output.splitlines()[-1] == first.output.splitlines()[-1]
    assert [file.stat().st_mtime_ns for file in files] == written


def test_quick_views_and_others_of_one_object_lie_in_one_folder_side_by_side(tmp_path):
    words = ["pairs", "--kinds", "laptop", "--objects", "1", "--first", "4", "--out", str(tmp_path)]
    for more in (["--quick"], []):
        done = CliRunner().invoke(data, [*words, *more], catch_exceptions=False)
        assert "1 objects" in done.output
    shapes = []
    for name in ("laptop-train-00004-quick.npz", "laptop-train-00004.npz"):
        with np.load(tmp_path / name) as archive:
            shapes.append(archive["depth"].shape[1:])
    assert shapes[0] < shapes[1]
