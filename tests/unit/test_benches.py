"""Benches count what they say: nothing of other options, of earlier code or of another case is taken for an answer."""

import argparse
import base64
import importlib
import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

BENCH = Path(__file__).parents[1] / "bench"


@pytest.fixture
def bench(monkeypatch):
    """A bench by its name."""
    monkeypatch.syspath_prepend(str(BENCH))
    return importlib.import_module


def _main(module, monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["bench", *map(str, arguments)])
    module.main()


def _says(folder, answer, code=0):
    """A command that writes the text of ``answer`` as gap.json below ``--out``, or ends without one.

    As the gap tool does it refuses a folder that holds other files of an answer and no gap.json.
    """
    tool = folder / "tool.py"
    tool.write_text(
        "import pathlib, sys\n"
        "place = next(w for w in sys.argv if w.startswith('--out='))[6:] if any(w.startswith('--out=') "
        "for w in sys.argv) else sys.argv[sys.argv.index('--out') + 1]\n"
        f"answer, place = {answer!r}, pathlib.Path(place)\n"
        "if (place / 'patch.py').exists() and not (place / 'gap.json').exists(): sys.exit(2)\n"
        "if answer: (place / 'gap.json').write_text(answer); (place / 'patch.py').touch()\n"
        f"sys.exit({code})\n"
    )
    return [sys.executable, str(tool)]


def test_a_case_on_which_the_tool_fails_has_not_the_answer_of_the_case_before(bench, monkeypatch, tmp_path):
    concealed = bench("bench_gap_concealed")
    said = {"verdict": "unknown", "effects": [], "parameters_off": [], "where": []}
    monkeypatch.setattr(concealed, "S2R", _says(tmp_path, json.dumps(said)))
    for _ in range(2):
        assert concealed._answered(tmp_path, ("fit",), tmp_path / "gap.yaml", tmp_path) == said
    monkeypatch.setattr(concealed, "S2R", _says(tmp_path, "", 4))
    answer = concealed._answered(tmp_path, ("fit",), tmp_path / "gap.yaml", tmp_path)
    assert answer == said | {"verdict": "exit 4"}


def test_logs_without_a_second_run_are_asked_from_three_floors_on(bench):
    asked = bench("bench_gap_concealed").asked_alone
    single = {"group": "single", "clear": False}
    assert asked(single | {"strength": 3.0})
    assert not asked(single | {"strength": 1.5, "clear": True})
    assert asked({"group": "unknown", "strength": 3.0, "clear": False})
    assert not asked({"group": "pairs", "strength": 10.0, "clear": True})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rig": "two_link"}, "rig 'one_joint', not 'two_link'"),
        ({"cases": "clean=3"}, "cases"),
        ({"duration": 5.0}, "duration_s 20.0, not 5.0"),
        ({"seed": 8}, "another seed"),
        ({}, None),
    ],
)
def test_a_set_is_not_gone_on_with_under_other_options(bench, tmp_path, change, words):
    drawn_with = {"seed": 7, "rig": "one_joint", "cases": {"single": 2, "clean": 1}, "duration_s": 20.0}
    usual = {"rig": "one_joint", "cases": "single=2,clean=1", "duration": 20.0, "seed": None, "out": tmp_path}
    check = bench("bench_gap_concealed").check_asked
    if words is None:
        check(argparse.Namespace(**usual), drawn_with)
        return
    with pytest.raises(SystemExit, match=words):
        check(argparse.Namespace(**usual | change), drawn_with)


def test_every_commit_that_worked_on_a_set_is_noted(bench, monkeypatch, tmp_path):
    concealed = bench("bench_gap_concealed")
    for now in ("a", "a", "b with changes"):
        monkeypatch.setattr(concealed, "commit", lambda now=now: now)
        concealed.note_commit(tmp_path / "commit")
    assert (tmp_path / "commit").read_text() == "a\nb with changes\n"


