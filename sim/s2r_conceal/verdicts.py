"""Verdict files of a set: which command gave them, which of them stay, and where the tool gave no answer."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from pathlib import Path
from typing import Any

from s2r_conceal.errors import ConcealError, ToolFailedError
from s2r_conceal.seal import hashed_verdicts
from s2r_protocol.exits import ExitCode

Verdict = dict[str, Any]


def path_of(folder: Path, case: str) -> Path:
    """Where the verdict on a case is kept."""
    return folder / "verdicts" / f"{case}.json"


def write(folder: Path, case: str, verdict: Verdict) -> None:
    """Write a verdict, whole or not at all."""
    path = path_of(folder, case)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(verdict, indent=1) + "\n")
    part.replace(path)


def asked(command: str, config_sha256: str | None = None) -> Verdict:
    """What every verdict says about how it came about: the command, spelt in one way, and the hash of its switches."""
    return {"command": shlex.join(shlex.split(command)), "config_sha256": config_sha256}


def to_do(folder: Path, cases: list[str], question: Verdict) -> list[str]:
    """The cases that have no verdict yet, and those where the tool gave no answer, unless that is hashed already.

    Args:
        folder: A drawn set.
        cases: All of it.
        question: As :func:`asked` makes it.

    Raises:
        ConcealError: A verdict that stays was given by another command.
    """
    hashed, left = hashed_verdicts(folder), []
    for case in cases:
        verdict = _read(folder, case)
        if verdict is None or (_failed(verdict) and case not in hashed):
            left.append(case)
            continue
        for name, value in question.items():  # verdicts of older versions do not say
            if verdict.get(name, value) != value:
                option = {"command": "--command", "config_sha256": "--config, by its hash,"}[name]
                raise ConcealError(
                    f"{path_of(folder, case)} was given with {option} {verdict[name]!r}, not {value!r}: verdicts of "
                    "two tools are not mixed. Give the same, or run another tool over a copy of the set without "
                    "verdicts/ and verdicts.json"
                )
    return left


def check_answered(folder: Path, cases: list[str]) -> None:
    """Refuse verdicts that are none: the tool failed everywhere.

    Raises:
        ToolFailedError: It has answered on no case.
    """
    failed = _failures(folder, cases)
    if cases and len(failed) == len(cases):
        said = str(next(iter(failed.values())).get("stderr_tail", "")).strip()
        raise ToolFailedError(
            f"{'; '.join(no_answers(folder, cases))}: nothing is hashed, correct --command and start again. "
            f"It said last: {said[-500:] or 'nothing'}"
        )


def no_answers(folder: Path, cases: list[str]) -> list[str]:
    """One sentence for every way in which the tool ended without an answer."""
    codes = Counter(verdict.get("exit_code") for verdict in _failures(folder, cases).values())
    return [
        f"{count} of {len(cases)} cases: the tool "
        + ("gave no answer in time" if code is None else f"ended without gap.json (exit {code})")
        for code, count in codes.most_common()
    ]


def _failures(folder: Path, cases: list[str]) -> dict[str, Verdict]:
    read = {case: _read(folder, case) for case in cases}
    return {case: verdict for case, verdict in read.items() if verdict is not None and _failed(verdict)}


def _failed(verdict: Verdict) -> bool:
    """Whether the tool ended without an answer; a refusal is one."""
    return verdict.get("gap") is None and verdict.get("exit_code") != ExitCode.REFUSED


def _read(folder: Path, case: str) -> Verdict | None:
    path = path_of(folder, case)
    return json.loads(path.read_text()) if path.is_file() else None
