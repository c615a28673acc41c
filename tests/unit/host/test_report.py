"""The report of a run that ended early still says why, and opens without a network."""

import re
from types import SimpleNamespace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest

from s2r_host.report.markup import page, section, table
from s2r_host.report.page import _numbers, write_report
from s2r_host.report.plots import joints_figure, stages_figure
from s2r_host.report.style import inline_png, inline_svg
from s2r_host.run import run_json
from s2r_host.run.journal import Journal, Stage
from s2r_host.run.record import Goal, RunRecord
from s2r_host.run.run_json import _plain, as_json, write_run_json
from s2r_host.run.settings import RunSettings
from s2r_host.run.tries import FailedTry, Try
from s2r_protocol.exits import ExitCode, UsageError


@pytest.fixture
def record(tmp_path):
    journal = Journal()
    journal.stages = [Stage("connect", 0.0, 0.5, 0.1), Stage("view A", 0.5, 1.0, 0.2, failed=True)]
    journal.warnings.append("the handle's posts were not seen <b>")
    journal.verdict("push 1", 3, 2.5)
    record = RunRecord(RunSettings(0.15, tmp_path / "run"), journal, ("run", "drawer", "--target", "0.15"))
    record.code, record.reason = (
        ExitCode.REFUSED,
        "depth frame shows 3 points of an object (needs 500) & more",
    )
    return record


def test_failed_run_still_gets_a_report_with_the_reason(record, tmp_path):
    text = write_report(record, tmp_path / "report.html").read_text()
    assert "exit 4 refused" in text
    assert "depth frame shows 3 points of an object (needs 500) &amp; more" in text
    assert "posts were not seen &lt;b&gt;" in text
    assert "push 1" in text


def test_plans_are_numbered_as_a_replay_numbers_them(record, tmp_path):
    record.journal.verdict("manipulation 1", 14, 3.0)
    text = write_report(record, tmp_path / "report.html").read_text()
    for number, label, seq in ((1, "push 1", 3), (2, "manipulation 1", 14)):
        assert re.search(rf"<td>{number}</td><td>{label}</td>.*<td>{seq}</td>", text)


def test_only_folders_that_the_run_wrote_are_listed(record, tmp_path):
    (record.settings.out / "object-log").mkdir(parents=True)
    text = write_report(record, tmp_path / "report.html").read_text()
    assert "executor recordings), object-log/<" in text
    assert "model/" not in text


def test_report_needs_no_network_and_no_script(record, tmp_path):
    text = write_report(record, tmp_path / "report.html").read_text()
    loaded = re.findall(r"(?:src|href|url)\s*[=(]\s*[\"']?(https?:[^\"'\s>)]+)", text)
    assert loaded == []
    assert "<script" not in text


def test_run_json_of_a_failed_run_has_reason_and_timings(record):
    values = as_json(record)
    assert values["exit"] == {"code": 4, "name": "REFUSED", "reason": record.reason}
    assert [stage["name"] for stage in values["stages"]] == ["connect", "view A"]
    assert values["delta"] is None
    assert values["inputs"]["settings"]["target"] == 0.15
    write_run_json(record)
    assert (record.settings.out / "run.json").read_text().startswith("{")


def test_tries_that_gave_no_plan_are_listed_with_their_reasons(record, tmp_path):
    assert "Tries without a plan" not in write_report(record, tmp_path / "report.html").read_text()
    record.journal.failed_tries.append(FailedTry(1, Try(3, 0.15, 0.5), "the fingertip fits <nowhere>"))
    text = write_report(record, tmp_path / "report.html").read_text()
    row = "<td>1, try 4</td><td>+150.0 mm</td><td>50 %</td><td>the fingertip fits &lt;nowhere&gt;</td>"
    assert row in text
    (kept,) = as_json(record)["failed_tries"]
    assert (kept["manipulation"], kept["number"], kept["s_target"]) == (1, 3, 0.15)


def test_targets_that_were_not_aimed_at_yet_are_in_the_heading(tmp_path):
    settings = RunSettings(0.15, tmp_path / "run", then=(0.05,))
    text = write_report(RunRecord(settings, Journal()), tmp_path / "report.html").read_text()
    assert "Drawer to +150.0 mm, then +50.0 mm" in text


def done(number: int, s_initial: float, s_target: float, s: float) -> Any:
    """A planned manipulation."""
    planned = SimpleNamespace(number=number)
    measured = SimpleNamespace(s=s, sigma=1e-4)
    delta = s_target - s
    return SimpleNamespace(
        planned=planned, executed=[], measured=measured, s_initial=s_initial, s_target=s_target, delta=delta
    )


