"""Drawing a whole set: cases → calibrated strengths → recordings → files → seal."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from s2r_conceal.calibrate import REDRAWN, Measured, calibrate, usable
from s2r_conceal.cases import Case, draw_cases, redraw
from s2r_conceal.errors import DrawError
from s2r_conceal.motions import DURATION_S
from s2r_conceal.plant import SUBSTEPS
from s2r_conceal.record import record
from s2r_conceal.seal import Key, publish
from s2r_conceal.write import write_case

REDRAWS = 3
BATCH = {"one_joint": 96, "two_link": 48, "seven_joint": 24}  # cases simulated side by side


def draw_set(
    seed: int,
    rig: str,
    counts: dict[str, int],
    out: Path,
    key_file: Path,
    progress: Callable[[int], None] = lambda n: None,
    duration_s: float = DURATION_S,
    substeps: int = SUBSTEPS,
    workers: int = 1,
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
        workers: Processes at a time, one batch of cases each.
        progress: Called with the number of cases finished since the last call.

    Raises:
        DrawError: ``out`` holds something, the key would lie inside it, or a group is unknown.
    """
    _refuse_bad_places(out, key_file)
    cases = draw_cases(seed, rig, counts, duration_s)
    answers: dict[str, Any] = {}
    parts = [cases[i : i + BATCH[rig]] for i in range(0, len(cases), BATCH[rig])]
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        each = pool.map if workers > 1 and len(parts) > 1 else map
        firsts = [1 + k * BATCH[rig] for k in range(len(parts))]
        for truths in each(partial(_draw_part, out, substeps), firsts, parts):
            answers |= truths
            progress(len(truths))
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


def _draw_part(out: Path, substeps: int, first: int, cases: list[Case]) -> dict[str, Any]:
    """Record and write some cases, numbered from ``first``; returns their truths."""
    part, measured = calibrated(cases)
    truths = {}
    for k, recorded in enumerate(record(part, measured, substeps)):
        name = f"case-{first + k:04d}"
        write_case(out / name, recorded)
        truths[name] = recorded.truth
    return truths


def calibrated(cases: list[Case]) -> tuple[list[Case], list[Measured]]:
    """Cases with their strengths set; a case that cannot carry its strength is drawn anew.

    On one joint the new draws are calibrated beside the first ones: side by side they cost little, one after the other
    as much as all cases together each time. On arms every column costs, so that only what failed is drawn anew.
    """
    if cases[0].rig.joints > 1:
        return _one_after_the_other(cases)
    spare = [[redraw(c, k + 1) for k in range(REDRAWS)] if c.group in REDRAWN else [] for c in cases]
    every = [*cases, *(x for row in spare for x in row)]
    measured = calibrate(every)
    found, values, start = [], [], len(cases)
    for i, row in enumerate(spare):
        tries = [i, *range(start, start + len(row))]
        start += len(row)
        # The last one stays even when it is no better, as after drawing one by one.
        chosen = next((k for k in tries if usable(every[k], measured[k])), tries[-1])
        found.append(every[chosen])
        values.append(measured[chosen])
    return found, values


def _one_after_the_other(cases: list[Case]) -> tuple[list[Case], list[Measured]]:
    found, values = list(cases), calibrate(cases)
    for attempt in range(1, REDRAWS + 1):
        failed = [i for i, c in enumerate(found) if not usable(c, values[i])]
        if not failed:
            break
        fresh = [redraw(cases[i], attempt) for i in failed]
        for i, case, measured in zip(failed, fresh, calibrate(fresh), strict=True):
            found[i], values[i] = case, measured
    return found, values
