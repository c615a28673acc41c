"""Recordings of a second, as an arm makes them while it pushes something, and what they may be used for."""

import csv

import numpy as np
import pytest
import yaml

from s2r_host.gap.config import GapConfig
from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.pipeline import analyse, load_sessions
from s2r_host.gap.regression.rows import held_inside

MODEL = """<mujoco><worldbody><body name="part">
<joint name="rail" type="slide" axis="1 0 0" frictionloss="4" damping="2"/>
<geom type="box" size="0.1 0.1 0.1" mass="2"/></body></worldbody></mujoco>"""
QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)


def stroke(folder, name: str, seconds: float, wobble_N: float, side: dict | None = None, way: int = 1):
    """Recording of a drawer pushed once, out or back; the force gauge is off by slow errors of a given size."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, seconds, 0.005)
    x = t / seconds
    q, dq = 0.1 * (10 * x**3 - 15 * x**4 + 6 * x**5), 0.1 / seconds * 30 * x**2 * (1 - x) ** 2
    q, dq = (q, dq) if way > 0 else (0.1 - q, -dq)
    slow = sum(np.sin(2 * np.pi * f * t + p) for f, p in ((0.7, 1.0), (1.9, 2.0), (3.1, 0.3)))
    tau = (
        4.0 * np.tanh(dq / 1e-3)
        + 2.0 * dq
        + 2.0 * np.gradient(dq, t)
        + wobble_N * slow
        + rng.normal(0, 0.05, len(t))
    )
    path = folder / f"{name}.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", "q.rail", "dq.rail", "tau.rail"])
        writer.writerows(zip(t, q, dq, tau, strict=True))
    path.with_suffix(".yaml").write_text(
        yaml.safe_dump({"effort": "measured", "input": "effort", "session": name, **(side or {})})
    )
    return path


def analysed(folder, paths):
    (folder / "model.xml").write_text(MODEL)
    return analyse(folder / "model.xml", paths, [], [], QUICK, lambda _: None)


def pushed(folder, seconds: float, wobble_N: float, side: dict | None = None):
    """What is said of one push."""
    return analysed(folder, [stroke(folder, "push", seconds, wobble_N, side)])


def test_a_third_of_a_second_is_too_short_and_said_so(tmp_path):
    found = pushed(tmp_path, 0.35, 0.0)
    assert found.verdict == "insufficient"
    assert any("too short" in note for note in found.notes)


@pytest.mark.parametrize(
    ("declared", "verdicts"), [(False, {"unknown", "physics_missing"}), (True, {"insufficient"})]
)
def test_errors_of_the_gauge_look_like_physics_unless_its_accuracy_is_declared(tmp_path, declared, verdicts):
    side = {"effort_sigma": {"rail": 0.6}} if declared else {}
    assert pushed(tmp_path, 2.5, 0.4, side).verdict in verdicts


def test_strokes_out_and_back_in_files_of_their_own_tell_what_one_stroke_cannot(tmp_path):
    side = {"effort_sigma": {"rail": 0.3}}
    lengths = {"out": 3.5, "back": 2.5, "again": 1.0}
    ways = {"out": 1, "back": -1, "again": 1}
    paths = [stroke(tmp_path, name, lengths[name], 0.0, side, ways[name]) for name in lengths]
    one_way = analysed(tmp_path, [paths[0], paths[2]])
    assert one_way.verdict == "insufficient"
    assert any("one way only" in note for note in one_way.notes)
    assert analysed(tmp_path, paths).verdict == "nothing_missing"


def test_of_several_strokes_stretches_are_held_out_and_of_one_or_of_there_and_back_the_end(tmp_path):
    (tmp_path / "model.xml").write_text(MODEL)
    model = RigidModel(tmp_path / "model.xml")
    out, back = (
        load_sessions(model, [stroke(tmp_path, f"way{way}", 2.0, 0.0, way=way)], 0, [])[0] for way in (1, -1)
    )
    picks = np.arange(0, len(out.t), 4)
    assert np.array_equal(held_inside(out, picks, alone=True), picks >= 0.7 * len(out.t))
    held = held_inside(out, picks, alone=False)
    slow = np.abs(out.v[picks, 0]) < 0.3 * np.abs(out.v[:, 0]).max()
    assert 0.25 < held.mean() < 0.35
    assert (held & slow).any()
    assert (~held & slow & (picks > len(out.t) // 2)).any()  # braking is learnt from as well as predicted
    both = tmp_path / "both.csv"
    lines = [(tmp_path / f"way{way}.csv").read_text().splitlines() for way in (1, -1)]
    later = [f"{float(line.split(',')[0]) + 2.0:.4f},{line.split(',', 1)[1]}" for line in lines[1][1:]]
    both.write_text("\n".join(lines[0] + later) + "\n")
    both.with_suffix(".yaml").write_text((tmp_path / "way1.yaml").read_text())
    there_and_back = load_sessions(model, [both], 0, [])[0]
    picks = np.arange(0, len(there_and_back.t), 4)
    held = held_inside(there_and_back, picks, alone=False)
    assert np.array_equal(held, picks >= 0.7 * len(there_and_back.t))
    assert back.q[-1, 0] < back.q[0, 0]


def test_a_stroke_of_a_quarter_of_a_second_beside_longer_ones_is_no_window_to_refit_on(tmp_path):
    side = {"effort_sigma": {"rail": 0.1}}
    paths = [
        stroke(tmp_path, f"{k}", s, 0.0, side, way)
        for k, (s, way) in enumerate([(3.5, 1), (2.5, -1), (0.27, 1)])
    ]
    (tmp_path / "model.xml").write_text(MODEL.replace('frictionloss="4"', 'frictionloss="0"'))
    found = analyse(tmp_path / "model.xml", paths, [], [], QUICK, lambda _: None)
    assert found.decision is not None
    assert [effect.name for effect in found.decision.effects] == ["coulomb_friction"]


def moment(folder, name, start=0.0):
    """50 rows at 10 kHz."""
    t = start + np.arange(50) * 1e-4
    rows = np.stack([t, 0.1 * t, np.full(50, 0.1), np.cos(t)], axis=1)
    path = folder / f"{name}.csv"
    np.savetxt(path, rows, delimiter=",", header="t,q.rail,dq.rail,tau.rail", comments="")
    return path


def test_a_recording_of_milliseconds_is_refused(tmp_path):
    """It left three steps to compare; held out or as a second run it ended the run as a bug."""
    (tmp_path / "model.xml").write_text(MODEL)
    path = moment(tmp_path, "blink")
    with pytest.raises(
        GapRecordingError, match=r"blink: lasts 0.0049 s, 3 steps .* 7 are needed; is 't' in s"
    ):
        load_sessions(RigidModel(tmp_path / "model.xml"), [path], 0, [])


def test_a_stretch_of_milliseconds_between_holes_is_left_out(tmp_path):
    (tmp_path / "model.xml").write_text(MODEL)
    t = np.concatenate([np.arange(20000) * 1e-4, 3.0 + np.arange(60) * 1e-4])
    rows = np.stack([t, 0.1 * np.sin(t), 0.1 * np.cos(t), np.cos(t)], axis=1)
    names = "t,q.rail,dq.rail,tau.rail"
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header=names, comments="")
    notes: list[str] = []
    (s,) = load_sessions(RigidModel(tmp_path / "model.xml"), [tmp_path / "run.csv"], 0, notes)
    assert s.t[-1] > 1.9
    assert any("run from 3 s: lasts 0.0059 s" in note and "left out" in note for note in notes)