def test_a_real_recording_that_is_declared_otherwise_is_asked_again(bench, monkeypatch, tmp_path):
    real = bench("bench_gap_real")
    for name in ("model.xml", "fit.csv"):
        (tmp_path / name).write_text("x")
    (tmp_path / "fit.yaml").write_text("effort: measured\n")
    case = argparse.Namespace(
        name="one", after=None, model=tmp_path / "model.xml", fit=[tmp_path / "fit.csv"], holdout=[], repeat=[],
        config={},
    )  # fmt: skip
    monkeypatch.setattr(real, "COMMAND", _says(tmp_path, '{"verdict": "unknown"}'))
    assert real.run_case(case, tmp_path / "out", "tool")[1] != "unchanged"
    assert real.run_case(case, tmp_path / "out", "tool")[1] == "unchanged"
    (tmp_path / "fit.yaml").write_text("effort: commanded\n")
    answer, remark = real.run_case(case, tmp_path / "out", "tool")
    assert remark != "unchanged"
    assert answer == {"verdict": "unknown"}
    asked_before = real.run_case(case, tmp_path / "out", "another tool", answered=True)
    assert asked_before == ({"verdict": "unknown"}, "as answered before")


def test_a_machine_s_page_has_its_answer_its_table_and_the_picture_that_betrays_the_effect(bench, tmp_path):
    page, shapes = bench("gap_real.page"), bench("gap_real.case")
    content = [
        base64.b64encode(cv2.imencode(".png", np.full((9, 9, 3), grey, np.uint8))[1].tobytes()).decode()
        for grey in (40, 200)
    ]
    texts = ("residual of each joint over time", "residual effort of j over position [rad], before and after")
    report = tmp_path / "answers" / "one" / "report.html"
    report.parent.mkdir(parents=True)
    report.write_text(
        "".join(
            f"<img alt='{t}' src='data:image/png;base64,{c}'>" for t, c in zip(texts, content, strict=True)
        )
    )
    number = {"value": 72.0, "unit": "1/rev"}
    effect = {
        "name": "cogging",
        "joint": "j",
        "probability": 0.98,
        "could_also_be": [],
        "parameters": {"order": number},
    }
    fit = {"unit": "rad", "effort_holdout_before": 0.2, "effort_holdout_after": 0.1}
    answer = {
        "verdict": "physics_missing", "wall_s": 4.0, "effects": [effect], "parameters_off": [], "fit": fit, "notes": [],
    }  # fmt: skip
    about = page.Page("Motor", "Source.", "BSD.", "Known.", "Given.", "Nothing.")
    one = page.Answered(argparse.Namespace(name="one"), answer, [shapes.Check("order 72", "72.0", True)])
    none = page.Answered(
        argparse.Namespace(name="two"), None, [shapes.Check("an answer", "exit code 4", False)]
    )
    made = page.write_page(about, "motor", [one, none], tmp_path / "answers", tmp_path / "docs").read_text()
    assert "cogging p 0.98: order 72 1/rev on `j`" in made
    assert "| order 72 | 72.0 | yes |" in made
    assert "No answer: exit code 4." in made
    assert "effort [N·m or N] 0.2 → 0.1" in made
    assert f"![{texts[1]}](pictures/one.png)" in made
    shown = cv2.imread(str(tmp_path / "docs" / "pictures" / "one.png"))
    assert shown is not None
    assert shown.mean() == 200.0


@pytest.mark.parametrize("machine", ["emps", "brfd", "dfki", "laas", "pr2", "rokae", "ur10e"])
def test_every_real_machine_has_a_page_that_says_where_its_recordings_come_from(bench, machine):
    real = bench("bench_gap_real")
    about = bench(f"gap_real.{machine}").PAGE
    assert set(real.FOLDERS) <= set(real.MACHINES)
    assert machine in real.MACHINES
    assert "http" in about.source
    assert about.licence.endswith(".")


def test_demos_of_another_target_are_not_counted(bench, monkeypatch, tmp_path, capsys):
    demo = bench("bench_demo")

    def run(seed, out, target, more):
        (out / f"seed-{seed:03d}").mkdir(parents=True, exist_ok=True)
        (out / f"seed-{seed:03d}" / "demo.json").write_text("{}")
        off = dict.fromkeys(("delta_first_true", "delta_true", "delta_measured", "delta_r_true"), 0.0)
        return {"seed": seed, "exit_code": 0, "wall_s": 1.0} | off

    monkeypatch.setattr(demo, "_run", run)
    _main(demo, monkeypatch, "--seeds", "1-2", "--out", tmp_path)
    assert "5 mm: 2 of 2" in capsys.readouterr().out
    _main(demo, monkeypatch, "--seeds", "1-2", "--out", tmp_path)
    with pytest.raises(SystemExit):
        _main(demo, monkeypatch, "--seeds", "1-2", "--out", tmp_path, "--target", "0.1")
    assert "target 0.15, not 0.1" in capsys.readouterr().err


