"""Workers of a batch: every job is done, and a Ctrl-C leaves what is queued alone."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from operator import mul
from pathlib import Path

import pytest

from s2r_host.gap.workers import each_done

JOBS = """
import signal, sys, time
from pathlib import Path

def work(number, folder):
    Path(folder, str(number)).touch()
    time.sleep(3.0)

if __name__ == "__main__":
    from s2r_host.gap.workers import each_done
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
    list(each_done(work, [(k, sys.argv[1]) for k in range(8)], 2, None))
"""


def halve_or_die(k, by):
    """Half of ``k``; ends the process where ``by`` is a signal."""
    if by < 0:
        os.kill(os.getpid(), -by)
    return k / by


@pytest.mark.parametrize("workers", [1, 2])
def test_all_jobs_are_done(workers):
    assert sorted(each_done(mul, [(k, 2) for k in range(5)], workers, pow)) == [0, 2, 4, 6, 8]


def test_what_a_job_raises_is_raised():
    with pytest.raises(ZeroDivisionError):
        list(each_done(divmod, [(1, 0)], 1, pow))


@pytest.mark.parametrize("workers", [1, 2])
def test_a_worker_that_dies_costs_its_own_job(workers):
    jobs = [(0, 2), (1, -9), (2, 2), (3, 2), (4, -9), (5, 2)]
    done = list(each_done(halve_or_die, jobs, workers, lambda k, _: -k))
    assert sorted(done) == [-4, -1, 0.0, 1.0, 1.5, 2.5]


def test_no_jobs_are_no_work():
    assert list(each_done(mul, [], 2, pow)) == []


@pytest.mark.parametrize("whole_terminal", [True, False])
def test_after_ctrl_c_nothing_more_is_begun(tmp_path, whole_terminal):
    script, begun = tmp_path / "jobs.py", tmp_path / "begun"
    script.write_text(JOBS)
    begun.mkdir()
    process = subprocess.Popen(
        [sys.executable, script, begun], start_new_session=True, stderr=subprocess.DEVNULL
    )
    try:
        deadline = time.monotonic() + 120.0
        while len(list(begun.iterdir())) < 2:
            assert time.monotonic() < deadline
            assert process.poll() is None
            time.sleep(0.05)
        (os.killpg if whole_terminal else os.kill)(process.pid, signal.SIGINT)
        assert process.wait(timeout=120.0) != 0
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    assert len(list(begun.iterdir())) == 2


def test_a_killed_batch_takes_its_workers_along(tmp_path):
    """They finished their jobs, and wrote into folders that the next batch had begun."""
    script, begun = tmp_path / "jobs.py", tmp_path / "begun"
    script.write_text(
        JOBS.replace("touch()", "write_text(str(os.getpid()))").replace("import", "import os,", 1)
    )
    begun.mkdir()
    process = subprocess.Popen(
        [sys.executable, script, begun], start_new_session=True, stderr=subprocess.DEVNULL
    )
    try:
        deadline = time.monotonic() + 120.0
        while len([p for p in begun.iterdir() if p.read_text()]) < 2:
            assert time.monotonic() < deadline
            assert process.poll() is None
            time.sleep(0.05)
        process.kill()
        process.wait()
        left = {int(path.read_text()) for path in begun.iterdir()}
        deadline = time.monotonic() + 2.0  # less than what the jobs still have to do
        while left and time.monotonic() < deadline:
            left = {pid for pid in left if Path(f"/proc/{pid}/cmdline").exists() and _lives(pid)}
            time.sleep(0.05)
        assert not left
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def _lives(pid):
    """Not one that has ended and that nobody has waited for."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    return False
