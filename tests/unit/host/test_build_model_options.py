"""Slips in the options of ``s2r build-model`` are told by name, before anything is loaded."""

from __future__ import annotations

import json

import click
import numpy as np
import pytest
from click.testing import CliRunner

from s2r_host.model import cli
from s2r_host.model.cli import build_model, parse_region
from s2r_host.model.errors import ModelError
from s2r_host.perception import AbstainError, estimate, several
from s2r_protocol.exits import ExitCode, UsageError


@pytest.mark.parametrize("text", ["nan,1,0,1,0,1", "0,1,0,nan,0,1", "0,1,1,0,0,1", "0,1,0,1,0"])
def test_a_region_that_is_no_box_is_refused(text):
    with pytest.raises(UsageError, match="six numbers"):
        parse_region(text)


def test_a_file_as_out_is_refused_at_once(tmp_path):
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(click.BadParameter, match="taken' is a file"):
        build_model.main(
            ["--before", "none.ply", "--after", "other.ply", "--out", str(tmp_path / "taken")],
            standalone_mode=False,
        )
    assert (tmp_path / "taken").read_text() == "mine"


def refusal(*words):
    return CliRunner().invoke(build_model, ["--before", "a.ply", "--after", "b.ply", *map(str, words)]).stderr


def test_a_result_does_not_replace_files_of_somebody_else(tmp_path):
    for name in ("object.xml", "cloud.png", "notes.txt"):
        (tmp_path / name).write_text("mine")
    assert "holds object.xml, cloud.png, not written by this command" in refusal("--out", tmp_path)
    (tmp_path / "model.json").write_text('{"layers": 3}')
    assert "holds model.json, object.xml, cloud.png" in refusal("--out", tmp_path)
    assert (tmp_path / "object.xml").read_text() == "mine"


def earlier_answer(folder):
    (folder / "meshes").mkdir(parents=True)
    for name in ("object.xml", "cloud.png", "notes.txt", "meshes/part_free3.obj", "meshes/mine.obj"):
        (folder / name).write_text("old")
    (folder / "object.urdf").write_text('<robot><mesh filename="meshes/part_free3.obj"/></robot>')
    (folder / "model.json").write_text('{"joint_type": "revolute"}')