def test_a_plan_bench_goes_on_after_a_line_that_was_cut_short(bench, tmp_path):
    kept, parser = bench("bench_plan_scenes").kept, argparse.ArgumentParser()
    results = tmp_path / "results.jsonl"
    assert kept(parser, results, {"--limit": 60.0}) == []
    results.write_text('{"seed": 1}\n{"seed": 2, "fam')
    assert kept(parser, results, {"--limit": 60.0}) == [{"seed": 1}]
    assert results.read_text().endswith("\n")
    with pytest.raises(SystemExit):
        kept(parser, results, {"--limit": 120.0})


@pytest.mark.parametrize("name", ["bench_pair_space", "bench_pair_belief", "bench_affordance"])
def test_rows_of_another_network_are_not_mixed_in(bench, monkeypatch, tmp_path, capsys, name):
    module = bench(name)
    weights, out = tmp_path / "weights", tmp_path / "out"
    for folder in (weights, out):
        folder.mkdir()
    (weights / "net.onnx").write_bytes(b"one")
    (out / "rows.jsonl").write_text('{"job": ["chest", 1], "result": {"kind": "chest"}}\n')
    (out / "rows.conditions.json").write_text(json.dumps({"--weights": "of another network"}))
    with pytest.raises(SystemExit):
        _main(module, monkeypatch, "--count", 0, "--weights", weights, "--out", out)
    assert "--weights 'of another network', not" in capsys.readouterr().err


def test_rows_of_another_sight_are_not_mixed_in(bench, monkeypatch, tmp_path, capsys):
    perception = bench("bench_perception")
    (tmp_path / "rows.jsonl").write_text('{"job": ["chest", 1, 1], "result": {"kind": "chest"}}\n')
    (tmp_path / "rows.conditions.json").write_text('{"--sight": "stereo"}')
    with pytest.raises(SystemExit):
        _main(perception, monkeypatch, "--count", 0, "--sight", "depth", "--out", tmp_path)
    assert "--sight 'stereo', not 'depth'" in capsys.readouterr().err


def test_route_of_a_baseline_that_was_not_named_is_refused(bench, monkeypatch, tmp_path, capsys):
    perception = bench("bench_perception")
    with pytest.raises(SystemExit) as ended:
        _main(perception, monkeypatch, "--count", 0, "--route", "geometry,baseline", "--out", tmp_path)
    assert ended.value.code == 2
    assert "needs --baseline FOLDER; train one: s2r train baseline" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_objects_of_another_seed_are_not_judged_by_this_ones_truth(bench, tmp_path):
    one, hidden = bench("gap_objects.one"), bench("gap_objects.hidden")
    effect = next(iter(hidden.HIDDEN))
    folder = one.folder_of(tmp_path, effect, 0)
    assert one.of_another_seed(tmp_path, effect, 0, 5) is None
    (tmp_path / "sealed").mkdir()
    hidden.draw(effect, 0, 5).world.save(tmp_path / "sealed" / f"{folder.name}.json")
    assert one.of_another_seed(tmp_path, effect, 0, 5) is None
    assert one.of_another_seed(tmp_path, effect, 0, 6) == folder


@pytest.mark.parametrize(
    ("name", "more"),
    [("bench_gap_arm", ()), ("bench_gap_objects", ("--seed", 1)), ("bench_planning_cost", ("--rounds", 1))],
)
def test_a_part_that_is_not_there_is_named(bench, monkeypatch, tmp_path, capsys, name, more):
    module = bench(name)
    with pytest.raises(SystemExit) as ended:
        _main(module, monkeypatch, "--out", tmp_path / "out", "--only", "nonsense", *more)
    assert ended.value.code == 2
    assert "--only names 'nonsense'" in capsys.readouterr().err


def test_fast_trials_of_other_run_options_are_not_mixed_in(bench, monkeypatch, tmp_path, capsys):
    trials = bench("fast_trials")
    (tmp_path / "results.jsonl").write_text('{"job": ["drawer", 1, 5], "result": {"kind": "drawer"}}\n')
    (tmp_path / "results.conditions.json").write_text('{"--run-options": ""}')
    with pytest.raises(SystemExit):
        _main(trials, monkeypatch, "drawer", "1-1", "--out", tmp_path, "--run-options=--without torque")
    assert "--run-options '', not '--without torque'" in capsys.readouterr().err


