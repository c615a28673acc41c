"""Batches of jobs: nothing is done twice, and a worker that dies takes nothing along."""

import importlib
import json
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from s2r_protocol.exits import ExitCode, NotReadyError, UsageError
from s2r_sim import batch
from s2r_sim.batch import run_jobs
from s2r_sim.errors import WorkerLostError

MODULE = '''
import os, signal, time
from pathlib import Path

def noted(folder, number):
    with (Path(folder) / "calls").open("a") as file:
        file.write(f"{number}\\n")
    return {"square": number**2}

def dies_once(folder, number):
    """The worker is killed in the middle of job 3, as by a machine out of memory; not when it is begun anew."""
    mark = Path(folder) / "killed"
    if number == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return noted(folder, number)

def long(folder, number):
    """Says that it began, and that it closed what it had opened."""
    try:
        (Path(folder) / f"began-{number}").touch()
        time.sleep(0.0 if number == 0 else 60.0)
    finally:
        (Path(folder) / f"closed-{number}").touch()
    return {"square": number**2}

def fails_first(folder, number):
    """Job 0 fails while job 1 is at work, and job 1 fails after it where job 2 is not to be begun."""
    (Path(folder) / f"began-{number}").touch()
    if number == 0:
        while not (Path(folder) / "began-1").exists():
            time.sleep(0.01)
        raise LookupError("no lid")
    time.sleep(1.0)
    if (Path(folder) / "second too").exists():
        raise ValueError("no hinge")
    if (Path(folder) / "second dies").exists():
        os.kill(os.getpid(), signal.SIGKILL)
    return {"square": number**2}

def dies(number):
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"number": number}
'''