@pytest.mark.parametrize(("target", "delta"), [(0.155, 0.002), (0.25, None)])
def test_the_figures_of_run_json_are_all_of_the_target_aimed_at_last(record, monkeypatch, target, delta):
    """Where no motion was made for it, as the part was there or no plan was found, they are not an earlier one's."""
    monkeypatch.setattr(run_json, "_attempt", lambda attempt: {"number": attempt.planned.number})
    record.goals = [Goal(0.15, [done(1, 0.03, 0.15, 0.153)], s_before=0.03), Goal(target, s_before=0.153)]
    values = as_json(record)
    assert (values["s_target"], values["s_initial"], values["s_final"]) == (target, 0.153, 0.153)
    assert values["delta"] == (None if delta is None else pytest.approx(delta))
    assert values["delta_r"] is None
    assert [goal["delta"] for goal in values["goals"]] == [pytest.approx(-0.003)]


def test_the_figures_on_top_of_the_report_name_their_target_where_it_is_not_the_last(record):
    record.goals = [Goal(0.15, [done(1, 0.03, 0.15, 0.153)], s_before=0.03)]
    assert "δ = target − final</span>" in _numbers(record)
    record.goals.append(Goal(0.25, s_before=0.153))
    assert "<b>-3.00 mm</b><span>δ = target − final, target +150.0 mm</span>" in _numbers(record)


def test_run_json_keeps_targets_of_the_same_value_apart(record):
    there, back = done(1, 0.03, 0.15, 0.152), done(2, 0.152, 0.05, 0.049)
    again = [done(3, 0.049, 0.15, 0.146), done(4, 0.146, 0.15, 0.149)]
    record.goals = [Goal(0.15, [there]), Goal(0.05, [back]), Goal(0.15, again)]
    assert [done.planned.number for done in record.attempts] == [1, 2, 3, 4]
    assert [goal.last.planned.number for goal in record.goals] == [1, 2, 4]
    assert record.goals[2].delta_r == pytest.approx(0.001 / 0.101)


def test_a_target_where_the_part_is_left_already_is_refused(tmp_path):
    with pytest.raises(
        UsageError, match=r"--then \+152\.00 mm is where the target before it leaves the part"
    ):
        RunSettings(0.15, tmp_path / "run", then=(0.152,))


def test_an_ensemble_of_an_even_number_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"--ensemble 4 is not allowed; an odd number"):
        RunSettings(0.15, tmp_path / "run", ensemble=4)


def test_figures_are_inlined_whole():
    figure = stages_figure([Stage("connect", 0.0, 0.5, 0.1)])
    assert inline_svg(figure).startswith("<svg")
    assert inline_png(figure, "stages").startswith('<img alt="stages" src="data:image/png;base64,')
    assert not plt.get_fignums()


def test_the_legend_of_the_joints_lies_on_no_curve():
    trajectory = SimpleNamespace(
        duration_s=1.0, sample=lambda t: (np.tile(np.sin(9 * t)[:, None], 7), None, None)
    )
    executed: Any = SimpleNamespace(trajectory=trajectory, recording=None)
    figure = joints_figure(executed, [f"joint{i}" for i in range(1, 8)], None)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert not [axes for axes in figure.axes if axes.get_legend() or box.overlaps(axes.get_window_extent())]


def test_cells_are_escaped():
    assert "&lt;x&gt;" in table(("a",), [("<x>",)])
    assert "&amp;" in section("a & b", "")
    assert "<title>a &lt; b</title>" in page("a < b", [""])


def test_infinite_uncertainty_becomes_null(record):
    assert _plain({"sigma": float("inf"), "p": np.array([1.0, np.nan])}) == {"sigma": None, "p": [1.0, None]}


def test_the_pictures_are_of_the_two_views_that_told_the_joint(record, tmp_path, monkeypatch):
    shown: list[str] = []

    def drawn(before, after, belief):
        del belief
        shown.extend((before.name, after.name))
        return plt.figure()

    monkeypatch.setattr("s2r_host.report.page.views_figure", drawn)
    monkeypatch.setattr("s2r_host.report.page._inputs", lambda record: "")
    record.views = [SimpleNamespace(name=name) for name in ("A", "B", "C1")]
    record.zero_view, record.told_view = "B", "C1"
    write_report(record, tmp_path / "report.html")
    assert shown == ["B", "C1"]
