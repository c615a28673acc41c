"""Drawing a whole set: cases → calibrated strengths → recordings → files → seal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from s2r_conceal.calibrate import Measured, calibrate, usable
from s2r_conceal.cases import Case, draw_cases, redraw
from s2r_conceal.errors import DrawError
from s2r_conceal.motions import DURATION_S
from s2r_conceal.plant import SUBSTEPS
from s2r_conceal.record import Recorded, record
from s2r_conceal.seal import Key, publish
from s2r_conceal.write import write_case

REDRAWS = 3
BATCH = {"one_joint": 64, "two_link": 48, "seven_joint": 12}  # cases simulated side by side


def draw_set(
    seed: int,
    rig: str,
    counts: dict[str, int],
    out: Path,
    key_file: Path,
    progress: Callable[[int], None] = lambda n: None,
    duration_s: float = DURATION_S,
    substeps: int = SUBSTEPS,
) -> dict[str, Any]:
    """Draw, record, write and seal a set; returns the answers that went under seal.

    Args:
        seed: The same seed, rig and counts give the same case folders, byte for byte.
        rig: See ``rigs``.
        counts: Group → number of cases.
        out: A folder that does not exist yet or is empty.
        key_file: Where the key goes; outside ``out``.
        duration_s: Length of every recording [s].
        substeps: Integrator steps per millisecond.
        progress: Called with the number of cases finished since the last call.

    Raises:
        DrawError: ``out`` holds something, the key would lie inside it, or a group is unknown.
    """
    _refuse_bad_places(out, key_file)
    cases = draw_cases(seed, rig, counts, duration_s)
    answers: dict[str, Any] = {}
    for recorded in _recorded(cases, BATCH[rig], substeps, progress):
        name = f"case-{len(answers) + 1:04d}"
        write_case(out / name, recorded)
        answers[name] = recorded.truth
    key = Key.fresh({"seed": seed, "rig": rig, "cases": counts, "duration_s": duration_s})
    publish(out, answers, key)
    key.write(key_file)
    return answers


def _refuse_bad_places(out: Path, key_file: Path) -> None:
    if out.exists() and any(out.iterdir()):
        raise DrawError(f"{out} is not empty; draw into a new folder")
    if key_file.resolve().is_relative_to(out.resolve()):
        raise DrawError(f"the key {key_file} would lie inside {out}; keep it apart with --key")
    out.mkdir(parents=True, exist_ok=True)


def _recorded(
    cases: list[Case], batch: int, substeps: int, progress: Callable[[int], None]
) -> Iterator[Recorded]:
    for start in range(0, len(cases), batch):
        part, measured = calibrated(cases[start : start + batch])
        yield from record(part, measured, substeps)
        progress(len(part))


def calibrated(cases: list[Case]) -> tuple[list[Case], list[Measured]]:
    """Cases with their strengths set; a case that cannot carry its strength is drawn anew."""
    cases, measured = list(cases), calibrate(cases)
    for attempt in range(1, REDRAWS + 1):
        poor = [i for i, (c, m) in enumerate(zip(cases, measured, strict=True)) if not usable(c, m)]
        if not poor:
            break
        again = [redraw(cases[i], attempt) for i in poor]
        for i, case, m in zip(poor, again, calibrate(again), strict=True):
            cases[i], measured[i] = case, m
    return cases, measured