def test_the_friction_of_an_arm_is_read_from_a_log_of_its_torques(bench):
    friction = bench("bench_arm_friction")
    t, k = np.arange(0.0, 12.0, 0.02)[:, None], np.arange(7)
    w = 0.6 + 0.13 * k
    q, dq, ddq = 0.5 * np.sin(w * t), 0.5 * w * np.cos(w * t), -0.5 * w**2 * np.sin(w * t)
    still = friction.Motion(q, dq, ddq, np.zeros_like(q))
    links, coulomb, viscous = friction.link_torques(still), 0.4 + 0.05 * k, 0.1 + 0.1 * k
    scale = np.array([1.0, 1.0, 1.2, 1.1, 0.9, 1.3, 0.8])
    tau = links @ scale + coulomb * np.tanh(dq / friction.REVERSAL_RAD_S) + viscous * dq + 0.3
    noise = np.random.default_rng(1).normal(0.0, 0.02, tau.shape)
    found = friction.fit(friction.Motion(q, dq, ddq, tau + noise), links)
    np.testing.assert_allclose(found.coulomb_Nm, coulomb, atol=0.02)
    np.testing.assert_allclose(found.viscous_Nms_rad, viscous, atol=0.05)
    np.testing.assert_allclose(found.mass_scale, scale[2:], atol=0.02)
    np.testing.assert_allclose(found.offset_Nm, 0.3, atol=0.03)


def test_the_arm_friction_of_the_stand_in_is_what_the_real_log_tells(bench):
    friction = bench("bench_arm_friction")
    if not friction.log_file().exists():
        pytest.skip(f"no recording: {friction.log_file()} is absent (S2R_SHARED_DATA)")
    motion = friction.read_motion(friction.log_file())
    links = friction.link_torques(motion)
    bounds = friction.intervals(motion, links)[1]
    for near in friction.supported(friction.fit(motion, links), bounds):
        assert near.all()


def test_noise_of_a_plane_is_told_from_its_waves_and_its_wrong_matches(bench):
    camera = bench("bench_camera")
    rig, rng = camera.StereoRig(), np.random.default_rng(3)
    fb = rig.f_px * rig.baseline_m
    u = np.arange(rig.width) / rig.width
    exact = np.broadcast_to(fb / (40.0 + 5.0 * u), (rig.height, rig.width))
    waves = 0.1 * np.sin(2 * np.pi * 6 * u)
    d = fb / exact + waves + rng.normal(0.0, 0.07, (6, *exact.shape))
    depth = fb / d
    depth[:, 200:215, 300:400] = 0.0
    depth[:, 230:240, 300:400] = 0.5
    found = camera.noise(depth, exact, rig)
    assert found["temporal_px"] == pytest.approx(0.07, rel=0.1)
    assert found["spatial_px"] == pytest.approx(np.hypot(0.07, 0.1 / np.sqrt(2)), rel=0.1)
    assert found["spatial_mm"] == pytest.approx(
        1e3 * found["spatial_px"] * np.median(exact) ** 2 / fb, rel=0.05
    )
    assert 0.05 < found["waves_px"] < 0.15
    assert found["holes"] == pytest.approx(1500 / 120_000)
    assert found["wrong"] == pytest.approx(1000 / 120_000)


def test_a_board_that_is_seen_too_large_is_too_fat_on_that_side(bench):
    exact = np.full((480, 848), 1.3)
    exact[160:320, 300:540] = 1.0
    depth = exact.copy()
    depth[160:320, 280:300] = 0.0  # shadow on the left
    depth[160:320, 540:543] = 1.0  # three too many on the right
    depth[160:162, 300:540] = 1.3  # two too few at the top
    found = bench("bench_camera").edges(depth, exact, 1.15)
    assert {side: one["fat"] for side, one in found.items()} == {
        "left": 0,
        "right": 3,
        "top": -2,
        "bottom": 0,
    }
    assert {side: one["shadow"] for side, one in found.items()} == {
        "left": 20,
        "right": 0,
        "top": 0,
        "bottom": 0,
    }