@pytest.fixture
def work(tmp_path, monkeypatch):
    """Functions that spawned workers can import."""
    name = f"work_{tmp_path.name}"
    (tmp_path / f"{name}.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    return importlib.import_module(name)


def jobs(folder: Path, count: int) -> list:
    return [(str(folder), number) for number in range(count)]


def squares(rows: list[dict]) -> list[int]:
    return [row["square"] for row in rows]


def test_what_is_in_the_file_is_not_done_again(tmp_path, work):
    results = tmp_path / "results.jsonl"
    run_jobs(work.noted, jobs(tmp_path, 3), results, 1, "jobs")
    with results.open("a") as file:
        file.write('{"job": ["cut sh')  # an interruption in the middle of a line
    assert squares(run_jobs(work.noted, jobs(tmp_path, 5), results, 1, "jobs")) == [0, 1, 4, 9, 16]
    assert (tmp_path / "calls").read_text().split() == ["0", "1", "2", "3", "4"]


def test_a_result_whose_files_are_gone_is_made_again_and_said(tmp_path, work, capsys):
    results = tmp_path / "results.jsonl"
    run_jobs(work.noted, jobs(tmp_path, 3), results, 1, "jobs")
    there = lambda result: result["square"] != 1  # noqa: E731
    assert squares(run_jobs(work.noted, jobs(tmp_path, 4), results, 1, "jobs", still_there=there)) == [
        0,
        1,
        4,
        9,
    ]
    assert (tmp_path / "calls").read_text().split() == ["0", "1", "2", "1", "3"]
    assert (
        f"1 of 3 jobs in {results} are done again: what they wrote is missing or damaged"
        in capsys.readouterr().err
    )


def test_results_made_with_other_options_are_not_mixed(tmp_path, work):
    results, given = tmp_path / "results.jsonl", {"--pace": 0.0, "--arm": "xmate3pro"}
    run_jobs(work.noted, jobs(tmp_path, 2), results, 1, "jobs", conditions=given)
    run_jobs(work.noted, jobs(tmp_path, 3), results, 1, "jobs", conditions=given)
    with pytest.raises(UsageError, match=r"--pace 0\.0, not 1\.0: give another --out"):
        run_jobs(work.noted, jobs(tmp_path, 4), results, 1, "jobs", conditions={**given, "--pace": 1.0})
    assert len(results.read_text().splitlines()) == 3


@contextmanager
def batch_of_long_jobs(folder, work):
    """A process with two workers that are at jobs 1 and 2 of 6; job 0 has its result."""
    script = (
        "import sys; from s2r_protocol.cli import root; from s2r_sim.batch import run_jobs; import click\n"
        f"sys.path.insert(0, {str(folder)!r}); import {work.__name__} as work\n"
        f"jobs = [({str(folder)!r}, n) for n in range(6)]\n"
        f"batch = lambda: run_jobs(work.long, jobs, work.Path({str(folder)!r}) / 'results.jsonl', 2, 'jobs')\n"
        "if __name__ == '__main__':\n"
        "    root._load = lambda name: click.Command(name, callback=batch)\n"
        "    root.main(['stop'])\n"
    )
    (folder / "script.py").write_text(script)
    results = folder / "results.jsonl"
    with subprocess.Popen(
        [sys.executable, folder / "script.py"], stderr=subprocess.PIPE, text=True
    ) as process:
        begun = [folder / f"began-{number}" for number in (1, 2)]
        # A worker begins its next job before the first process has written the result of the one before.
        wait_until(lambda: all(path.exists() for path in begun) and results.exists() and results.read_text())
        try:
            yield process
        finally:
            process.kill()


def wait_until(condition, seconds=60.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def numbers(folder, what):
    return sorted(path.name[-1] for path in folder.glob(f"{what}-*"))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_the_first_process_ends_the_jobs_begun_and_says_what_is_kept(tmp_path, work, number):
    """As by a service manager: the workers are not in a terminal that tells them as well."""
    with batch_of_long_jobs(tmp_path, work) as process:
        process.send_signal(number)
        asked = time.monotonic()
        _, said = process.communicate(timeout=30)
    assert time.monotonic() - asked < 10
    assert process.returncode == ExitCode.INTERRUPTED
    assert re.search(r"1 of 6 jobs are kept in .*results.jsonl; the same command goes on from there", said), (
        said
    )
    assert "Traceback" not in said
    assert numbers(tmp_path, "began") == numbers(tmp_path, "closed") == ["0", "1", "2"]


def test_a_first_process_that_is_killed_leaves_no_worker_at_work(tmp_path, work):
    """One that is left goes on with jobs that the next call begins as well, in the same folders."""
    with batch_of_long_jobs(tmp_path, work) as process:
        process.kill()
        process.wait()
        wait_until(lambda: numbers(tmp_path, "closed") == ["0", "1", "2"], 10.0)
    assert numbers(tmp_path, "began") == ["0", "1", "2"]


def test_a_second_process_at_the_same_results_is_refused(tmp_path, work):
    with batch_of_long_jobs(tmp_path, work):
        before = (tmp_path / "results.jsonl").read_text()
        with pytest.raises(NotReadyError, match=r"another process is at work on .*results\.jsonl"):
            run_jobs(work.noted, jobs(tmp_path, 6), tmp_path / "results.jsonl", 1, "jobs")
        assert not (tmp_path / "calls").exists()
        assert (tmp_path / "results.jsonl").read_text() == before


def test_conditions_without_a_result_bind_nobody(tmp_path, work):
    results = tmp_path / "results.jsonl"
    run_jobs(work.noted, [], results, 1, "jobs", conditions={"--run-options": "--bogus"})
    rows = run_jobs(work.noted, jobs(tmp_path, 1), results, 1, "jobs", conditions={"--run-options": ""})
    assert squares(rows) == [0]


def test_a_killed_worker_costs_time_only(tmp_path, work):
    results = tmp_path / "results.jsonl"
    assert squares(run_jobs(work.dies_once, jobs(tmp_path, 6), results, 2, "jobs")) == [0, 1, 4, 9, 16, 25]
    written = [json.loads(line)["job"][1] for line in results.read_text().splitlines()]
    assert sorted(written) == list(range(6))


@pytest.mark.parametrize("refused", [1, 3])
def test_a_job_refused_by_a_pool_that_has_just_broken_is_not_lost(tmp_path, work, monkeypatch, refused):
    """A worker may die between two submissions: the pool then refuses the next job instead of failing a running one.

    At the first no job is under way that could be blamed.
    """
    submit, calls = ProcessPoolExecutor.submit, []

    def refuses_one(pool, *call):
        calls.append(call)
        if len(calls) == refused:
            raise BrokenProcessPool("a worker died")
        return submit(pool, *call)

    monkeypatch.setattr(ProcessPoolExecutor, "submit", refuses_one)
    rows = run_jobs(work.noted, jobs(tmp_path, 6), tmp_path / "results.jsonl", 2, "jobs")
    assert squares(rows) == [0, 1, 4, 9, 16, 25]


def test_a_job_that_kills_every_worker_is_named_and_what_is_done_is_kept(tmp_path, work):
    results = tmp_path / "results.jsonl"
    with pytest.raises(WorkerLostError, match=r"died 3 times with job \[\d\] among those"):
        run_jobs(work.dies, [(number,) for number in range(4)], results, 2, "jobs")
    assert len(results.read_text().splitlines()) <= 3


def test_a_job_that_fails_costs_no_result_of_those_under_way_and_none_is_begun_after_it(
    tmp_path, work, capsys
):
    results = tmp_path / "results.jsonl"
    with pytest.raises(LookupError, match="no lid"):
        run_jobs(work.fails_first, jobs(tmp_path, 8), results, 2, "jobs")
    assert [json.loads(line)["job"][1] for line in results.read_text().splitlines()] == [1]
    assert numbers(tmp_path, "began") == ["0", "1"]
    told = (
        f'job ["{tmp_path}", 0] failed: LookupError: no lid; no more jobs are begun, waiting for 1 under way'
    )
    assert told in capsys.readouterr().err.replace("\n", "")


def test_the_error_of_a_job_is_told_while_the_others_are_waited_for(tmp_path, work, monkeypatch):
    """They may take hours."""
    told = []
    monkeypatch.setattr(batch, "_say_failed", lambda job, *_: told.append((job, time.monotonic())))
    with pytest.raises(LookupError):
        run_jobs(work.fails_first, jobs(tmp_path, 2), tmp_path / "results.jsonl", 2, "jobs")
    ((job, when),) = told
    assert job[1] == 0
    assert time.monotonic() - when > 0.8


@pytest.mark.parametrize("how", ["second too", "second dies"])
def test_of_several_errors_the_first_is_raised(tmp_path, work, how):
    (tmp_path / how).touch()
    with pytest.raises(LookupError, match="no lid"):
        run_jobs(work.fails_first, jobs(tmp_path, 4), tmp_path / "results.jsonl", 2, "jobs")
    assert numbers(tmp_path, "began") == ["0", "1"]


def test_ray_is_asked_for_by_name_where_it_is_missing(tmp_path, work, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(NotReadyError, match=r"pip install sim2real2\[scale\]"):
        run_jobs(work.noted, jobs(tmp_path, 1), tmp_path / "results.jsonl", 2, "jobs", ray="local")


@pytest.mark.prove
def test_a_ray_cluster_survives_a_killed_worker(tmp_path, work):
    pytest.importorskip("ray", reason="needs the extra 'scale'")
    results = tmp_path / "results.jsonl"
    rows = run_jobs(
        partial(work.dies_once, str(tmp_path)),
        [(number,) for number in range(6)],
        results,
        2,
        "jobs",
        ray="local",
    )
    assert squares(rows) == [0, 1, 4, 9, 16, 25]
    assert (tmp_path / "killed").exists()
