"""What the kernel grants, asked for in a thread that ends at once: this process stays as it was."""

from __future__ import annotations

import threading
from collections.abc import Callable


def refusal(ask: Callable[[], object]) -> str:
    """Ask, for the thread that is asked from alone; empty if granted, else the kernel's reason."""
    answer: list[str] = []

    def attempt() -> None:
        try:
            ask()
            answer.append("")
        except OSError as error:
            answer.append(error.strerror or str(error))

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return answer[0]
