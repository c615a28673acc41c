"""Drawing a whole set: cases → calibrated strengths → recordings → files → seal."""

from __future__ import annotations

import multiprocessing
import shutil
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import click

from s2r_conceal.calibrate import REDRAWN, calibrate, usable
from s2r_conceal.cases import Case, draw_cases, redraw
from s2r_conceal.errors import DrawError, SealError
from s2r_conceal.half_drawn import begin, end, keep, kept
from s2r_conceal.motions import DURATION_S
from s2r_conceal.plant import SUBSTEPS
from s2r_conceal.record import record
from s2r_conceal.seal import Key, publish
from s2r_conceal.strength import Measured
from s2r_conceal.write import write_case

REDRAWS = 3
BATCH = {"one_joint": 96, "two_link": 48, "seven_joint": 24}  # cases simulated side by side


def draw_set(
    seed: int | None,
    rig: str,
    counts: dict[str, int],
    out: Path,
    key_file: Path,
    progress: Callable[[int], None] = lambda n: None,
    duration_s: float = DURATION_S,
    substeps: int = SUBSTEPS,
    workers: int = 1,
) -> dict[str, Any]:
    """Draw, record, write and seal a set; returns the answers that went under seal. An interrupted draw goes on.

    Args:
        seed: The same seed, rig and counts give the same case folders, byte for byte. None draws one, which only the
            key file has.
        rig: See ``rigs``.
        counts: Group → number of cases.
        out: A folder that does not exist yet or is empty, or holds an interrupted draw.
        key_file: Where the key goes; outside ``out``.
        duration_s: Length of every recording [s].
        substeps: Integrator steps per millisecond.
        workers: Processes at a time, one batch of cases each.
        progress: Called with the number of cases finished since the last call.

    Raises:
        DrawError: ``out`` holds something else, the key would lie inside it or is that of another set, a group is
            unknown, or an interrupted draw was begun with other options.
        SealError: A file of the set was changed while it was drawn.
    """
    if key_file.resolve().is_relative_to(out.resolve()):
        raise DrawError(f"the key {key_file} would lie inside {out}; keep it apart with --key")
    draw_cases(0, rig, counts, duration_s)  # refuses what cannot be drawn before anything is written
    key = begin(out, key_file, seed, {"rig": rig, "cases": counts, "duration_s": duration_s})
    cases = draw_cases(key.drawn_with["seed"], rig, counts, duration_s)
    answers: dict[str, Any] = {}
    parts = [cases[i : i + BATCH[rig]] for i in range(0, len(cases), BATCH[rig])]
    firsts = [1 + k * BATCH[rig] for k in range(len(parts))]
    with _said_when_interrupted(out, key, firsts, len(cases)), _pool(workers) as pool:
        each = pool.map if workers > 1 and len(parts) > 1 else map
        for truths in each(partial(_draw_part, out, substeps, key), firsts, parts):
            answers |= truths
            progress(len(truths))
    for first in firsts:
        if kept(out, first, key) is None:
            raise SealError(
                f"files of the cases from case-{first:04d} on in {out} were changed while the set was drawn: the same "
                "command draws these cases anew"
            )
    publish(out, answers, key)
    end(out, key_file, key)
    return answers


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that end when this one is interrupted: a pool would wait for what they have begun."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=_leave_signals_to_the_first) as pool:
        try:
            yield pool
        except KeyboardInterrupt:
            for worker in multiprocessing.active_children():
                worker.terminate()  # in the middle of a part, which is kept as a whole or not at all
            raise


def _leave_signals_to_the_first() -> None:
    """A terminal tells all processes of a Ctrl-C; each would answer with a traceback of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def _said_when_interrupted(out: Path, key: Key, firsts: list[int], total: int) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        done = sum(len(kept(out, first, key) or ()) for first in firsts)
        text = f"{done} of {total} cases are kept in {out}; the same command goes on from there"
        click.echo(f"\n{text}", err=True)  # after the progress bar
        raise


def _draw_part(out: Path, substeps: int, key: Key, first: int, cases: list[Case]) -> dict[str, Any]:
    """Record, write and keep some cases, numbered from ``first``; returns their truths, also where kept before."""
    before = kept(out, first, key)
    if before is not None:
        return before
    part, measured = calibrated(cases)
    truths = {}
    for k, recorded in enumerate(record(part, measured, substeps)):
        name = f"case-{first + k:04d}"
        if (out / name).exists():  # half a case of an interrupted draw, or what somebody made of it since
            shutil.rmtree(out / name)
        write_case(out / name, recorded)
        truths[name] = recorded.truth
    keep(out, first, truths, key)
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
