"""Recordings are read, converted and refused by name."""

import numpy as np
import pytest
import yaml

from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.recordings.files import read_recording
from s2r_host.gap.recordings.recording import Controller, Recording

T = np.arange(0, 1, 0.01)


def write(folder, header, rows, side=None):
    path = folder / "rec.csv"
    path.write_text("\n".join([",".join(header)] + [",".join(map(str, r)) for r in rows]), encoding="utf-8")
    if side is not None:
        path.with_suffix(".yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
    return path


def simple(folder, side=None, q=None):
    q = np.sin(T) if q is None else q
    return write(folder, ["t", "q.a", "tau.a"], zip(T, q, np.cos(T), strict=True), side)


def test_columns_become_channels(tmp_path):
    rec = read_recording(simple(tmp_path))
    assert rec.joints == ("a",)
    assert rec.get("tau", "a") == pytest.approx(np.cos(T))
    assert rec.effort == "commanded"


def test_declared_degrees_become_radians(tmp_path):
    rec = read_recording(simple(tmp_path, {"units": {"q": "deg"}}, q=90 * np.sin(T)))
    assert rec.get("q", "a") == pytest.approx(np.pi / 2 * np.sin(T))


def test_an_unknown_unit_is_refused_with_the_known_ones(tmp_path):
    with pytest.raises(GapRecordingError, match=r"'q.a' declares the unit 'furlong'.*deg"):
        read_recording(simple(tmp_path, {"units": {"q": "furlong"}}))


def test_joint_names_are_mapped(tmp_path):
    assert read_recording(simple(tmp_path, {"joint_names": {"a": "elbow"}})).joints == ("elbow",)


def test_joints_called_by_a_number_are_mapped(tmp_path):
    side = {
        "joint_names": {1: "elbow"},
        "controller": {"type": "pd", "kp": {1: 3.0}},
        "effort_sigma": {1: 0.1},
    }
    rec = read_recording(write(tmp_path, ["t", "q.1"], zip(T, np.sin(T), strict=True), side))
    assert (rec.joints, rec.controller.kp, rec.effort_sigma) == (("elbow",), {"elbow": 3.0}, {"elbow": 0.1})


def test_two_columns_of_one_joint_are_refused(tmp_path):
    side = {"joint_names": {"a": "elbow", "b": "elbow"}}
    with pytest.raises(GapRecordingError, match=r"gives joint 'elbow' another 'q' column, 'q.b'"):
        read_recording(write(tmp_path, ["t", "q.a", "q.b"], zip(T, np.sin(T), T, strict=True), side))


@pytest.mark.parametrize(("said", "session"), [(None, "rec"), (0, "0"), ("monday", "monday")])
def test_a_session_that_is_not_named_is_the_files_own(tmp_path, said, session):
    assert read_recording(simple(tmp_path, {"session": said})).session == session


def test_gains_follow_the_joint_names(tmp_path):
    side = {"joint_names": {"a": "elbow"}, "controller": {"type": "pd", "kp": {"a": 3.0}}}
    assert read_recording(simple(tmp_path, side)).controller.kp == {"elbow": 3.0}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("x,y\n1,2\n", "no column 't'"),
        ("t,q.a\n0,1\n0.1,hello\n0.2,3\n", "'hello' is not a number"),
        ("t,q.a\n0,1\n0.1,2\n", "2 usable rows, at least 50"),
        ("t,q.a,q.a\n0,1,1\n", "column 'q.a' appears twice"),
    ],
)
def test_a_broken_table_is_refused(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(GapRecordingError, match=message):
        read_recording(path)


def test_time_that_falls_back_is_refused(tmp_path):
    t = T.copy()
    t[40] = 0.0
    with pytest.raises(GapRecordingError, match="time falls back at row 42"):
        read_recording(write(tmp_path, ["t", "q.a"], zip(t, T, strict=True)))


def test_binary_rubbish_is_refused(tmp_path):
    for name in ("bad.csv", "bad.parquet", "bad.mcap"):
        path = tmp_path / name
        path.write_bytes(bytes(range(256)) * 4)
        with pytest.raises(GapRecordingError, match=r"bad\."):
            read_recording(path)


def test_velocity_in_another_unit_is_refused(tmp_path):
    dq = np.degrees(np.gradient(np.sin(5 * T), T))
    path = write(tmp_path, ["t", "q.a", "dq.a"], zip(T, np.sin(5 * T), dq, strict=True))
    with pytest.raises(GapRecordingError, match="another unit"):
        read_recording(path)


def test_missing_cells_cost_a_warning_and_are_interpolated(tmp_path):
    q = [f"{x:.6f}" for x in np.sin(T)]
    q[10] = ""
    rec = read_recording(write(tmp_path, ["t", "q.a"], zip(T, q, strict=True)))
    assert any("1 missing cells" in w for w in rec.warnings)
    assert rec.get("q", "a")[10] == pytest.approx(np.sin(T[10]), abs=1e-3)


def test_parquet_reads_like_csv(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = tmp_path / "rec.parquet"
    pq.write_table(pa.table({"t": T, "q.a": np.sin(T)}), path)
    assert read_recording(path).get("q", "a") == pytest.approx(np.sin(T))


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_other_columns_may_hold_anything(tmp_path, kind):
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {
        "t": T,
        "q.a": np.sin(T),
        "mode": ["AUTO"] * len(T),
        "stamp": ["2026-11-28T10:00:00Z"] * len(T),
    }
    if kind == "csv":
        path = write(tmp_path, list(columns), zip(*columns.values(), strict=True))
    else:
        path = tmp_path / "rec.parquet"
        pq.write_table(pa.table(columns | {"pairs": [[1, 2]] * len(T)}), path)
    rec = read_recording(path)
    assert rec.get("q", "a") == pytest.approx(np.sin(T))
    assert "column 'mode' is not part of the contract and is ignored" in rec.warnings


def test_a_parquet_column_that_is_there_twice_is_refused(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = tmp_path / "rec.parquet"
    pq.write_table(pa.table([T, T, T], names=["t", "q.a", "q.a"]), path)
    with pytest.raises(GapRecordingError, match=r"column 'q.a' appears twice"):
        read_recording(path)


@pytest.mark.parametrize("cut", ["1.0,0.5", "1.0,0.5,", "1.0,0.5,-", "1.0,0.5,1e", "1.0,0.5,0.2e-"])
def test_a_last_line_that_was_cut_off_costs_itself(tmp_path, cut):
    path = simple(tmp_path)
    path.write_text(path.read_text(encoding="utf-8") + "\n" + cut, encoding="utf-8")
    rec = read_recording(path)
    assert rec.t[: len(T)] == pytest.approx(T)
    assert rec.channels["tau"]["a"][: len(T)] == pytest.approx(np.cos(T))


def test_a_whole_last_line_is_not_cut_off(tmp_path):
    path = simple(tmp_path)
    path.write_text(path.read_text(encoding="utf-8") + "\n1.0,0.5,-\n", encoding="utf-8")
    with pytest.raises(GapRecordingError, match="'-' is not a number"):
        read_recording(path)


def test_a_declared_accuracy_is_read_under_the_models_joint(tmp_path):
    side = {"effort_sigma": {"motor": 0.05}, "joint_names": {"motor": "a"}}
    assert read_recording(simple(tmp_path, side)).effort_sigma == {"a": 0.05}
    side = {"effort_gain_sigma": {"motor": 0.1}, "joint_names": {"motor": "a"}}
    assert read_recording(simple(tmp_path, side)).effort_gain_sigma == {"a": 0.1}
    side = {"position_sigma": {"motor": 0.01}, "joint_names": {"motor": "a"}}
    assert read_recording(simple(tmp_path, side)).position_sigma == {"a": 0.01}


@pytest.mark.parametrize("sigma", [{"a": 0}, {"a": -1.0}, {"a": "much"}, {"a": float("nan")}])
def test_an_accuracy_that_is_no_positive_number_is_refused(tmp_path, sigma):
    for key in ("effort_sigma", "effort_gain_sigma", "position_sigma"):
        with pytest.raises(GapRecordingError, match=key):
            read_recording(simple(tmp_path, {key: sigma}))


@pytest.mark.parametrize("start", [0.0, 37.3, 1.7e5])
def test_the_step_of_a_log_is_that_of_its_rate_whenever_it_began(start):
    t = start + 0.01 * np.arange(1000)
    rec = Recording("r", t - t[0], {}, Controller(), "measured", "effort", "a", "", ())
    assert rec.dt == 0.01


@pytest.mark.parametrize("gain", [-3.0, float("nan"), float("inf")])
def test_a_gain_that_is_none_is_refused(tmp_path, gain):
    side = {"controller": {"type": "pd", "kp": {"elbow": gain}}}
    with pytest.raises(GapRecordingError, match=r"controller.kp of 'elbow' is (-3|nan|inf); a gain is"):
        read_recording(simple(tmp_path, side))


@pytest.mark.parametrize("rate", ["fast", -1000.0, float("nan"), float("inf"), {"elbow": 1000}, True])
def test_a_rate_that_is_none_is_refused(tmp_path, rate):
    side = {"controller": {"type": "pd", "kp": {"a": 3.0}, "rate_hz": rate}}
    with pytest.raises(GapRecordingError, match=r"controller.rate_hz is .*; it is how often the law runs"):
        read_recording(simple(tmp_path, side))


@pytest.mark.parametrize(("written", "rate"), [(1000, 1000.0), ("1e3", 1000.0), (0, None), (None, None)])
def test_a_rate_is_read_as_written(tmp_path, written, rate):
    side = {"controller": {"type": "pd", "kp": {"a": 3.0}, "rate_hz": written}}
    assert read_recording(simple(tmp_path, side)).controller.rate_hz == rate


def test_a_side_file_with_a_date_that_there_is_not_is_refused(tmp_path):
    path = simple(tmp_path)
    path.with_suffix(".yaml").write_text("session: 2026-28-11\n", encoding="utf-8")
    with pytest.raises(GapRecordingError, match=r"rec.yaml: not readable YAML \(month must be in 1..12\)"):
        read_recording(path)


@pytest.mark.parametrize("unit_s", [1e-3, 1e-9])
def test_time_in_another_unit_is_asked_for(tmp_path, unit_s):
    path = write(tmp_path, ["t", "q.a"], zip(1.7e9 + T / unit_s, np.sin(T), strict=True))
    with pytest.raises(GapRecordingError, match=r"rows are 1(0|e\+07) s apart; is 't' in ms or ns\?"):
        read_recording(path)


@pytest.mark.parametrize("together", [2, 3])
def test_rows_that_come_in_bursts_are_refused(tmp_path, together):
    """Their usual step is microseconds: a work grid of it filled the memory."""
    t = np.add.outer(np.arange(0.0, 2.0, 0.004 * together), 5e-6 * np.arange(together)).ravel()
    path = write(tmp_path, ["t", "q.a", "tau.a"], zip(t, np.sin(t), np.cos(t), strict=True))
    with pytest.raises(
        GapRecordingError, match=r"come 5e-06 s after the one before.*keep the last of each burst"
    ):
        read_recording(path)


def test_jitter_and_lost_rows_are_no_bursts(tmp_path):
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.1, 1.9, 2000)) * 0.001
    t = t[rng.random(2000) > 0.4]
    rec = read_recording(write(tmp_path, ["t", "q.a", "tau.a"], zip(t, np.sin(t), np.cos(t), strict=True)))
    assert len(rec.t) == len(t)
