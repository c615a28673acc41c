"""Long holes in a recording: nothing is interpolated across them, and what stays is still told from what is missing."""

import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.recordings.files import read_recording
from s2r_host.gap.recordings.holes import LEAST_STRETCH_ROWS, longest_bridged, stretches, unknown_rows
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.rig import write_model

DT = 0.004


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig")
    return folder, RigidModel(write_model(folder / "model.xml"))


def table(model, friction=0.0, duration=16.0, seed=0):
    """A lively motion, the effort its model needs and dry friction that the model lacks; columns of shape (rows,)."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, DT)
    tones = [(0.5, 0.43, 0.0), (0.3, 1.7, 1.0)]
    q = np.sum([a * np.sin(2 * np.pi * f * t + p) for a, f, p in tones], axis=0)
    v = np.sum([2 * np.pi * f * a * np.cos(2 * np.pi * f * t + p) for a, f, p in tones], axis=0)
    a = np.sum([-((2 * np.pi * f) ** 2) * a * np.sin(2 * np.pi * f * t + p) for a, f, p in tones], axis=0)
    u = model.inverse(q[:, None], v[:, None], a[:, None])[:, 0] + friction * np.tanh(v / 0.01)
    return {"t": t, "q.elbow": q, "dq.elbow": v, "tau.elbow": u + 0.01 * rng.normal(size=len(t))}


def write(path, columns, empty=(), rows=None):
    """Write a table; cells of the columns ``empty`` stay empty where ``rows`` holds."""
    lines = [",".join(columns)]
    for i in range(len(columns["t"])):
        blank = rows is not None and rows[i]
        lines.append(",".join("" if blank and c in empty else f"{x[i]:.8g}" for c, x in columns.items()))
    path.write_text("\n".join(lines) + "\n")
    return path


def lost(columns, start=5.0, stop=5.8):
    return (columns["t"] >= start) & (columns["t"] < stop)


def test_long_runs_of_empty_cells_are_unknown_and_short_ones_are_not():
    t = np.arange(0.0, 2.0, 0.01)
    present = np.ones(len(t), dtype=bool)
    present[20:25] = present[80:130] = False
    unknown = unknown_rows(t, present)
    assert np.flatnonzero(unknown).tolist() == list(range(80, 130))


def test_a_channel_that_is_logged_at_every_tenth_row_has_no_holes():
    t = np.arange(0.0, 4.0, 0.005)
    present = np.arange(len(t)) % 10 == 0
    assert not unknown_rows(t, present)[:-10].any()


def test_a_slow_log_may_lose_more():
    assert longest_bridged(np.arange(0.0, 9.0, 0.1)) == pytest.approx(0.5)


def test_a_recording_is_cut_at_its_holes_and_keeps_its_times(rig, tmp_path):
    _, model = rig
    columns = table(model)
    rows = lost(columns)
    rec = read_recording(write(tmp_path / "torn.csv", columns, ("q.elbow", "tau.elbow"), rows))
    pieces, notes = stretches(rec)
    assert [len(p.t) for p in pieces] == [int((columns["t"] < 5.0).sum()), int((columns["t"] >= 5.8).sum())]
    assert pieces[1].start_s == pytest.approx(5.8, abs=DT)
    assert pieces[1].t[0] == 0.0
    assert pieces[1].channels["q"]["elbow"][0] == pytest.approx(
        columns["q.elbow"][np.argmax(~rows & (columns["t"] > 5.0))]
    )
    assert "1 hole(s)" in notes[0]


def test_a_jump_of_the_stamps_is_a_hole_and_a_whole_recording_has_none(rig, tmp_path):
    _, model = rig
    columns = table(model)
    whole = read_recording(write(tmp_path / "whole.csv", columns))
    assert stretches(whole) == ([whole], [])
    keep = ~lost(columns)
    jump = read_recording(write(tmp_path / "jump.csv", {c: x[keep] for c, x in columns.items()}))
    assert len(stretches(jump)[0]) == 2


def test_a_scrap_between_two_holes_is_left_out(rig, tmp_path):
    _, model = rig
    columns = table(model)
    rows = lost(columns, 5.0, 6.0) & ~lost(columns, 5.4, 5.4 + 0.5 * LEAST_STRETCH_ROWS * DT)
    rec = read_recording(write(tmp_path / "scrap.csv", columns, ("q.elbow",), rows))
    assert len(stretches(rec)[0]) == 2


def test_scraps_on_both_sides_of_a_jump_of_the_clock_are_refused():
    t = 0.004 * np.arange(80)
    t[40:] += 1.7e9
    rec = Recording("r", t, {"q": {"a": t}}, Controller(), "measured", "effort", "s", "", ())
    with pytest.raises(
        GapRecordingError, match=r"holes take 1.7e\+09 s of its 1.7e\+09 s .*; did a clock jump"
    ):
        stretches(rec)


def test_columns_that_never_hold_numbers_together_are_refused(rig, tmp_path):
    _, model = rig
    columns = table(model)
    early = columns["t"] < 8.0
    columns["q.elbow"] = np.where(early, columns["q.elbow"], np.nan)
    columns["tau.elbow"] = np.where(early, np.nan, columns["tau.elbow"])
    with pytest.raises(GapRecordingError, match="numbers together in 0 rows"):
        read_recording(write(tmp_path / "apart.csv", columns))


@pytest.mark.parametrize(("friction", "verdict"), [(0.0, "nothing_missing"), (0.5, "physics_missing")])
def test_a_hole_in_the_middle_changes_no_answer(rig, tmp_path, friction, verdict):
    folder, model = rig
    columns = table(model, friction)
    path = write(tmp_path / "torn.csv", columns, ("q.elbow", "dq.elbow", "tau.elbow"), lost(columns))
    quick = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)
    found = analyse(folder / "model.xml", [path], [], [], quick, lambda _: None)
    assert found.verdict == verdict
    names = [e.name for e in found.decision.effects]
    assert names == ([] if friction == 0.0 else ["coulomb_friction"])
