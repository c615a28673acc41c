"""Many independent jobs: on worker processes here or on a Ray cluster, one result line per job, and nothing is done
twice after an interruption. A worker that dies takes nothing along: its job is begun anew."""

from __future__ import annotations

import fcntl
import json
import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from s2r_protocol.cli.conditions import conditions_of, keep_to
from s2r_protocol.exits import UsageError
from s2r_protocol.ray_cluster import on_ray
from s2r_sim import batch_worker
from s2r_sim.errors import ResultsTakenError, WorkerLostError

Job = tuple[Any, ...]
Work = Callable[..., dict[str, Any]]
MOST_DEATHS = 3  # of workers over one job; then it is the job that kills them


def run_jobs(
    work: Work,
    jobs: Iterable[Job],
    results: Path,
    workers: int,
    label: str,
    ray: str | None = None,
    conditions: dict[str, Any] | None = None,
    still_there: Callable[[dict[str, Any]], bool] | None = None,
) -> list[dict[str, Any]]:
    """Call ``work(*job)`` for every job that has no line in ``results`` yet; all lines, in the order of the jobs.

    Args:
        work: A function of a module (workers are spawned); its result must be JSON.
        jobs: Arguments, each a tuple of JSON values that names the job.
        results: JSON lines, created when missing. A line cut short by an interruption is done again.
        workers: Processes; 1 runs here.
        label: For the progress bar.
        ray: Address of a Ray cluster to run on instead, "local" for one of ``workers`` processors on this machine.
        conditions: What all jobs were done with and their names do not say, in JSON; kept beside the results.
        still_there: Whether the files that a result of an earlier call speaks of are as it left them; a job whose
            files are not is done again.

    Raises:
        UsageError: The results that are there were made with other conditions.
        WorkerLostError: A job's workers died again and again.
        Exception: What a job raised, the first of those that did; the results of the jobs under way with it are kept.
        ResultsTakenError: Another process is at work on the same results.
        NotReadyError: Ray is asked for and not installed.
    """
    todo = list(jobs)
    results.parent.mkdir(parents=True, exist_ok=True)
    with results.open("a") as file:
        _take(file, results)
        if conditions is not None:
            keep_to(conditions, results, begun=bool(results_in(results)))
        known = dict(_read(results))
        if still_there is not None:
            _forget_lost(known, todo, still_there, results, label)
        with _said_when_interrupted(known, todo, results, label):
            _do_what_is_left(work, todo, known, file, results, workers, label, ray)
    return [known[_key(job)] for job in todo]


