"""A target that is asked for: what is no target is refused by name, and nothing is asked of a closed input."""

import io
import math
from types import SimpleNamespace
from typing import Any

import pytest

from s2r_host.run.ask import ask_operator
from s2r_host.run.record import RunRecord
from s2r_host.run.task import FAUCET
from s2r_protocol.exits import UsageError


@pytest.fixture
def record():
    said: list[str] = []
    settings: Any = SimpleNamespace(task=FAUCET, from_pushed=True)
    journal: Any = SimpleNamespace(say=said.append, said=said)
    belief: Any = SimpleNamespace(model=SimpleNamespace(range=(-0.5, 1.0)))
    return RunRecord(settings, journal, belief=belief, s_found=0.3, origin=0.3)


def typed(monkeypatch, text, terminal=False):
    lines = io.StringIO(text)
    lines.isatty = lambda: terminal
    monkeypatch.setattr("sys.stdin", lines)


def test_the_answer_is_read_with_its_unit_and_the_question_counts_from_where_targets_do(monkeypatch, record):
    typed(monkeypatch, "-20deg\n")
    assert ask_operator(record) == pytest.approx(math.radians(-20))
    assert "lever at +0.00°, believed to go from -46° to +40°" in record.journal.said[0]
    assert "from here" in record.journal.said[1]


def test_on_a_terminal_it_is_asked_again_until_it_is_a_target(monkeypatch, record):
    typed(monkeypatch, "20mm\nfar\n400deg\n20deg\n", terminal=True)
    assert ask_operator(record) == pytest.approx(math.radians(20))
    assert [line for line in record.journal.said if "--target" in line] == [
        "--target 20mm: the joint of a faucet is measured in deg or ° or rad",
        "--target 'far' is not a number, with or without a unit (deg or ° or rad)",
        next(line for line in record.journal.said if "outside" in line),
    ]


@pytest.mark.parametrize(
    ("text", "complaint"), [("", "standard input ended without a target"), ("soon\n", "not a number")]
)
def test_without_a_terminal_a_wrong_answer_ends_the_run(monkeypatch, record, text, complaint):
    typed(monkeypatch, text)
    with pytest.raises(UsageError, match=complaint):
        ask_operator(record)
