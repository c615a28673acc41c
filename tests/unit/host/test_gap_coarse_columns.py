"""A column that is logged more rarely than the rows costs the rows between its numbers; it makes no physics."""

import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.recordings.files import read_recording
from s2r_host.gap.rig import Drive, Secret, simulate, write_model, write_recording

QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)
DRIVE = Drive(duration_s=10.0)
THIN = 4  # 250 rows per second
RECORDINGS = (("fit", 0), ("repeat", 0), ("holdout", 1))
T = np.arange(0.0, 4.0, 0.01)


@pytest.fixture(scope="module")
def clean():
    made = {
        name: simulate(Secret(friction=0.3), DRIVE, motion, seed)
        for seed, (name, motion) in enumerate(RECORDINGS)
    }
    return {name: {column: x[::THIN] for column, x in columns.items()} for name, columns in made.items()}


def leave(path, column, every, first=0):
    """Empty the cells of a column but those of every so many rows."""
    head, *lines = path.read_text().splitlines()
    k = head.split(",").index(column)
    rows = [line.split(",") for line in lines]
    for i, row in enumerate(rows):
        if i % every != first:
            row[k] = ""
    path.write_text("\n".join([head, *(",".join(row) for row in rows)]) + "\n")
    return path


@pytest.mark.parametrize(
    ("column", "every", "rate"),
    [
        ("tau.elbow", 12, "20.8"),
        ("q.elbow", 5, "50"),
        ("tau.elbow", 5, "50"),
        ("q_cmd.elbow", 12, "20.8"),
    ],
)
def test_a_clean_recording_with_a_coarse_column_stays_clean(clean, tmp_path, column, every, rate):
    model = write_model(tmp_path / "model.xml", 0.3)
    paths = [
        leave(write_recording(tmp_path / f"{n}.csv", clean[n], DRIVE), column, every) for n, _ in RECORDINGS
    ]
    found = analyse(model, paths[:1], paths[2:], paths[1:2], QUICK, lambda _: None)
    assert found.verdict == "nothing_missing"
    assert found.problem is not None
    assert found.problem.floor_source == "repeat"
    assert any(
        f"fit: column '{column}' holds numbers in" in n and f", {rate} per second" in n for n in found.notes
    )


def table(path, **columns):
    lines = [
        ",".join("" if np.isnan(x) else f"{x:.9g}" for x in row)
        for row in zip(*columns.values(), strict=True)
    ]
    path.write_text("\n".join([",".join(columns).replace("__", "."), *lines]) + "\n")
    return path


def every(x, step, first=0):
    return np.where(np.arange(len(x)) % step == first, x, np.nan)


def test_the_rows_of_the_coarsest_column_are_compared(tmp_path):
    path = table(
        tmp_path / "r.csv", t=T, q__a=np.sin(T), tau__a=every(np.cos(T), 5), temp__a=every(20.0 + T, 7)
    )
    rec = read_recording(path)
    assert rec.t == pytest.approx(T[::5])
    assert np.array_equal(rec.channels["q"]["a"], np.array([float(f"{x:.9g}") for x in np.sin(T[::5])]))
    assert rec.channels["temp"]["a"][:-2] == pytest.approx(20.0 + T[::5][:-2])
    assert (
        "column 'tau.a' holds numbers in 80 of 400 rows, 20 per second: only these rows are compared"
        in rec.warnings
    )
    assert "sampled at 20 Hz: effects faster than 4 Hz cannot be seen" in rec.warnings


def test_what_stands_in_other_rows_is_read_from_its_own_numbers(tmp_path):
    path = table(tmp_path / "r.csv", t=T, q__a=every(np.sin(6.0 * T), 3), tau__a=every(np.cos(T), 7, 1))
    rec = read_recording(path)
    assert rec.t + rec.start_s == pytest.approx(T[1::7])
    assert rec.channels["q"]["a"][:-1] == pytest.approx(np.sin(6.0 * T[1::7])[:-1], abs=1e-5)


def test_of_two_streams_of_one_rate_those_of_the_positions_are_compared(tmp_path):
    t = np.sort(np.concatenate([T, T + 0.0005]))
    path = table(tmp_path / "r.csv", t=t, tau__a=every(np.cos(t), 2, 1), q__a=every(np.sin(t), 2))
    rec = read_recording(path)
    assert rec.t + rec.start_s == pytest.approx(T[1:])  # before the first effort nothing is known of it
    assert rec.channels["tau"]["a"] == pytest.approx(np.cos(T[1:]), abs=1e-4)


def test_a_column_that_may_be_left_out_says_so(tmp_path):
    path = table(tmp_path / "r.csv", t=T, q__a=np.sin(T), tau__a=np.cos(T), dq__a=every(np.cos(T), 5))
    assert any(
        w.endswith("only these rows are compared; without it all rows are")
        for w in read_recording(path).warnings
    )


def test_lost_cells_and_what_stays_the_same_make_no_column_coarse(tmp_path):
    lost = np.where(np.random.default_rng(0).uniform(size=len(T)) < 0.3, np.nan, np.cos(T))
    path = table(tmp_path / "r.csv", t=T, q__a=np.sin(T), tau__a=lost, tau_ff__a=every(0.0 * T, 5))
    assert len(read_recording(path).t) > 0.98 * len(T)


def test_a_number_every_few_seconds_is_none(tmp_path):
    t = np.arange(0.0, 150.0, 0.02)
    path = table(tmp_path / "r.csv", t=t, q__a=np.sin(t), tau__a=np.cos(t), q_cmd__a=every(np.sin(t), 100))
    rec = read_recording(path)
    assert len(rec.t) > 0.98 * len(t)
    assert "q_cmd" not in rec.channels or not rec.channels["q_cmd"]
    assert any("column 'q_cmd.a' holds a number every 2 s" in w for w in rec.warnings)
