"""Many independent jobs: worker processes, one result line per job, and nothing is done twice after an
interruption."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

Job = tuple[Any, ...]


def run_jobs(
    work: Callable[..., dict[str, Any]], jobs: Iterable[Job], results: Path, workers: int, label: str
) -> list[dict[str, Any]]:
    """Call ``work(*job)`` for every job that has no line in ``results`` yet; all lines, in the order of the jobs.

    Args:
        work: A function of a module (workers are spawned); its result must be JSON.
        jobs: Arguments, each a tuple of JSON values that names the job.
        results: JSON lines, created when missing. A line cut short by an interruption is done again.
        workers: Processes; 1 runs here.
        label: For the progress bar.
    """
    todo = list(jobs)
    known = dict(_read(results))
    left = [job for job in todo if _key(job) not in known]
    results.parent.mkdir(parents=True, exist_ok=True)
    columns = (TextColumn(label), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with (
        results.open("a") as file,
        Progress(*columns, console=Console(stderr=True), refresh_per_second=1) as bar,
    ):
        if file.tell() and not results.read_text().endswith("\n"):
            file.write("\n")  # end the line that an interruption cut short
        task = bar.add_task(label, total=len(todo), completed=len(todo) - len(left))
        for job, result in _done(work, left, workers):
            known[_key(job)] = result
            file.write(json.dumps({"job": list(job), "result": result}) + "\n")
            file.flush()
            bar.advance(task)
    return [known[_key(job)] for job in todo]


def _done(
    work: Callable[..., dict[str, Any]], jobs: list[Job], workers: int
) -> Iterator[tuple[Job, dict[str, Any]]]:
    if workers <= 1:
        for job in jobs:
            yield job, work(*job)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        waiting = {}
        queue = iter(jobs)
        while True:
            while len(waiting) < 2 * workers and (job := next(queue, None)) is not None:
                waiting[pool.submit(work, *job)] = job
            if not waiting:
                return
            finished, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in finished:
                yield waiting.pop(future), future.result()


def results_in(results: Path) -> list[dict[str, Any]]:
    """All results of a file, in the order they were written; none if it is not there."""
    return list(dict(_read(results)).values())


def _key(job: Job) -> str:
    return json.dumps(list(job))


def _read(results: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    if not results.exists():
        return
    for line in results.read_text().splitlines():
        try:
            entry = json.loads(line)
        except json.JSONDecodeError:
            continue  # cut short: its job is done again
        yield json.dumps(entry["job"]), entry["result"]
