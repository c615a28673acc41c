"""Simulated pushes: what moves, what does not, and that data jobs go on where they stopped."""

import numpy as np
import pytest

from s2r_protocol.cli.root import main
from s2r_protocol.exits import ExitCode
from s2r_sim.batch import run_jobs
from s2r_sim.objects.npz_whole import is_whole
from s2r_sim.objects.pairs import part_points
from s2r_sim.objects.push_data import push_object, with_room
from s2r_sim.objects.pushes import PushScene, useful
from s2r_sim.objects.scene import joint_truth, table_scene
from s2r_sim.objects.splits import Split, draw_object


@pytest.fixture(scope="module")
def chest():
    spec = with_room(np.random.default_rng(0), draw_object("chest", Split.TRAIN, 3))
    model = table_scene(spec).compile()
    points = part_points(model, spec.q_start)[:8]  # the front's corners
    out = np.array(joint_truth(model, spec).direction)
    face = points[points @ out > (points @ out).max() - 1e-6].mean(axis=0)
    return spec, face, out


def test_push_on_the_front_closes_the_drawer(chest):
    spec, face, out = chest
    result = PushScene(spec).push(face + 0.25 * (part_corner(spec, out) - face), -out)
    assert not result.blocked
    assert result.delta < -0.03
    assert useful("chest", result.delta)


def part_corner(spec, out):
    """A corner of the front's outer face: beside any handle in its middle."""
    points = part_points(table_scene(spec).compile(), spec.q_start)[:8]
    return points[np.argmax(points @ out)]


def test_push_along_the_front_does_not_open_it(chest):
    spec, face, out = chest
    across = np.cross(out, [0.0, 0.0, 1.0])
    assert not useful("chest", PushScene(spec).push(face + 0.2 * out, across).delta)


def test_finger_that_starts_inside_something_is_blocked(chest):
    spec, face, out = chest
    result = PushScene(spec).push(face - 0.05 * out, out)
    assert result.blocked
    assert result.delta == 0.0


def test_same_push_does_the_same(chest):
    spec, face, out = chest
    scene = PushScene(spec)
    assert scene.push(face, -out) == scene.push(face, -out)


def test_finger_may_lean_against_its_push(chest):
    spec, face, out = chest
    scene, touch = PushScene(spec), face + 0.25 * (part_corner(spec, out) - face)
    straight = scene.push(touch, -out, 0.05)
    leaning = scene.push(touch, -out, 0.05, axis=np.array([0.0, 0.0, -1.0]) * 0.8 - 0.6 * out)
    assert not leaning.blocked
    assert leaning.delta == pytest.approx(straight.delta, abs=0.004)
    # Held level along the front, it starts beside the front all the same: it touches at its tip only.
    beside = scene.push(face + 0.2 * out, -out, 0.05, axis=np.array([0.0, 0.0, -1.0]))
    assert beside.delta == 0.0
    assert scene.push(touch, -out, 0.05) == straight


@pytest.mark.parametrize(
    ("kind", "delta", "tells"), [("chest", -0.031, True), ("faucet", 0.2, False), ("faucet", -0.3, True)]
)
def test_useful_means_three_centimetres_or_fifteen_degrees(kind, delta, tells):
    assert useful(kind, delta) is tells


def test_data_job_goes_on_where_it_stopped(tmp_path):
    jobs = [("lid", 0, seed, 3, str(tmp_path)) for seed in range(2)]
    log = tmp_path / "train.jsonl"
    first = run_jobs(push_object, jobs[:1], log, 1, "objects")
    with log.open("a") as file:
        file.write('{"job": ["lid", 0, 1')  # cut short
    stamp = (tmp_path / "lid-train-00000.npz").stat().st_mtime_ns
    again = run_jobs(push_object, jobs, log, 1, "objects")
    assert len([line for line in log.read_text().splitlines() if line.endswith("}")]) == 2
    assert again[0] == first[0]
    assert (tmp_path / "lid-train-00000.npz").stat().st_mtime_ns == stamp
    with np.load(tmp_path / "lid-train-00001.npz") as content:
        assert content["point"].shape == (3, 3)
        np.testing.assert_allclose(np.linalg.norm(content["direction"], axis=1), 1.0, atol=1e-5)


def test_another_number_of_pushes_does_not_write_over_the_objects_of_before(tmp_path, capsys):
    command = ["data", "pushes", "--kinds", "lid", "--objects", "1", "--out", str(tmp_path), "--pushes"]
    for number, code in (("3", 0), ("2", ExitCode.USAGE)):
        with pytest.raises(SystemExit) as ended:
            main([*command, number])
        assert (ended.value.code or 0) == code
    assert "train.jsonl is of objects with 3 pushes, not 2: give another --out" in capsys.readouterr().err
    assert len(np.load(tmp_path / "lid-train-00000.npz")["delta"]) == 3


def test_a_file_that_was_damaged_or_removed_after_it_was_written_is_drawn_again(tmp_path, capfd):
    command = ["data", "pushes", "--kinds", "lid", "--objects", "3", "--pushes", "2", "--out", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert not ended.value.code
    cut, gone, kept = (tmp_path / f"lid-train-{seed:05d}.npz" for seed in range(3))
    stamp, whole = kept.stat().st_mtime_ns, cut.read_bytes()
    cut.write_bytes(
        whole[: len(whole) // 2] + bytes(64) + whole[len(whole) // 2 + 64 :]
    )  # as a bad disk does
    gone.unlink()
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert not ended.value.code
    assert "2 of 3 objects in" in (said := capfd.readouterr().err)
    assert "are done again: what they wrote is missing or damaged, first lid-train-00000.npz" in said
    for path in (cut, gone, kept):
        with np.load(path) as content:
            assert content["point"].shape == (2, 3)
    assert kept.stat().st_mtime_ns == stamp


@pytest.mark.parametrize("size", [0, 10, 300])
def test_what_is_cut_off_is_not_whole(tmp_path, size):
    path = tmp_path / "x.npz"
    np.savez_compressed(path, depth=np.random.default_rng(1).integers(0, 9000, (40, 40)))
    assert is_whole(path)
    path.write_bytes(path.read_bytes()[:size])
    assert not is_whole(path)
    assert not is_whole(tmp_path / "none.npz")
