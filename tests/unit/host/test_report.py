"""The report of a run that ended early still says why, and opens without a network."""

import re

import matplotlib.pyplot as plt
import numpy as np
import pytest

from s2r_host.report.markup import page, section, table
from s2r_host.report.page import write_report
from s2r_host.report.plots import stages_figure
from s2r_host.report.style import inline_png, inline_svg
from s2r_host.run.journal import Journal, Stage
from s2r_host.run.record import RunRecord
from s2r_host.run.settings import RunSettings
from s2r_protocol.exits import ExitCode


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


def test_report_needs_no_network_and_no_script(record, tmp_path):
    text = write_report(record, tmp_path / "report.html").read_text()
    loaded = re.findall(r"(?:src|href|url)\s*[=(]\s*[\"']?(https?:[^\"'\s>)]+)", text)
    assert loaded == []
    assert "<script" not in text


def test_run_json_of_a_failed_run_has_reason_and_timings(record):
    values = record.as_dict()
    assert values["exit"] == {"code": 4, "name": "REFUSED", "reason": record.reason}
    assert [stage["name"] for stage in values["stages"]] == ["connect", "view A"]
    assert values["delta"] is None
    assert values["inputs"]["settings"]["target"] == 0.15
    record.write(record.settings.out / "run.json")
    assert (record.settings.out / "run.json").read_text().startswith("{")


def test_figures_are_inlined_whole():
    figure = stages_figure([Stage("connect", 0.0, 0.5, 0.1)])
    assert inline_svg(figure).startswith("<svg")
    assert inline_png(figure, "stages").startswith('<img alt="stages" src="data:image/png;base64,')
    assert not plt.get_fignums()


def test_cells_are_escaped():
    assert "&lt;x&gt;" in table(("a",), [("<x>",)])
    assert "&amp;" in section("a & b", "")
    assert "<title>a &lt; b</title>" in page("a < b", [""])


def test_infinite_uncertainty_becomes_null(record):
    from s2r_host.run.record import _plain

    assert _plain({"sigma": float("inf"), "p": np.array([1.0, np.nan])}) == {"sigma": None, "p": [1.0, None]}
