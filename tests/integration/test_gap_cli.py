"""``s2r gap`` from files to answer, on a world whose secret is known."""

import json
import shutil
import time

import mujoco
import numpy as np
import pytest

from s2r_host.gap.cli import run_gap
from s2r_host.gap.rig import Drive, Secret, write_case
from s2r_protocol.cli.root import main

DRIVE = Drive(duration_s=8.0)


NUMBER = (int, float)
MAYBE = (int, float, type(None))  # where nothing was simulated, or nothing could be compared
FORM = {
    "schema": int, "seed": int, "wall_s": NUMBER, "verdict": str, "where": list, "effects": list,
    "parameters_off": list, "rejected": list,
    "floor": {"q_rmse": NUMBER, "tau_rmse": NUMBER, "source": str},
    "fit": {"unit": str, "per_joint": dict}
    | {
        f"{kind}_{when}": MAYBE
        for kind in ("train", "holdout", "open_loop_holdout")
        for when in ("before", "after")
    },
    "baselines": {"sysid": {"holdout": MAYBE}, "residual_network": {"holdout": MAYBE}},
    "next_experiment": {"separates": list, "trajectory": (str, type(None)), "why": str},
}  # fmt: skip
ENTRIES = {
    "where": {"joint": str, "share": NUMBER, "regime": {"t": list, "q": list, "dq": list, "words": str}},
    "effects": {
        "name": str, "joint": str, "probability": NUMBER, "could_also_be": list, "evidence": str,
        "parameters": dict,
    },
    "parameters_off": {"name": str, "from": NUMBER, "to": NUMBER, "unit": str, "interval90": list},
    "rejected": {"name": str, "joint": str, "holdout_gain": NUMBER, "why": str},
}  # fmt: skip


def differences(form, found, place=""):
    """Keys that are not there, or hold another type than the contract's."""
    if not isinstance(form, dict):
        return [] if isinstance(found, form) else [f"{place}: {found!r}"]
    lacking = [f"{place}/{key} is not there" for key in form if key not in found]
    wrong = [differences(form[key], found[key], f"{place}/{key}") for key in form if key in found]
    return lacking + [x for each in wrong for x in each]


def contract_of(answer):
    """All in which an answer differs from the contract's form, and what it both names and rejects."""
    found = differences(FORM, answer)
    for key, form in ENTRIES.items():
        found += [x for i, entry in enumerate(answer[key]) for x in differences(form, entry, f"{key}[{i}]")]
    told = [e for key in ("effects", "parameters_off") for e in answer[key]]
    names = {name for e in told for name in (e["name"], *e.get("could_also_be", ()))}
    return found + [f"{r['name']} is named and rejected" for r in answer["rejected"] if r["name"] in names]


def gap(case, out, *more, holdout=True):
    arguments = [
        "gap",
        "--model",
        str(case["model"]),
        "--fit",
        str(case["fit"]),
        "--repeat",
        str(case["repeat"]),
    ]
    if holdout:
        arguments += ["--holdout", str(case["holdout"])]
    with pytest.raises(SystemExit) as ended:
        main([*arguments, "--out", str(out), *more])
    answer = out / "gap.json"
    return ended.value.code, json.loads(answer.read_text(encoding="utf-8")) if answer.exists() else None


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    return write_case(tmp_path_factory.mktemp("clean"), Secret(), DRIVE)


@pytest.fixture(scope="module")
def rubbed(tmp_path_factory):
    return write_case(tmp_path_factory.mktemp("rubbed"), Secret(extra={"coulomb_friction": 0.3}), DRIVE)


def test_clean_recordings_miss_nothing(clean, tmp_path):
    code, answer = gap(clean, tmp_path / "out")
    assert code == 0
    assert answer["verdict"] == "nothing_missing"
    assert answer["effects"] == []
    assert answer["floor"]["source"] == "repeat"
    assert contract_of(answer) == []
    assert answer["baselines"]["residual_network"]["holdout"] < 2.0 * answer["fit"]["holdout_before"]


