"""Drawn sets: the same seed gives the same files, the files tell nothing, the tool runs on them resumably."""

import json
import re
import shutil
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from s2r_conceal import draw
from s2r_conceal.calibrate import calibrate
from s2r_conceal.cases import draw_cases, redraw
from s2r_conceal.cli import conceal
from s2r_conceal.effects.table import EFFECTS
from s2r_conceal.errors import ConcealError, DrawError, SealError, ToolFailedError
from s2r_conceal.half_drawn import begin
from s2r_conceal.masks import Mask, rows
from s2r_conceal.plans import CLEAN_VARIANTS, GROUPS, possible
from s2r_conceal.record import active_mask, expected_of, record
from s2r_conceal.rigs import rig_named
from s2r_conceal.run import run_all, run_batched
from s2r_conceal.score_files import read_track, score_folder
from s2r_conceal.seal import Key, read_manifest, unseal
from s2r_conceal.streams import Purpose, words
from s2r_conceal.strength import Floor, Measured
from s2r_conceal.write import model_file, sidecar

COUNTS = {"single": 2, "clean": 3, "masked": 2, "insufficient": 1}
FILES = {"model.xml", *(f"{r}.{k}" for r in ("fit", "repeat", "holdout") for k in ("csv", "yaml"))}


class _Bar:
    length: int | None = 0
    steps = 0

    def update(self, n_steps):
        self.steps += n_steps


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A small set of short recordings at a low rate, without second attempts at strengths out of reach."""
    place = tmp_path_factory.mktemp("draw")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(draw, "REDRAWS", 0)
        return place, _draw(place / "one", COUNTS, 1.0)


def _draw(folder, counts, duration_s):
    return draw.draw_set(
        3, "one_joint", counts, folder, folder.with_suffix(".key"), duration_s=duration_s, substeps=2
    )


def _folders(drawn):
    return sorted((drawn[0] / "one").glob("case-*"))


def test_the_same_seed_gives_the_same_bytes(tmp_path):
    answers = [_draw(tmp_path / name, {"clean": 2}, 0.5) for name in ("one", "two")]
    assert answers[0] == answers[1]
    assert read_manifest(tmp_path / "one")["cases"] == read_manifest(tmp_path / "two")["cases"]


def test_another_seed_gives_other_cases():
    one, two = (draw_cases(seed, "one_joint", {"single": 3}, 1.0) for seed in (1, 2))
    assert not np.array_equal(one[0].machine.mass, two[0].machine.mass)


def test_every_case_has_exactly_the_neutral_files(drawn):
    folders = _folders(drawn)
    assert [f.name for f in folders] == [f"case-{i + 1:04d}" for i in range(sum(COUNTS.values()))]
    assert all({p.name for p in folder.iterdir()} == FILES for folder in folders)


def test_no_file_the_tool_gets_names_an_effect_a_mask_or_a_group(drawn):
    names = set(EFFECTS) - {"armature"}  # also an attribute of MJCF, and present in every file
    words = [*names, *GROUPS, *CLEAN_VARIANTS, "mask", "seed", "decoy", "truth"]
    for folder in _folders(drawn):
        for path in folder.iterdir():
            text = path.read_text()
            assert [w for w in words if w in text] == [], path


def test_columns_depend_on_what_is_recorded_and_not_on_what_is_hidden(drawn):
    answers, seen = drawn[1], set()
    full = ["t", "q", "dq", "tau", "q_cmd", "dq_cmd", "tau_ff"]
    for folder in _folders(drawn):
        names = [n.split(".")[0] for n in (folder / "fit.csv").open().readline().strip().split(",")]
        without_temp = [n for n in names if n != "temp"]
        hidden = "no_effort" in answers[folder.name]["masks"]
        assert without_temp == (["t", "q", "dq", "q_cmd", "dq_cmd"] if hidden else full)
        seen.add(hidden)
    assert seen == {True, False}


def test_sidecars_have_the_same_keys_in_every_case_of_a_mask(drawn):
    _, answers = drawn
    keys = set()
    for folder in _folders(drawn):
        told = yaml.safe_load((folder / "fit.yaml").read_text())
        hidden = "no_effort" in answers[folder.name]["masks"]
        assert ("effort" in told) == (not hidden)
        assert ("kp" in told["controller"]) == (not hidden)
        keys.add((hidden, tuple(told)))
    assert len(keys) == 2


def test_model_files_load_and_have_one_layout(drawn):
    layouts = set()
    for folder in _folders(drawn):
        text = (folder / "model.xml").read_text()
        assert mujoco.MjModel.from_xml_string(text).njnt == 1
        layouts.add(tuple(e.tag for e in ET.fromstring(text).iter()))
    assert len(layouts) == 1


def test_commanded_effort_follows_from_the_recorded_channels(drawn):
    for folder in _folders(drawn):
        told = yaml.safe_load((folder / "fit.yaml").read_text())
        if told.get("effort") != "commanded" or told["controller"]["type"] != "pd":
            continue
        answer = drawn[1][folder.name]
        if answer["variant"] == "parameter_off" or answer["group"] == "wrong_log":
            continue
        if {"clock_skew"} & {e["name"] for e in answer["effects"]}:
            continue
        f = read_track(folder / "fit.csv")
        kp, kd = (told["controller"][k]["joint1"] for k in ("kp", "kd"))
        asked = (
            kp * (f["q_cmd.joint1"] - f["q.joint1"])
            + kd * (f["dq_cmd.joint1"] - f["dq.joint1"])
            + f["tau_ff.joint1"]
        )
        assert asked == pytest.approx(f["tau.joint1"], abs=1e-4 * kp)


def test_answers_carry_strength_regime_floor_and_expected_verdict(drawn):
    for truth in drawn[1].values():
        assert truth["expected"]
        assert truth["floor"]["q_rmse"] > 0.0
        for effect in truth["effects"]:
            assert effect["strength"] >= 0.0
            assert {"recording", "t", "q", "dq", "words"} == set(effect["regime"])
            assert {p["unit"] for p in effect["parameters"].values()} <= set(
                EFFECTS[effect["name"]].units.values()
            )


def test_calibrated_strengths_are_near_their_targets():
    wanted = ("viscous_friction", "cogging", "coulomb_friction", "armature")
    drawn_cases = draw_cases(6, "one_joint", {"single": 28}, 2.0)
    chosen = [c for c in drawn_cases if c.effects[0].name in wanted and not c.mask.high_gain]
    assert len(chosen) >= 3
    for case, measured in zip(chosen, calibrate(chosen), strict=True):
        lifted = measured.distinct[0] < 2.5  # enlarged so that wrong parameters cannot explain it
        assert 0.9 * case.targets[0] < measured.strength[0]
        assert measured.strength[0] < 1.1 * case.targets[0] or lifted
        assert 0.0 <= measured.distinct[0] <= 1.05 * measured.strength[0]


def test_the_strength_of_a_wrong_value_is_that_of_the_value_in_the_file():
    cases = [c for c in draw_cases(8, "one_joint", {"clean": 30}, 2.0) if c.parameters_off]
    for case in cases:
        case.parameters_off[0]["relative"] = 1e-5  # so far off that the search does not get there
    motions = [c.motions for c in cases]  # before the effort of the file is fed forward
    told = calibrate(cases)
    written = [c.parameters_off[0]["relative"] for c in cases]
    for case, measured, before in zip(cases, told, motions, strict=True):
        case.motions = before
        case.parameters_off[0]["target"] = measured.off[0]  # a search for what is there changes nothing
    calibrate(cases)
    assert [c.parameters_off[0]["relative"] for c in cases] == written


def test_the_model_file_of_a_case_is_the_same_each_time():
    cases = draw_cases(8, "one_joint", {"clean": 60}, 2.0)
    built_in = [c for c in cases if any(a.name == "coulomb_friction" for a in c.in_model)]
    assert built_in
    for case in built_in:
        assert model_file(case) == model_file(case)


def test_what_is_fed_forward_is_the_effort_of_the_model_file_in_every_group():
    cases = draw_cases(8, "one_joint", {"clean": 24, "single": 6}, 1.0)
    calibrate(cases)
    fed = [c for c in cases if c.motions["fit"].tau_ff.any()]
    assert {"parameter_off", "in_model", "plain", ""} <= {c.variant for c in fed}
    for case in fed:
        model = mujoco.MjModel.from_xml_string(model_file(case))
        for passive in (model.jnt_stiffness, model.dof_damping, model.dof_frictionloss):
            passive[:] = 0.0
        data, motion = mujoco.MjData(model), case.motions["fit"]
        ddq = np.gradient(motion.dq_cmd, 1e-3, axis=0)
        for k in range(300, 700, 50):
            data.qpos, data.qvel, data.qacc = motion.q_cmd[k], motion.dq_cmd[k], ddq[k]
            mujoco.mj_inverse(model, data)
            assert data.qfrc_inverse == pytest.approx(motion.tau_ff[k], rel=1e-3, abs=1e-3), case.variant


EVERY_GROUP = {
    "single": 200,
    "clean": 300,
    "unknown": 100,
    "pairs": 100,
    "masked": 100,
    "insufficient": 60,
    "wrong_log": 60,
}


@pytest.fixture(scope="module")
def many():
    """Cases of every group, short and not yet calibrated."""
    return draw_cases(9, "one_joint", EVERY_GROUP, 1.0)


def _shows_something_built_in(text):
    return 'stiffness="0"' not in text or "actuatorfrcrange" in text or 'gravity="0 0 -9.81"' not in text


def test_what_a_model_file_shows_to_be_built_in_tells_no_group(many):
    shown = {group: [] for group in EVERY_GROUP} | {variant: [] for variant in CLEAN_VARIANTS}
    for case in many:
        found = _shows_something_built_in(model_file(case))
        shown[case.group].append(found)
        if case.group == "clean":
            shown[case.variant].append(found)
    share = np.mean([found for group in EVERY_GROUP for found in shown[group]])
    assert 0.2 < share < 0.3
    for name, found in shown.items():
        assert abs(np.mean(found) - share) < 3.0 * np.sqrt(share * (1.0 - share) / len(found)), name


def test_every_clean_case_of_its_kind_has_something_built_in(many):
    assert all(case.in_model for case in many if case.variant == "in_model")


def test_what_is_built_in_is_not_hidden_again_on_the_same_joint(many):
    both = [c for c in many if c.effects and c.in_model]
    assert len(both) > 100
    for case in both:
        assert not {(a.name, a.joint) for a in case.effects} & {(a.name, a.joint) for a in case.in_model}


def test_wrong_values_stand_beside_hidden_effects_that_can_be_told_from_them(many):
    beside = [c for c in many if c.parameters_off and c.effects]
    assert {"single", "unknown", "pairs", "masked"} == {c.group for c in beside}
    hidden = {a.name for c in beside for a in c.effects}
    assert not hidden & {"payload", "armature", "effort_scale", "gravity_tilt", "encoder_offset"}
    assert all(c.expected == ("physics_missing",) for c in beside if c.group != "unknown")


def test_a_built_in_clip_does_not_act_where_the_motion_is_to_show_nothing():
    cases = draw_cases(3, "one_joint", {"insufficient": 90}, 1.0)
    clips = [a for c in cases for a in c.in_model if a.name == "saturation"]
    assert clips
    assert all(a.values["reduction"] < 0.0 for a in clips)


def test_a_hidden_effect_has_its_strength_beside_what_is_built_in(many):
    names = ("viscous_friction", "cogging", "armature", "stribeck")
    case = next(c for c in many if c.group == "single" and c.in_model and c.effects[0].name in names)
    copies = [replace(case, effects=list(case.effects), in_model=list(case.in_model)) for _ in range(2)]
    copies[1].in_model.clear()
    beside, alone = calibrate(copies)
    assert beside.strength[0] == pytest.approx(alone.strength[0], rel=0.2)
    assert beside.strength[0] != alone.strength[0]


def test_files_without_effort_are_of_clean_machines_as_often_as_of_others(many):
    without = [c for c in many if sidecar(c, "fit")["controller"]["type"] == "position_servo"]
    clean = [c for c in without if c.group == "clean"]
    assert 0.2 < len(clean) / len(without) < 0.6
    assert {c.group for c in without} == {"clean", "masked"}
    assert all(c.mask == replace(c.mask, high_gain=True, rate_hz=250.0, dropped=0.0) for c in without)


def _case_without_effort(many, group):
    return next(c for c in many if c.group == group and c.mask.no_effort)


@pytest.mark.parametrize(
    ("seen", "distinct", "right"),
    [
        (1.0, 0.5, ["insufficient"]),
        (4.0, 1.0, ["insufficient", "physics_missing"]),  # other gains would move positions as much
        (4.0, 2.0, ["physics_missing", "insufficient"]),
    ],
)
def test_without_effort_a_name_is_right_only_where_positions_show_it(many, seen, distinct, right):
    floor = Floor(np.ones(1), np.ones(1))
    measured = Measured(floor, strength_q={0: seen}, distinct_q={0: distinct})
    assert expected_of(_case_without_effort(many, "masked"), measured) == right


def test_on_a_clean_machine_without_effort_nobody_has_to_vouch_for_what_positions_do_not_show(many):
    case = _case_without_effort(many, "clean")
    assert expected_of(case, Measured(Floor(np.ones(1), np.ones(1)))) == ["nothing_missing", "insufficient"]


def test_gains_that_are_not_told_explain_a_wrong_torque_constant():
    cases = draw_cases(7, "one_joint", {"masked": 120}, 2.0)
    scaled = [c for c in cases if c.mask.no_effort and c.effects[0].name == "effort_scale"][:1]
    (measured,) = calibrate(scaled)
    assert measured.distinct_q[0] < 0.1 * measured.distinct[0]


def test_arms_without_effort_have_commands_for_their_input():
    cases = draw_cases(1, "two_link", {"masked": 24}, 0.2)
    assert {sidecar(c, "fit")["input"] for c in cases if c.mask.no_effort} == {"q_cmd"}


def test_no_noise_comes_from_the_stream_that_its_case_was_drawn_from():
    case = draw_cases(20, "one_joint", {"clean": 1}, 0.2)[0]
    again = redraw(case, 1)
    seeds = [words(Purpose.CASE, c.seed) for c in (case, again)]
    seeds += [words(Purpose.NOISE, c.seed, k) for c in (case, again) for k in range(3)]
    seeds += [words(Purpose.FLOOR_NOISE, c.seed, k) for c in (case, again) for k in range(2)]
    first = [tuple(np.random.default_rng(seed).random(3)) for seed in seeds]
    assert len(set(first)) == len(first)
    assert (
        np.random.default_rng((20, 23, 5)).random() == np.random.default_rng((20, 23, 5, 0)).random()
    )  # why


def test_the_key_opens_the_drawn_answers(drawn):
    place, answers = drawn
    published = read_manifest(place / "one")["answers_sha256_salted"]
    opened = unseal((place / "one" / "answers.sealed").read_bytes(), Key.read(place / "one.key"), published)
    assert opened["answers"] == json.loads(json.dumps(answers))
    assert opened["files"] == read_manifest(place / "one")["cases"]


def test_a_tool_runs_over_the_set_resumably_and_is_scored(drawn, tmp_path):
    folder, key = drawn[0] / "one", drawn[0] / "one.key"
    tool = tmp_path / "tool.py"
    tool.write_text(
        "import json, pathlib, sys\n"
        "here = sorted(p.name for p in pathlib.Path('.').iterdir())\n"
        "pathlib.Path('out').mkdir()\n"
        "answer = {'verdict': 'nothing_missing', 'wall_s': 0.1, 'seen': here, 'arguments': sys.argv[1:]}\n"
        "pathlib.Path('out/gap.json').write_text(json.dumps(answer))\n"
    )
    command, bar = f"{sys.executable} {tool}", _Bar()
    first = run_all(folder, command, 2, 60.0, bar)
    assert bar.steps == bar.length == sum(COUNTS.values())
    verdict = json.loads((folder / "verdicts" / "case-0001.json").read_text())
    assert set(verdict["gap"]["seen"]) == FILES
    assert verdict["gap"]["arguments"][:4] == ["--model", "model.xml", "--fit", "fit.csv"]
    tool.write_text("raise SystemExit('must not run again')")
    assert run_all(folder, command, 1, 60.0, _Bar()) == first
    text = score_folder(folder, key, tmp_path / "score")
    assert re.search(r"\| clean: false alarms \| 0 \| 0\.00 to 0\.\d\d \| 3 \| ≤ 0\.01 \|", text), text
    assert {p.name for p in (tmp_path / "score").iterdir()} == {
        "score.md",
        "score.json",
        "score.svg",
        "answers.json",
    }


def test_a_command_with_an_open_quotation_is_named(drawn):
    with pytest.raises(ConcealError, match=r"--command .*No closing quotation"):
        run_all(drawn[0] / "one", "gap 'x", 1, 10.0, _Bar())


def test_a_tool_that_does_not_exist_is_named(drawn):
    with pytest.raises(ConcealError, match="no such program"):
        run_all(drawn[0] / "one", "no-such-tool-anywhere", 1, 10.0, _Bar())


@pytest.fixture
def interrupted(tmp_path, monkeypatch, capsys):
    """A draw of three parts of one case each that a Ctrl-C ends in the third, and one that runs through."""
    monkeypatch.setitem(draw.BATCH, "one_joint", 1)
    whole, half = tmp_path / "whole", tmp_path / "half"
    answers = _draw(whole, {"clean": 3}, 0.5)
    recorded = []

    def record_two(*arguments):
        recorded.append(arguments)
        if len(recorded) == 3:
            raise KeyboardInterrupt
        return record(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(draw, "record", record_two)
        with pytest.raises(KeyboardInterrupt):
            _draw(half, {"clean": 3}, 0.5)
    assert f"2 of 3 cases are kept in {half}; the same command goes on" in capsys.readouterr().err
    return whole, half, answers


def _drawn_again(monkeypatch):
    """Draws what is missing; how many cases are recorded."""
    count = []
    monkeypatch.setattr(draw, "record", lambda part, *rest: count.append(len(part)) or record(part, *rest))
    return count


def _bytes(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.glob("case-*/*"))}


def test_an_interrupted_draw_goes_on_to_the_same_set(interrupted, monkeypatch):
    whole, half, answers = interrupted
    key = half.with_suffix(".key")
    assert Key.read(key).unfinished
    with pytest.raises(SealError, match="draw a set first"):
        read_manifest(half)
    count = _drawn_again(monkeypatch)
    draw.draw_set(None, "one_joint", {"clean": 3}, half, key, duration_s=0.5, substeps=2)
    assert count == [1]
    assert _bytes(half) == _bytes(whole)
    assert not Key.read(key).unfinished
    assert {path.name for path in half.iterdir()} == {path.name for path in whole.iterdir()}
    manifest = read_manifest(half)
    opened = unseal((half / "answers.sealed").read_bytes(), Key.read(key), manifest["answers_sha256_salted"])
    assert opened["answers"] == json.loads(json.dumps(answers))


def test_a_recording_changed_while_the_set_is_drawn_is_not_sealed(tmp_path, monkeypatch):
    monkeypatch.setitem(draw.BATCH, "one_joint", 1)
    out = tmp_path / "set"

    def swapped(part, *rest):
        if (out / "case-0001").is_dir():
            (out / "case-0001" / "fit.csv").write_text("t,q.joint1\n0,0\n")
        return record(part, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(draw, "record", swapped)
        with pytest.raises(SealError, match=r"from case-0001 on .* changed while the set was drawn"):
            _draw(out, {"clean": 2}, 0.5)
    _draw(out, {"clean": 2}, 0.5)
    assert read_manifest(out)["cases"]["case-0001"]


def test_what_is_kept_of_an_interrupted_draw_tells_no_truth(interrupted):
    _, half, _ = interrupted
    assert {path.name for path in half.iterdir()} == {"case-0001", "case-0002", "unfinished"}
    parts = sorted((half / "unfinished").iterdir())
    assert [path.name for path in parts] == ["from-0001.sealed", "from-0002.sealed"]
    for path in parts:
        assert not any(word in path.read_bytes() for word in (b"clean", b"truths", b"case"))


def test_a_recording_changed_before_the_draw_goes_on_is_drawn_again(interrupted, monkeypatch):
    whole, half, _ = interrupted
    (half / "case-0001" / "fit.csv").write_text("t,q.joint1\n0,0\n")
    (half / "case-0001" / "hint.txt").write_text("a tool was here")
    count = _drawn_again(monkeypatch)
    _draw(half, {"clean": 3}, 0.5)
    assert count == [1, 1]
    assert _bytes(half) == _bytes(whole)


def test_an_interrupted_draw_goes_on_with_its_own_options_and_key_only(interrupted, tmp_path):
    whole, half, _ = interrupted
    key = half.with_suffix(".key")
    with pytest.raises(
        DrawError, match=r"begun with cases \{'clean': 3\}, not \{'clean': 4\}: give the same options"
    ):
        _draw(half, {"clean": 4}, 0.5)
    with pytest.raises(DrawError, match=r"begun with another seed: give the same options"):
        draw.draw_set(4, "one_joint", {"clean": 3}, half, key, duration_s=0.5, substeps=2)
    with pytest.raises(DrawError, match=r"no key file .*other\.key to go on with: name it with --key"):
        draw.draw_set(3, "one_joint", {"clean": 3}, half, tmp_path / "other.key", duration_s=0.5, substeps=2)
    with pytest.raises(
        DrawError, match=r"whole\.key opens a set that is drawn; name another file with --key"
    ):
        draw.draw_set(
            3, "one_joint", {"clean": 3}, tmp_path / "new", whole.with_suffix(".key"), duration_s=0.5
        )


def test_a_draw_that_another_version_began_is_not_gone_on_with(tmp_path):
    out, key = tmp_path / "set", tmp_path / "set.key"
    begin(out, key, 3, {"cases": {"clean": 3}})
    assert begin(out, key, None, {"cases": {"clean": 3}}).drawn_with["seed"] == 3
    body = json.loads(key.read_text())
    del body["drawn_with"]["schema"]
    key.write_text(json.dumps(body))
    with pytest.raises(
        DrawError, match=r"begun by another version, which draws other cases: draw into a new"
    ):
        begin(out, key, 3, {"cases": {"clean": 3}})


def test_a_key_inside_the_set_is_refused(tmp_path):
    with pytest.raises(DrawError, match="would lie inside"):
        draw.draw_set(1, "one_joint", {"single": 1}, tmp_path / "set", tmp_path / "set" / "key.json")


def test_an_unknown_group_is_refused_by_name():
    with pytest.raises(DrawError, match="'simple=1'"):
        draw_cases(1, "one_joint", {"simple": 1})


def test_singles_cover_every_possible_effect_before_repeating():
    names = possible(rig_named("one_joint"))
    cases = draw_cases(4, "one_joint", {"single": 3 * len(names)}, 1.0)
    pairs = [(c.effects[0].name, c.targets[0]) for c in cases]
    assert len(set(pairs)) == 3 * len(names)


def test_masks_thin_jitter_and_drop_rows():
    rng = np.random.default_rng(0)
    plain, t = rows(Mask(), 4000, 1000.0, rng)
    assert np.all(np.diff(plain) == 4)
    assert t[-1] == pytest.approx(plain[-1] / 1000.0)
    slow, _ = rows(Mask(rate_hz=20.0), 4000, 1000.0, rng)
    assert np.all(np.diff(slow) == 50)
    jittered, stamps = rows(Mask(jitter_s=0.0016), 4000, 1000.0, rng)
    assert len(np.unique(np.diff(jittered))) > 1
    assert np.all(np.diff(stamps) > 0.0)
    holed, _ = rows(Mask(dropped=0.05), 4000, 1000.0, rng)
    assert holed.size == pytest.approx(0.95 * plain.size, rel=0.02)
    _, fast = rows(Mask(clock_ppm=200.0, t0_s=5.0), 4000, 1000.0, rng)
    assert fast[0] == 5.0
    assert (fast[-1] - fast[0]) / (t[-1] - t[0]) == pytest.approx(1.0 + 2e-4)


def test_an_effect_is_at_work_where_it_contributes():
    size = np.zeros(2000)
    size[500:700] = 1.0
    size[1500] = 1.0  # a blip is no regime
    at_work = active_mask(size)
    assert at_work[500:700].all()
    assert not at_work[:460].any()
    assert not at_work[740:].any()


def test_arms_move_inside_the_travel_that_their_model_states():
    rig = rig_named("seven_joint")
    for seed in range(40):
        rng = np.random.default_rng(seed)
        model = mujoco.MjModel.from_xml_string(rig.mjcf(rig.draw(rng), [{}] * 7))
        centre, half = rig.stroke(rng)
        assert np.all(centre - half > model.jnt_range[:, 0])
        assert np.all(centre + half < model.jnt_range[:, 1])


def test_arms_are_logged_at_many_rates_and_some_without_gains():
    cases = draw_cases(1, "two_link", {"single": 24, "clean": 9}, 0.2)
    assert {c.mask.rate_hz for c in cases} >= {100.0, 250.0, 500.0, 1000.0}
    told = {c.mask.no_law: sidecar(c, "fit") for c in cases if not c.mask.no_effort}
    assert told[True]["controller"] == {"type": "none"}
    assert told[True]["input"] == "effort"
    assert set(told[False]["controller"]) >= {"kp", "kd"}
    assert not any(c.mask.no_law for c in cases if c.variant == "parameter_off")


def test_a_good_part_of_the_arms_is_described_without_friction():
    cases = draw_cases(1, "seven_joint", {"single": 20}, 0.2)
    bare = [c for c in cases if c.machine.armature[0] < 0.2]
    assert 3 <= len(bare) <= 14
    assert not any(x.any() for c in bare for x in (c.machine.coulomb, c.machine.viscous, c.told.coulomb))


def test_a_load_hangs_on_the_last_joint_and_a_tilt_belongs_to_the_first():
    cases = draw_cases(2, "two_link", {"single": 60}, 0.2)
    places = {c.effects[0].name: c.effects[0].joint for c in cases}
    assert (places["payload"], places["gravity_tilt"], places["motor_coupling"]) == (1, 0, 1)


def test_only_what_failed_is_drawn_anew_on_an_arm(monkeypatch):
    cases = draw_cases(4, "two_link", {"single": 3}, 0.2)
    seen, fine = [], iter([True, False, True, True])
    monkeypatch.setattr(draw, "calibrate", lambda some: seen.append(len(some)) or [None] * len(some))
    monkeypatch.setattr(draw, "usable", lambda case, measured: next(fine))
    monkeypatch.setattr(draw, "REDRAWS", 1)
    found, _ = draw.calibrated(cases)
    assert seen == [3, 1]
    assert [a is b for a, b in zip(found, cases, strict=True)] == [True, False, True]


def test_an_interrupted_tool_has_given_no_verdict_and_what_is_queued_is_left_alone(drawn, tmp_path):
    folder = tmp_path / "set"
    shutil.copytree(drawn[0] / "one", folder, ignore=shutil.ignore_patterns("verdicts*"))
    tool, calls = tmp_path / "tool.py", tmp_path / "calls"
    tool.write_text(f"open({str(calls)!r}, 'a').write('x')\nraise SystemExit(130)\n")
    with pytest.raises(ConcealError, match="interrupted"):
        run_all(folder, f"{sys.executable} {tool}", 1, 60.0, _Bar())
    assert not list((folder / "verdicts").iterdir())
    assert len(calls.read_text()) <= 2


ANSWERS = """
import json, pathlib, sys
pathlib.Path('out').mkdir()
pathlib.Path('out/gap.json').write_text(json.dumps({'verdict': 'nothing_missing', 'by': sys.argv[1]}))
"""


@pytest.fixture
def unasked(drawn, tmp_path):
    """A set without a verdict, and a tool that answers."""
    shutil.copytree(drawn[0] / "one", tmp_path / "set", ignore=shutil.ignore_patterns("verdicts*"))
    tool = tmp_path / "answers.py"
    tool.write_text(ANSWERS)
    return tmp_path / "set", f"{sys.executable} {tool}"


def _run(folder, command, *options):
    return CliRunner().invoke(conceal, ["run", str(folder), "--command", command, *options])


def test_a_tool_that_fails_on_every_case_has_given_no_verdicts_and_another_may_be_run(unasked):
    folder, tool = unasked
    with pytest.raises(ToolFailedError, match=r"8 of 8 cases: the tool ended without gap\.json \(exit 1\)"):
        run_all(folder, "false", 2, 60.0, _Bar())
    assert ToolFailedError.exit_code == 4
    assert not (folder / "verdicts.json").exists()
    assert "verdicts hashed" in _run(folder, tool + " a").output


def test_cases_where_the_tool_failed_are_counted_and_run_again_until_the_verdicts_are_hashed(
    unasked, tmp_path
):
    folder, _ = unasked
    tool, trap = tmp_path / "tool.py", tmp_path / "trap"
    tool.write_text(
        f"import os, pathlib\nif not pathlib.Path({str(trap)!r}).exists():\n"
        f"    pathlib.Path({str(trap)!r}).touch()\n    raise SystemExit(3)\n" + ANSWERS
    )
    ended = _run(folder, f"{sys.executable} {tool} a")
    assert ended.exit_code == 0, ended.output
    assert "1 of 8 cases: the tool ended without gap.json (exit 3)" in ended.output
    assert "running: 1 of 8\n" in ended.stderr  # nobody sees a bar here
    assert "running: 8 of 8\n" in ended.stderr
    (folder / "verdicts.json").unlink()  # as if it had been interrupted before
    assert "ended without" not in _run(folder, f"{sys.executable} {tool} a").output


def test_verdicts_of_two_commands_are_not_mixed(unasked, drawn, tmp_path):
    folder, tool = unasked
    _run(folder, tool + " a")
    refused = _run(folder, tool + " b")
    assert isinstance(refused.exception, ConcealError)
    assert refused.exception.exit_code == 2
    assert " a', not " in str(refused.exception)
    verdict = json.loads((folder / "verdicts" / "case-0001.json").read_text())
    assert verdict["command"] == f"{tool} a"
    (folder / "verdicts.json").unlink()
    for path in folder.glob("verdicts/*.json"):  # as versions wrote them that kept no command
        old = {k: v for k, v in json.loads(path.read_text()).items() if k not in ("command", "config_sha256")}
        path.write_text(json.dumps(old))
    assert "verdicts hashed" in _run(folder, tool + " b").output
    assert "false alarms" in score_folder(folder, drawn[0] / "one.key", tmp_path / "score")


ANSWERS_ALL = """
import json, pathlib, sys
for job in json.loads(pathlib.Path('jobs.json').read_text()):
    gap = pathlib.Path('out', job['name'], 'gap.json')
    if not gap.exists():
        gap.parent.mkdir(parents=True)
        gap.write_text(json.dumps({'verdict': 'nothing_missing', 'by': sys.argv[1]}))
