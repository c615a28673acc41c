"""Jobs on worker processes that keep what they have loaded, and that end with a Ctrl-C and with their first process."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from s2r_protocol.cli.first_process import after_first_process
from s2r_protocol.exits import ExitCode

Job = tuple[Any, ...]


def each_done(
    work: Callable[..., Any], jobs: Sequence[Job], workers: int, lost: Callable[..., Any]
) -> Iterator[Any]:
    """Call ``work(*job)`` for every job; what it returns, as it comes.

    No more is handed out than there are workers: what a pool has queued it works off, whatever happens. A Ctrl-C at the
    terminal ends the workers as well; where only this process is interrupted, what is begun is waited for.

    Args:
        work: A function of a module: workers are spawned.
        jobs: Its arguments.
        workers: Processes at a time.
        lost: Called here with a job on which a worker died, as for want of memory; returned instead.
    """
    left = list(reversed(jobs))
    suspects: list[Job] = []  # begun when a worker died, with which the pool ends: each runs again, alone
    while left or suspects:
        alone = bool(suspects) or workers == 1
        for job, returned in _until_one_dies(
            work, [suspects.pop()] if suspects else left, 1 if alone else workers
        ):
            if returned is not None:
                yield returned[0]
            elif alone:
                yield lost(*job)
            else:
                suspects.append(job)


def _listen() -> None:
    """In a worker: a Ctrl-C ends it, and so does the end of the first process, however that came."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    after_first_process(lambda: os._exit(ExitCode.INTERRUPTED))


def _until_one_dies(
    work: Callable[..., Any], left: list[Job], workers: int
) -> Iterator[tuple[Job, tuple[Any] | None]]:
    """Jobs off the end of ``left`` and what each returned; None where a worker died, and no more after those."""
    begun: dict[Future[Any], Job] = {}
    whole = True
    with ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_listen,
    ) as pool:
        try:
            while begun or (left and whole):
                while left and whole and len(begun) < workers:
                    try:
                        begun[pool.submit(work, *left[-1])] = left[-1]
                        left.pop()
                    except BrokenProcessPool:
                        whole = False
                for future in wait(begun, return_when=FIRST_COMPLETED).done:
                    job = begun.pop(future)
                    try:
                        returned = (future.result(),)
                    except BrokenProcessPool:
                        whole, returned = False, None
                    yield job, returned
        except (KeyboardInterrupt, GeneratorExit):
            pool.shutdown(wait=False, cancel_futures=True)
            raise