@pytest.fixture(scope="module")
def named(rubbed, tmp_path_factory):
    out = tmp_path_factory.mktemp("named")
    return (*gap(rubbed, out, "--json"), out)


def test_dry_friction_is_named_with_its_size(named):
    code, answer, _ = named
    assert code == 7
    assert answer["verdict"] == "physics_missing"
    assert answer["effects"][0]["name"] == "coulomb_friction"
    assert answer["effects"][0]["joint"] == "elbow"
    assert answer["effects"][0]["parameters"]["level"]["value"] == pytest.approx(0.3, rel=0.05)


def test_the_patched_model_loads_and_predicts_better(named):
    _, answer, out = named
    model = mujoco.MjModel.from_xml_path(str(out / "model_patched.xml"))
    assert model.dof_frictionloss[0] == pytest.approx(0.3, rel=0.05)
    fit = answer["fit"]
    assert fit["open_loop_holdout_after"] < 0.2 * fit["open_loop_holdout_before"]
    assert fit["holdout_after"] < 0.5 * fit["holdout_before"]


def test_the_answer_follows_the_contract(named):
    _, answer, out = named
    assert contract_of(answer) == []
    effect = answer["effects"][0]
    low, high = effect["parameters"]["level"]["interval90"]
    assert low < effect["parameters"]["level"]["value"] < high
    assert 0.0 <= effect["probability"] <= 1.0
    assert answer["baselines"]["sysid"]["how"].startswith("mujoco.sysid: ")
    assert answer["baselines"]["sysid"]["holdout"] > answer["fit"]["holdout_after"]
    assert answer["baselines"]["refitted_parameters"]["holdout"] > answer["fit"]["holdout_after"]
    assert answer["baselines"]["residual_network"]["named_within_10_percent"]
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "baseline mujoco.sysid" in report
    assert "What is named is within 10 % of the residual network." in report
    assert "coulomb_friction" in report
    assert "https://" not in report
    assert (out / "predictions.parquet").exists()
    following = answer["next_experiment"]
    # Friction that falls with speed is dry friction where it does not fall.
    assert "no motion within the limits splits coulomb_friction from stribeck" in following["why"]
    assert following["trajectory"] is None
    assert not list(out.glob("next_experiment*"))


def test_the_answer_does_not_depend_on_the_run(rubbed, named, tmp_path):
    _, again = gap(rubbed, tmp_path / "again")
    first = dict(named[1])
    for answer in (again, first):
        answer.pop("wall_s")
    assert again == first


def test_a_wrong_mass_is_a_parameter_and_no_physics(tmp_path):
    case = write_case(tmp_path / "case", Secret(mass_factor=1.05), DRIVE)
    _, answer = gap(case, tmp_path / "out")
    assert answer["verdict"] == "parameter_off"
    assert answer["effects"] == []
    assert answer["parameters_off"][0]["name"] == "mass"
    assert answer["parameters_off"][0]["to"] == pytest.approx(1.26, rel=0.02)
    assert contract_of(answer) == []


@pytest.mark.timeout(1800)
def test_a_taken_out_effect_is_not_named_after_its_neighbour(tmp_path):
    case = write_case(tmp_path / "case", Secret(extra={"unknown_time": 0.15}), DRIVE)
    config = tmp_path / "gap.yaml"
    config.write_text("{baselines: false, next_experiment: false}", encoding="utf-8")
    _, answer = gap(case, tmp_path / "out", "--config", str(config))
    assert answer["verdict"] == "unknown"
    assert answer["effects"] == []
    assert answer["where"][0]["joint"] == "elbow"
    assert contract_of(answer) == []


def without_effort(recording, path):
    rows = recording.read_text(encoding="utf-8").splitlines()
    kept = [i for i, name in enumerate(rows[0].split(",")) if not name.startswith("tau")]
    path.write_text("\n".join(",".join(r.split(",")[i] for i in kept) for r in rows), encoding="utf-8")
    shutil.copy(recording.with_suffix(".yaml"), path.with_suffix(".yaml"))
    return path