def test_abstentions_and_wrong_types_are_infinitely_far_off_of_all_pairs(bench, capsys):
    perception = bench("bench_perception")
    about = {"kind": "faucet", "type_true": "revolute", "part_px": [500, 500], "cpu_s": 1.0}
    good = {"type": "revolute", "axis_deg": 1.0, "line_mm": 2.0, "delta_error": np.radians(-0.5)}
    good |= {"transport_mm": 1.0, "covered": {}}
    rows = [about | good for _ in range(16)]
    rows += [about | good | {"line_mm": 9.0} for _ in range(2)]
    rows += [about | {"abstained": "no motion"}, about | {"type": "prismatic"}]
    perception.print_tables(rows)
    lines = capsys.readouterr().out.splitlines()
    assert "| faucet | 20 | 0 | 1 | 18/19 | 1.00 / 1.00 | 2.00 / 4.10 |" in lines[2]
    assert lines[-1] == "| faucet | 20 | 90 % | 80 % | 90 % | 80 % | 1.00 | 9.00 | 0.50 |"
    perception.print_tables([*rows, about | {"abstained": "no motion"}])
    assert capsys.readouterr().out.splitlines()[-1].endswith("| 86 % | 76 % | 86 % | 76 % | ∞ | ∞ | ∞ |")


def test_a_slide_has_no_line_and_each_route_a_line_of_its_own(bench, capsys):
    about = {"type_true": "prismatic", "part_px": [500, 500], "cpu_s": 1.0}
    good = {"type": "prismatic", "axis_deg": 0.5, "line_mm": 3.0, "delta_error": 0.006, "transport_mm": 1.0}
    routes = {"geometry": about | good | {"covered": {}}, "network": about | {"abstained": "hardly a point"}}
    bench("bench_perception").print_tables([{"kind": "chest", "seed": 1, "routes": routes}])
    assert capsys.readouterr().out.splitlines()[-2:] == [
        "| drawer, geometry | 1 | 100 % | – | 0 % | 0 % | 0.50 | – | 6.00 |",
        "| drawer, network | 1 | 0 % | – | 0 % | 0 % | ∞ | – | ∞ |",
    ]


def test_a_push_is_meant_to_take_the_place_it_touches_along(bench):
    affordance = bench("bench_affordance")
    push = affordance.Push(np.array([0.1, 0.0, 0.3]), np.array([0.0, 1.0, 0.0]))
    lever = affordance.JointTruth("revolute", (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0, 1.0)
    drawer = affordance.JointTruth("prismatic", (0.0, 0.0, 0.0), (0.0, -np.sqrt(0.5), np.sqrt(0.5)), 0.0, 0.3)
    assert affordance.way_deg(lever, push, 0.3) == pytest.approx(0.0, abs=1e-6)
    assert affordance.way_deg(lever, push, -0.3) == pytest.approx(180.0)
    assert affordance.way_deg(drawer, push, -0.05) == pytest.approx(45.0)
    assert affordance.way_deg(lever, push, 0.0) is None


def test_a_useful_push_against_the_meant_way_is_counted_as_that(bench, capsys):
    one = {"useful": True, "delta": -0.3, "way_deg": 20.0}
    results = [one, one | {"way_deg": 170.0, "delta": 0.3}, one | {"useful": False, "way_deg": None}]
    rows = [{"kind": "faucet", "run": result} for result in results]
    directions = bench("bench_affordance").directions
    directions([("faucet", rows)])
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == "| faucet | run | 3 | 67 % (21 to 94) | 33 % (6 to 79) | 1 | 1 / 1 | 95 / 155 |"
    directions([("faucet", [{"kind": "faucet", "run": {"useful": True, "delta": 0.3}}])])  # of earlier code
    assert capsys.readouterr().out.splitlines()[-1].startswith("|---")


def test_time_of_a_command_is_that_of_what_it_starts_too(bench, tmp_path):
    timed = bench("bench_build_time")
    burn = "import time\nwhile time.process_time() < 0.3: pass\n"
    before = timed.children_cpu_s()
    outer = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {burn!r}])"
    subprocess.run([sys.executable, "-c", outer], check=True)
    assert timed.children_cpu_s() - before >= 0.3


def test_times_are_those_of_models_and_abstentions_stand_apart(bench, capsys):
    about = {"kind": "lid", "wall_s": 9.0, "pair_s": 0.4, "push_s": None}
    built = [about | {"cpu_s": cpu_s, "loads": True} for cpu_s in (5.0, 7.0, 21.0)]
    bench("bench_build_time").print_table([*built, about | {"cpu_s": 3.0, "reason": "no motion"}])
    line = capsys.readouterr().out.splitlines()[2]
    assert line.startswith(
        "| lid | 4 | 3 of 3 | 1 | 7.0 / 18.2 / 21.0 | 2 of 3 | 9.0 / 9.0 / 9.0 | 3.0 / 3.0 / 3.0 |"
    )
    assert line.endswith("| 0.4 / 0.4 / 0.4 | – |")


