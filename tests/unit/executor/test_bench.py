"""The benchmark's arithmetic on samples made by hand, and the page it writes."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from s2r_executor.bench import cli, report
from s2r_executor.bench.measure import lateness, median_of, ratios, stop_after_kill, unexplained, wakes_of
from s2r_protocol.exits import UsageError

MS = 1_000_000
PERIOD = MS
RECORD = np.dtype(
    [
        ("tick", "<u8"),
        ("stamp_ns", "<i8"),
        ("lateness_ns", "<i8"),
        ("state", "u1"),
        ("plan_t", "<f8"),
        ("ddq_ref", "<f8", (2,)),
    ]
)


def loop(late_us):
    """A cyclictest-like loop: a late wake-up skips the periods it overran."""
    deadline, rows = 10 * MS, []
    for late in late_us:
        woke = deadline + round(late * 1000)
        rows.append((deadline, woke))
        deadline += PERIOD * (1 + (woke - deadline) // PERIOD)
    return tuple(np.array(rows, np.int64).T)


def test_percentiles_maximum_and_missed_cycles():
    figures = lateness(*loop([10.0] * 97 + [20.0, 30.0, 2500.0]), PERIOD)
    assert (figures.wakes, figures.missed, figures.p50_us, figures.max_us) == (100, 2, 10.0, 2500.0)
    assert figures.p99_us == pytest.approx(np.percentile([10.0] * 97 + [20.0, 30.0, 2500.0], 99))


def test_a_missed_cycle_is_explained_only_while_the_reference_was_late():
    mine = loop([10.0] * 20 + [2500.0] + [10.0] * 20)
    punctual = loop([10.0] * 60)
    assert unexplained(*mine, *punctual, PERIOD) == 2
    late_then = loop([10.0] * 21 + [1500.0] + [10.0] * 20)
    assert unexplained(*mine, *late_then, PERIOD) == 0
    late_elsewhere = loop([10.0] * 3 + [1500.0] + [10.0] * 40)
    assert unexplained(*mine, *late_elsewhere, PERIOD) == 2


def test_a_reference_that_was_a_little_late_explains_nothing():
    mine = loop([10.0] * 20 + [2500.0] + [10.0] * 20)
    assert unexplained(*mine, *loop([240.0] * 60), PERIOD) == 2


def test_records_after_lost_ticks_count_from_the_first_missed_deadline():
    records = np.zeros(3, RECORD)
    records["tick"] = [5, 6, 9]  # 7 and 8 were lost
    records["stamp_ns"] = [5 * MS + 10, 6 * MS + 20, 9 * MS + 300]
    records["lateness_ns"] = [10, 20, 300]
    deadline, woke = wakes_of(records, PERIOD)
    assert deadline.tolist() == [5 * MS, 6 * MS, 7 * MS]
    assert lateness(deadline, woke, PERIOD).missed == 2


def test_ratios_are_loop_over_reference():
    got = ratios(lateness(*loop([30.0] * 10), PERIOD), lateness(*loop([20.0] * 10), PERIOD))
    assert got == {"p50": 1.5, "p99": 1.5, "p999": 1.5, "max": 1.5}
    assert median_of([{"p50": 1.0}, {"p50": 9.0}, {"p50": 2.0}]) == {"p50": 2.0}


def stopping_records(ticks=100, first=50, length=20, jerk=10.0):
    records = np.zeros(ticks, RECORD)
    records["tick"] = np.arange(ticks)
    records["state"] = 3
    records["state"][first : first + length] = 5
    records["plan_t"] = 1.2
    records["ddq_ref"][first : first + length, 0] = jerk * 1e-3 * np.arange(1, length + 1)
    records["ddq_ref"][first + length :, 0] = records["ddq_ref"][first + length - 1, 0]
    return records


def test_a_stop_is_compared_with_the_ramp_of_its_segment():
    stop = stop_after_kill(
        stopping_records(), 5, np.array([0.0, 1.0, 2.0]), np.array([0.5, 0.04]), np.array([20.0, 20.0]), 1e-3
    )
    assert (stop.planned_s, stop.taken_s, stop.ratio) == (0.04, 0.02, 0.5)
    assert stop.jerk_share == pytest.approx(0.5)


def test_no_stop_is_none():
    records = stopping_records(length=0)
    assert stop_after_kill(records, 5, np.array([0.0, 1.0]), np.array([0.5]), np.ones(2), 1e-3) is None


def one_slice(condition, k):
    figures = {
        "wakes": 6000,
        "missed": 2,
        "p50_us": 20.0 + k,
        "p99_us": 40.0,
        "p999_us": 500.0,
        "max_us": 1500.0,
    }
    return {
        "condition": condition,
        "settings": {"seconds": 6},
        "loop": figures,
        "reference": figures | {"missed": 3},
        "ratio": {"p50": 1.0, "p99": 1.1, "p999": 1.2, "max": 1.3},
        "unexplained": k,
        "cpu_per_tick_us": 40.0,
        "cpu_share": 0.04,
        "resident_MiB": 18.0,
        "page_faults": 0.0,
        "heap_growth_kib": 0.0,
        **(
            {
                "stop": {
                    "noticed_ms": 100.0,
                    "planned_s": 0.1,
                    "taken_s": 0.1,
                    "ratio": 1.0 + k / 100,
                    "jerk_share": 0.6,
                }
            }
            if condition == "killed"
            else {}
        ),
    }


FIGURES = {
    "admission": {
        "knots": 500.0,
        "p50_ms": 9.0,
        "worst_ms": 12.0,
        "cpu_p50_ms": 8.0,
        "cpu_worst_ms": 9.5,
        "over_rnea": 6.0,
    },
    "memory": {"front_end_MiB": 137.0, "s2r_rt_MiB": 16.0},
    "stop_latency": {"stops": 50.0, "p50_ticks": 1.0, "worst_ticks": 2.0},
    "bus_load": {"fd": {"computed": 0.678, "measured": 0.61}},
    "splices": {"met_tried": 4.0, "met_took_over": 4.0, "bridged_tried": 3.0, "bridged_took_over": 2.0},
    "stepped_clock": {
        "ticks": 1000.0,
        "missed": 0.0,
        "stops": 0.0,
        "over_real_time": 5.5,
        "core_cpu_us": 30.0,
        "stand_in_cpu_us": 120.0,
    },
}


@pytest.fixture
def measured(monkeypatch):
    """The command with its measuring replaced; counts how often each was asked for."""
    from s2r_executor.bench import figures, long_run
    from s2r_executor.bench import slice as slice_module

    asked = []

    def run(settings):
        asked.append(settings.condition)
        return one_slice(settings.condition, len(asked) % 3)

    monkeypatch.setattr(slice_module, "run_slice", run)
    for name, task in (
        ("admission", "admission_time"),
        ("memory",) * 2,
        ("stop_latency",) * 2,
        ("bus_load",) * 2,
    ):
        monkeypatch.setattr(figures, task, lambda name=name: asked.append(name) or FIGURES[name])
    for name in ("splices", "stepped_clock"):
        monkeypatch.setattr(long_run, name, lambda *_, name=name: asked.append(name) or FIGURES[name])
    return asked


def test_an_interrupted_run_goes_on_where_it_was(measured, tmp_path):
    arguments = ["--slices", "2", "--seconds", "6", "--out", str(tmp_path), "--json"]
    first = CliRunner().invoke(cli.executor, arguments, catch_exceptions=False)
    assert len(measured) == 2 * len(cli.CONDITION_NAMES) + len(cli.FIGURE_NAMES)
    (tmp_path / "killed-6s-1.json").unlink()
    measured.clear()
    again = CliRunner().invoke(cli.executor, arguments, catch_exceptions=False)
    assert measured == ["killed"]
    assert json.loads(again.stdout)["summary"]["alone"] == json.loads(first.stdout)["summary"]["alone"]


@pytest.mark.parametrize(
    ("option", "value"), [("--seconds", "0"), ("--ticks", "0"), ("--cpu", "-1"), ("--cpu", "9999")]
)
def test_a_measurement_of_nothing_or_on_no_cpu_is_refused_before_it_begins(measured, tmp_path, option, value):
    result = CliRunner().invoke(cli.executor, [option, value, "--out", str(tmp_path / "new")])
    assert isinstance(result.exception, UsageError | SystemExit)
    assert result.exit_code != 0
    assert not measured


def test_another_number_of_ticks_is_measured_and_not_taken_from_before(measured, tmp_path):
    for ticks in ("1000", "2000", "1000"):
        CliRunner().invoke(cli.executor, ["--ticks", ticks, "--out", str(tmp_path)], catch_exceptions=False)
    assert measured.count("stepped_clock") == 2


def test_the_tables_are_put_between_the_markers_of_a_page(measured, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"# Before\n{report.BEGIN}\nold\n{report.END}\nafter\n")
    arguments = ["--slices", "3", "--seconds", "6", "--out", str(tmp_path), "--write", str(page)]
    CliRunner().invoke(cli.executor, arguments, catch_exceptions=False)
    text = page.read_text()
    assert text.startswith(f"# Before\n{report.BEGIN}\n`s2r bench executor --slices 3 --seconds 6`")
    assert text.endswith(f"{report.END}\nafter\n")
    assert "old" not in text
    assert "| drives on the other CPU, nothing else | 3 x 6 s | 21 (1.00) | 40 (1.10) |" in text
    assert (
        "| stepped clock with the MuJoCo stand-in | 5.5 times real time; 0 of 1000 setpoints missed" in text
    )
    assert (
        "| replacements of a running plan that miss it by up to a milliradian: took over | 2 of 3 |" in text
    )
    assert "| resident memory, executor idle | front_end 137 MiB, s2r_rt 16 MiB |" in text


def test_a_page_without_the_markers_is_left_alone(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# nothing\n")
    with pytest.raises(UsageError, match="does not hold the lines"):
        report.write_into(page, "table")
    assert page.read_text() == "# nothing\n"
