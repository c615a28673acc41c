"""Opening the answers and writing the result: ``score.md``, ``score.json`` and one page of plots."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from s2r_conceal.score import Line, confusion, every_stated, reliability, table, where_asked
from s2r_conceal.score_case import CaseScore, score_case
from s2r_conceal.seal import open_answers


def score_folder(folder: Path, key_file: Path, out: Path) -> str:
    """Score a set whose verdicts are hashed; writes files into ``out`` and returns the table as text.

    Raises:
        VerdictsMissingError: The verdicts are not complete or not hashed yet.
        SealError: A file, a verdict or the answers were changed.
    """
    answers = open_answers(folder, key_file)
    scores = [_score(folder, case, truth) for case, truth in answers.items() if truth["stable"]]
    lines = table(scores)
    text = markdown(lines, scores) + left_out(answers)
    out.mkdir(parents=True, exist_ok=True)
    (out / "score.md").write_text(text)
    body = {
        "schema": 1,
        "table": [asdict(line) for line in lines],
        "confusion": confusion(scores),
        "reliability": reliability(every_stated(scores)),
        "reliability_where_asked": reliability(where_asked(scores)),
        "cases": [asdict(s) for s in scores],
    }
    (out / "score.json").write_text(json.dumps(body, indent=1) + "\n")
    (out / "answers.json").write_text(json.dumps(answers, indent=1) + "\n")
    from s2r_conceal.score_plot import plot_page

    plot_page(scores, out / "score.svg")
    return text


def left_out(answers: dict[str, Any]) -> str:
    """A line that names the cases that do not count; nothing where all do."""
    unstable = [case for case, truth in answers.items() if not truth["stable"]]
    if not unstable:
        return ""
    return (
        f"\nLeft out of {len(answers)} cases, as their simulation became unstable: {', '.join(unstable)}.\n"
    )


def _score(folder: Path, case: str, truth: dict[str, Any]) -> CaseScore:
    verdict = json.loads((folder / "verdicts" / f"{case}.json").read_text())
    roles = {e["regime"]["recording"] for e in truth["effects"]}
    return score_case(
        case, truth, verdict, {role: read_track(folder / case / f"{role}.csv") for role in roles}
    )


def read_track(path: Path) -> dict[str, np.ndarray]:
    """Columns of a CSV by name."""
    with path.open() as file:
        names = file.readline().strip().split(",")
        data = np.loadtxt(file, delimiter=",", ndmin=2)
    return {name: data[:, i] for i, name in enumerate(names)}


def markdown(lines: Sequence[Line], scores: Sequence[CaseScore]) -> str:
    """The table, then what was answered for every truth."""
    rows = ["| measure | value | 95 % interval | cases | goal |", "|---|---|---|---|---|"]
    for line in lines:
        value = "–" if line.value is None else f"{line.value:.3g}"
        between = "" if line.interval is None else f"{line.interval[0]:.2f} to {line.interval[1]:.2f}"
        rows.append(f"| {line.name} | {value} | {between} | {line.count} | {line.goal} |")
    rows += ["", "| hidden | answered first (count) |", "|---|---|"]
    for true, said in sorted(confusion(scores).items()):
        answers = ", ".join(f"{n} ({k})" for n, k in sorted(said.items(), key=lambda item: -item[1]))
        rows.append(f"| {true} | {answers} |")
    return "\n".join(rows) + "\n"