def files_in(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def flat_views(folder):
    """Two views between which a plate came nearer: no joint that could be answered."""
    K = np.array([[70.0, 0, 40], [0, 70.0, 30], [0, 0, 1]])
    for name, z_m in (("a", 0.8), ("b", 0.7)):
        depth = np.full((60, 80), z_m, np.float32)
        np.savez(folder / f"{name}.npz", depth=depth, K=K, T_base_camera=np.eye(4))
    return ["--before", str(folder / "a.npz"), "--after", str(folder / "b.npz"), "--no-network"]


@pytest.mark.parametrize("more", [[], ["--several"]])
def test_a_refusal_takes_an_earlier_result_away_with_its_pictures_and_meshes_and_other_files_stay(
    tmp_path, more
):
    out = tmp_path / "o"
    earlier_answer(out)
    earlier_answer(out / "part_2")
    (out / "part_holder").mkdir()
    (out / "part_holder/object.xml").write_text("mine")
    said = CliRunner().invoke(build_model, [*flat_views(tmp_path), "--out", str(out), *more])
    assert said.exit_code == ExitCode.REFUSED
    others = ["meshes/mine.obj", "notes.txt"]
    assert files_in(out) == sorted(
        ["model.json", *others, *(f"part_2/{name}" for name in others), "part_holder/object.xml"]
    )


def test_what_cannot_be_used_leaves_an_earlier_result(tmp_path):
    earlier_answer(tmp_path)
    there = files_in(tmp_path)
    assert "no such file" in refusal("--out", tmp_path)
    assert files_in(tmp_path) == there


def test_a_part_folder_of_somebody_else_is_neither_emptied_nor_written_into(tmp_path):
    out = tmp_path / "o"
    (out / "part_1").mkdir(parents=True)
    (out / "part_1/object.xml").write_text("mine")
    (out / "part_1/model.json").write_text('{"layers": 3}')
    views = flat_views(tmp_path)
    assert CliRunner().invoke(build_model, [*views, "--out", str(out)]).exit_code == ExitCode.REFUSED
    said = CliRunner().invoke(build_model, [*views, "--out", str(out), "--several"])
    assert said.exit_code == ExitCode.USAGE
    assert "part_1 holds model.json, object.xml, not written by this command" in said.stderr
    assert (out / "part_1/object.xml").read_text() == "mine"


def test_a_cloud_without_a_camera_beside_a_depth_image_is_refused_by_its_option(tmp_path):
    depth, K = np.full((60, 80), 0.8, np.float32), np.array([[70.0, 0, 40], [0, 70.0, 30], [0, 0, 1]])
    np.savez(tmp_path / "a.npz", depth=depth, K=K, T_base_camera=np.eye(4))
    points = "".join(f"{x} {y} 0.8\n" for x in np.linspace(0, 0.3, 20) for y in np.linspace(0, 0.3, 20))
    head = "".join(f"property float {name}\n" for name in "xyz")
    (tmp_path / "b.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 400\n{head}end_header\n{points}")
    views = ["--before", str(tmp_path / "a.npz"), "--after", str(tmp_path / "b.ply")]
    said = CliRunner().invoke(build_model, [*views, "--out", str(tmp_path / "o")]).stderr
    assert "--after is a cloud without a camera and the other view has one" in said


@pytest.mark.parametrize("more", [[], ["--several"]])
@pytest.mark.parametrize(("frame", "told"), [("base", [0.0, 0.0, 1.0]), ("camera", None)])
def test_in_a_cameras_frame_nothing_tells_what_is_up(tmp_path, monkeypatch, frame, told, more):
    """Its z leads into the picture: hinges of a lid would be told as upright or level against that."""
    views = flat_views(tmp_path)
    given = []

    def estimated(*_, up, **__):
        given.append(up)
        raise AbstainError("asked")

    monkeypatch.setattr(estimate, "estimate_joint", estimated)
    monkeypatch.setattr(several, "estimate_joints", estimated)
    CliRunner().invoke(build_model, [*views, "--frame", frame, "--out", str(tmp_path / "o"), *more])
    assert len(given) == 1
    assert (None if given[0] is None else given[0].tolist()) == told


def test_a_part_that_cannot_be_built_takes_the_models_of_those_before_it_along(tmp_path, monkeypatch):
    def built(estimate, out, *_):
        if estimate == "second":
            raise ModelError("shows only 12 points, 200 are needed")
        out.mkdir(parents=True)
        (out / "object.xml").write_text("a model")
        (out / "model.json").write_text('{"joint_type": "prismatic"}')
        return {}

    monkeypatch.setattr(several, "estimate_joints", lambda *_, **__: ["first", "second"])
    monkeypatch.setattr(cli, "_build_one", built)
    views = [*flat_views(tmp_path), "--several"]
    said = CliRunner().invoke(build_model, [*views, "--out", str(tmp_path / "o")])
    assert said.exit_code == ExitCode.REFUSED
    assert json.loads((tmp_path / "o/model.json").read_text())["abstain"]
    assert sorted(path.name for path in (tmp_path / "o").rglob("*") if path.is_file()) == ["model.json"]


def test_a_view_is_not_replaced_by_the_picture_of_its_name(tmp_path):
    view = tmp_path / "view_before.png"
    view.write_text("depth")
    (tmp_path / "model.json").write_text('{"abstain": true}')
    said = refusal("--between", view, "--out", tmp_path)
    assert f"would replace {view}, which it is made from" in said
    assert view.read_text() == "depth"


def test_options_that_exclude_each_other_are_told_without_a_spinner(tmp_path):
    view = tmp_path / "a.ply"
    words = ["--before", str(view), "--after", str(view), "--out", str(tmp_path / "out")]
    said = CliRunner().invoke(build_model, words).stderr
    assert said.startswith("s2r build-model: --before and --after are the same file")
