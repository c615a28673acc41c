"""A worker process and the one that began it."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable


def after_first_process(act: Callable[[], object]) -> None:
    """In a worker: call ``act`` once the process that began it has ended, however that came.

    Of one that was killed nobody takes results any more, and the next one begins the same jobs in the same folders.
    """
    first = multiprocessing.parent_process()
    if first is None:
        return

    def watch() -> None:
        first.join()
        act()

    threading.Thread(target=watch, name="first process", daemon=True).start()