def _take(file: TextIO, results: Path) -> None:
    """Lock a file of results, until it is closed or this process ends."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ResultsTakenError(
            f"another process is at work on {results}, and both would do the same jobs in the same folders: wait "
            "until it has ended, or give another --out"
        ) from error
    except OSError as error:
        told = f"{results} lies where files cannot be locked ({error.strerror}): call one command at a time"
        click.echo(told, err=True)


def _do_what_is_left(
    work: Work,
    todo: list[Job],
    known: dict[str, dict[str, Any]],
    file: TextIO,
    results: Path,
    workers: int,
    label: str,
    ray: str | None,
) -> None:
    """Do the jobs that are not in ``known``, add their results to it and a line of each to the file."""
    left = [job for job in todo if _key(job) not in known]
    columns = (TextColumn(label), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), refresh_per_second=1) as bar:
        if file.tell() and not results.read_text().endswith("\n"):
            file.write("\n")  # end the line that an interruption cut short
        task = bar.add_task(label, total=len(todo), completed=len(todo) - len(left))
        done = _on_workers(work, left, workers) if ray is None else on_ray(work, left, workers, ray)
        for job, result in done:
            known[_key(job)] = result
            file.write(json.dumps({"job": list(job), "result": result}) + "\n")
            file.flush()
            bar.advance(task)


def _forget_lost(
    known: dict[str, dict[str, Any]],
    todo: list[Job],
    still_there: Callable[[dict[str, Any]], bool],
    results: Path,
    label: str,
) -> None:
    """Take out of ``known`` what the jobs asked for have lost since, and say so."""
    before = [(key, known[key]) for job in todo if (key := _key(job)) in known]
    lost = [(key, result) for key, result in before if not still_there(result)]
    for key, _ in lost:
        known.pop(key, None)  # a job may be asked for twice
    if lost:
        click.echo(
            f"{len(lost)} of {len(before)} {label} in {results} are done again: what they wrote is missing or damaged, "
            f"first {lost[0][1].get('file', lost[0][0])}",
            err=True,
        )


@contextmanager
def _said_when_interrupted(
    known: dict[str, dict[str, Any]], todo: list[Job], results: Path, label: str
) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        kept = sum(_key(job) in known for job in todo)
        text = f"{kept} of {len(todo)} {label} are kept in {results}; the same command goes on from there"
        click.echo(text, err=True)
        raise


def _on_workers(work: Work, jobs: list[Job], workers: int) -> Iterator[tuple[Job, dict[str, Any]]]:
    """Jobs with their results, as they end. What a job raises is raised when those under way with it have ended."""
    if workers <= 1:
        for job in jobs:
            yield job, work(*job)
        return
    queue, deaths = list(jobs), Counter[str]()
    while queue:
        begun: dict[Future[dict[str, Any]], Job] = {}
        try:
            yield from _in_one_pool(work, queue, begun, workers)
        except BrokenProcessPool:
            # Which of them killed its worker is not known: all that were begun are begun anew.
            queue = [*begun.values(), *queue]
            deaths.update(_key(job) for job in begun.values())
            for job, count in deaths.most_common(1):  # none where a worker died between two jobs
                if count >= MOST_DEATHS:
                    raise WorkerLostError(
                        f"worker processes died {count} times with job {job} among those they worked on; "
                        "is the machine out of memory? what is done is kept, the same command goes on from there"
                    ) from None


def _in_one_pool(
    work: Work, queue: list[Job], begun: dict[Future[dict[str, Any]], Job], workers: int
) -> Iterator[tuple[Job, dict[str, Any]]]:
    """Jobs off the front of ``queue``, under way in ``begun``, with their results as they end.

    No more is handed out than there are workers: what a pool has queued it works off, also after an error.

    Raises:
        BrokenProcessPool: A worker died.
        BaseException: What the first job to fail raised; it is told at once, nothing more is begun then, and it is
            raised when the jobs under way have ended.
    """
    failed: BaseException | None = None
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=batch_worker.listen) as pool:
        try:
            while begun or (queue and failed is None):
                while queue and failed is None and len(begun) < workers:
                    # Taken from the queue once it is handed over: a pool that has just broken refuses it.
                    begun[pool.submit(batch_worker.call, work, queue[0])] = queue[0]
                    del queue[0]
                for future in wait(begun, return_when=FIRST_COMPLETED).done:
                    error = future.exception()
                    if isinstance(error, BrokenProcessPool):
                        raise failed or error
                    job = begun.pop(future)
                    if error is None:
                        yield job, future.result()
                    elif failed is None:
                        failed = error
                        _say_failed(job, error, len(begun))
        except (KeyboardInterrupt, GeneratorExit):
            for worker in multiprocessing.active_children():
                worker.terminate()  # a signal that only we got
            # Waited for: Python 3.11 may wake the pool's thread at exit while that closes its pipe.
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    if failed is not None:
        raise failed


def _say_failed(job: Job, error: BaseException, under_way: int) -> None:
    """Tell of an error as soon as it is known: the jobs that are waited for may take hours."""
    rest = f"; no more jobs are begun, waiting for {under_way} under way" if under_way else ""
    click.echo(f"job {_key(job)} failed: {type(error).__name__}: {error}{rest}", err=True)


def results_in(results: Path) -> list[dict[str, Any]]:
    """All results of a file, in the order they were written; none if it is not there."""
    return list(dict(_read(results)).values())


def jobs_in(results: Path) -> list[list[Any]]:
    """The names of all jobs that have a result in a file, in the order they were written; none if it is not there."""
    return [json.loads(job) for job in dict(_read(results))]


def results_for_page(
    results: Path,
    wanted: Callable[[list[Any], dict[str, Any]], bool],
    what: str,
    conditions: dict[str, Any] | None = None,
) -> list[dict[str, Any]]:
    """Those of a file that a page is to show.

    Args:
        results: The file.
        wanted: Which, by job and result.
        what: They are, in the plural.
        conditions: That the page will say they were made with.

    Raises:
        UsageError: There are none, and the page would become an empty one; or they were made with other conditions.
    """
    if conditions is not None and conditions_of(results).is_file():
        keep_to(conditions, results, begun=True)
    rows = [row for job, row in dict(_read(results)).items() if wanted(json.loads(job), row)]
    if not rows:
        raise UsageError(f"--page-only: {results} holds no result of these {what}; the page is left as it is")
    return rows


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
