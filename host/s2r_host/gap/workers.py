"""Jobs on worker processes that keep what they have loaded, and that a Ctrl-C ends."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from typing import Any


def each_done(work: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], workers: int) -> Iterator[Any]:
    """Call ``work(*job)`` for every job; what it returns, as it comes.

    No more is handed out than there are workers: what a pool has queued it works off, whatever happens. A Ctrl-C at the
    terminal ends the workers as well; where only this process is interrupted, what is begun is waited for.

    Args:
        work: A function of a module: workers are spawned.
        jobs: Its arguments.
        workers: Processes at a time.
    """
    left, begun = list(reversed(jobs)), set[Future[Any]]()
    with ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_DFL),
    ) as pool:
        try:
            while left or begun:
                while left and len(begun) < workers:
                    begun.add(pool.submit(work, *left.pop()))
                done, begun = wait(begun, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        except (KeyboardInterrupt, GeneratorExit):
            pool.shutdown(wait=False, cancel_futures=True)
            raise