"""


def test_a_tool_may_say_what_is_not_utf_8(unasked, tmp_path):
    folder, _ = unasked
    tool = tmp_path / "latin.py"
    said = "import sys\nfor out in (sys.stdout, sys.stderr):\n    out.buffer.write('größer\\n'.encode('latin-1'))\n"
    tool.write_text(said + ANSWERS)
    run_all(folder, f"{sys.executable} {tool} a", 2, 60.0, _Bar())
    verdict = json.loads((folder / "verdicts" / "case-0001.json").read_text())
    assert verdict["stderr_tail"] == "gr\ufffd\ufffder\n"


def test_a_batch_may_say_what_is_not_utf_8(unasked, tmp_path):
    folder, _ = unasked
    tool = tmp_path / "latin.py"
    tool.write_text("import sys\nsys.stderr.buffer.write('größer'.encode('latin-1'))\n")
    with pytest.raises(ConcealError, match="left case-0001 without an answer: gr\ufffd\ufffder; start again"):
        run_batched(folder, f"{sys.executable} {tool}", 1, 60.0, _Bar())


def test_answers_of_one_command_are_not_taken_for_those_of_another(unasked):
    folder, _ = unasked
    tool = folder.parent / "all.py"
    tool.write_text(ANSWERS_ALL)
    for name in ("a", "b"):
        assert "verdicts hashed" in _run(folder, f"{sys.executable} {tool} {name}", "--batch").output
        verdict = json.loads((folder / "verdicts" / "case-0001.json").read_text())
        assert verdict["gap"]["by"] == name
        shutil.rmtree(folder / "verdicts")  # as a refusal says, to run another tool
        (folder / "verdicts.json").unlink()