def test_without_effort_it_asks_for_effort(clean, tmp_path):
    fit, repeat = (without_effort(clean[name], tmp_path / f"{name}.csv") for name in ("fit", "repeat"))
    case = {"model": clean["model"], "fit": fit, "repeat": repeat}
    code, answer = gap(case, tmp_path / "out", holdout=False)
    assert code == 0
    assert answer["verdict"] == "insufficient"
    assert any("record effort" in note for note in answer["notes"])
    assert contract_of(answer) == []


def test_the_seconds_told_are_those_of_the_whole_run(clean, tmp_path, monkeypatch):
    def report(*_):
        time.sleep(0.5)

    monkeypatch.setattr("s2r_host.gap.output.report.write_report", report)
    config = tmp_path / "gap.yaml"
    config.write_text("{simulate: false, baselines: false, next_experiment: false}", encoding="utf-8")
    began = time.monotonic()
    _, answer = gap(clean, tmp_path / "out", "--config", str(config))
    took = time.monotonic() - began
    assert took - 0.4 < answer["wall_s"] <= took + 0.01
    assert answer["fit"]["holdout_before"] is None
    assert contract_of(answer) == []


def test_a_joint_of_another_robot_is_refused(clean, tmp_path, capsys):
    path = tmp_path / "fit.csv"
    path.write_text(clean["fit"].read_text(encoding="utf-8").replace("elbow", "hip"), encoding="utf-8")
    code, answer = gap({**clean, "fit": path}, tmp_path / "out")
    assert code == 4
    assert answer is None
    error = capsys.readouterr().err
    assert "names a joint the model does not have (elbow)" in error
    assert "Traceback" not in error


def test_degrees_are_refused_when_they_contradict_the_command(clean, tmp_path, capsys):
    path = tmp_path / "fit.csv"
    header, *rows = clean["fit"].read_text(encoding="utf-8").splitlines()
    at = header.split(",").index("q.elbow")
    cells = [r.split(",") for r in rows]
    for c in cells:
        c[at] = f"{np.degrees(float(c[at])):.6g}"
    path.write_text("\n".join([header] + [",".join(c) for c in cells]), encoding="utf-8")
    code, _ = gap({**clean, "fit": path}, tmp_path / "out")
    assert code == 4
    assert "another unit" in capsys.readouterr().err


def test_no_recording_is_bad_usage(clean, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["gap", "--model", str(clean["model"]), "--out", str(tmp_path)])
    assert ended.value.code == 2
    assert "--fit" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--fit", "--holdout", "--repeat"])
@pytest.mark.parametrize("more", [["--seed", "1"], []])
def test_a_list_of_recordings_without_one_is_bad_usage(clean, tmp_path, capsys, option, more):
    fit = [] if option == "--fit" else ["--fit", str(clean["fit"])]
    with pytest.raises(SystemExit) as ended:
        main(["gap", "--model", str(clean["model"]), *fit, "--out", str(tmp_path / "out"), option, *more])
    assert ended.value.code == 2
    assert f"Option '{option}' requires at least one recording" in capsys.readouterr().err


@pytest.mark.parametrize("again", ["--holdout", "--repeat", "--fit"])
def test_a_recording_against_itself_is_refused(clean, tmp_path, capsys, again):
    fit, out = str(clean["fit"]), tmp_path / "out"
    with pytest.raises(SystemExit) as ended:
        main(["gap", "--model", str(clean["model"]), "--fit", fit, again, fit, "--out", str(out)])
    assert ended.value.code == 2
    assert f"'{fit}' is given twice" in capsys.readouterr().err
    assert not out.exists()


def test_a_missing_model_is_refused(clean, tmp_path):
    from s2r_host.gap.errors import GapModelError

    with pytest.raises(GapModelError, match="no such file"):
        run_gap(tmp_path / "no.xml", [clean["fit"]], [], [], None, tmp_path / "out")