def test_a_hinge_out_of_its_deck_is_told_by_the_deck_s_plane(bench):
    model, rng = bench("bench_build_model"), np.random.default_rng(0)
    p = rng.uniform([0.5, -0.2, 0.0], [0.9, 0.1, 0.0], (4000, 3))
    tilt = np.radians(0.8)
    p[:, 2] = 0.718 - np.tan(tilt) * (p[:, 1] + 0.05) + rng.normal(0.0, 0.001, len(p))
    p[:150, 2] += 0.004  # keys
    normal, spread_m = model.level_plane(
        np.vstack([p, p + np.array([0.0, 0.0, 0.1])]), 0.718
    )  # and the lid above it
    assert normal == pytest.approx([0.0, np.sin(tilt), np.cos(tilt)], abs=0.001)
    assert spread_m == pytest.approx(0.001, rel=0.1)
    assert model.out_of(np.array([0.0, 1.0, 0.0]), normal) == pytest.approx(0.8, abs=0.05)


def test_the_reference_of_a_clip_that_is_not_there_is_named(bench, monkeypatch, tmp_path, capsys):
    model = bench("bench_build_model")
    monkeypatch.setattr(model, "CLIP", tmp_path / "clip")
    with pytest.raises(SystemExit):
        _main(model, monkeypatch, "--real", "--reference")
    assert f"not at {tmp_path / 'clip'}" in capsys.readouterr().err


@pytest.fixture
def opened():
    """Points of a box with its door open by 60 degrees, base frame, the camera in front; and which are the door's."""
    rng = np.random.default_rng(0)
    eye, n = np.array([-0.9, 0.1, 0.4]), 1500
    a, b = rng.uniform(size=(2, n, 1))
    s, c = np.sin(np.radians(40)), np.cos(np.radians(40))
    side = np.array([0.0, 0.2, 0.02]) + a * [0.3 * s, 0.3 * c, 0] + b * [0, 0, 0.25]
    door = np.array([0.0, 0.2, 0.02]) + a * [0.02, -0.35, 0] + b * [0, 0, 0.25]
    top = np.array([0.0, 0.2, 0.27]) + a * [0.3 * s, 0.3 * c, 0] + b * [0.35 * c, -0.35 * s, 0]
    points = np.vstack([top, top, door, side]) + rng.normal(0.0, 0.001, (4 * n, 3))
    return points, np.arange(4 * n) // n == 2, eye


def test_an_open_door_is_found_with_the_edge_it_hangs_at(bench, opened):
    points, on_door, eye = opened
    door = bench("bench_affordance_real").find_door(points, eye)
    assert np.mean(door.holds(points)[on_door]) > 0.9
    assert np.mean(door.holds(points)[~on_door]) < 0.08  # next to the hinge
    assert door.reach(np.array([[0.0, 0.2, 0.1], [0.02, -0.15, 0.1]])) == pytest.approx([0.0, 1.0], abs=0.05)
    assert door.normal @ [-1.0, 0.0, 0.0] > 0.99


def test_two_upright_planes_are_needed_for_a_door(bench, opened):
    points, _, eye = opened
    with pytest.raises(ValueError, match="1 upright planes"):
        bench("bench_affordance_real").find_door(points[: 2 * 1500 + 1500], eye)


def test_scores_that_tell_nothing_are_a_half(bench):
    told_apart = bench("bench_affordance_real").told_apart
    mask = np.array([True, True, False, False])
    assert told_apart(np.array([0.9, 0.8, 0.2, 0.1]), mask) == 1.0
    assert told_apart(np.array([0.1, 0.2, 0.8, 0.9]), mask) == 0.0
    assert told_apart(np.array([0.5, 0.5, 0.5, 0.5]), mask) == 0.5


def test_a_cloud_that_is_not_there_is_named(bench, monkeypatch, tmp_path, capsys):
    with pytest.raises(SystemExit):
        _main(
            bench("bench_affordance_real"),
            monkeypatch,
            "--cloud",
            tmp_path / "no.ply",
            "--out",
            tmp_path / "out",
        )
    assert f"--cloud {tmp_path / 'no.ply'}: no such file" in capsys.readouterr().err
