"""Jobs started from the page: ``s2r`` commands as processes, one at a time, with the end of their output."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable

from s2r_protocol.exits import RefusedError

_KEPT_LINES = 40


class JobBusyError(RefusedError):
    """Another job is still running."""


class Jobs:
    """At most one job at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._lines: deque[str] = deque(maxlen=_KEPT_LINES)
        self.title = ""

    def start(
        self, title: str, arguments: list[str], done: Callable[[int], None] | None = None
    ) -> Callable[[], bool]:
        """Start ``s2r ARGUMENTS``.

        Args:
            title: For the page.
            arguments: Of the command.
            done: Called with the exit code, in another thread.

        Returns:
            Whether this job is still under way.

        Raises:
            JobBusyError: One is running.
        """
        with self._lock:
            if self.running:
                raise JobBusyError(f"'{self.title}' is still running; wait for it or cancel it")
            self.title = title
            self._lines.clear()
            self._lines.append("$ s2r " + " ".join(arguments))
            process = self._process = subprocess.Popen(
                [sys.executable, "-m", "s2r_protocol", *arguments],
                stdin=subprocess.DEVNULL,  # nobody sits there who could answer
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                start_new_session=True,
            )
        threading.Thread(target=self._follow, args=(process, done), name="s2r-job", daemon=True).start()
        return lambda: process.poll() is None

    def _follow(self, process: subprocess.Popen[str], done: Callable[[int], None] | None) -> None:
        assert process.stdout is not None
        for text in process.stdout:
            self._lines.append(text.rstrip())
        code = process.wait()
        self._lines.append(f"exit {code}")
        if done is not None:
            done(code)

    @property
    def running(self) -> bool:
        """One is under way."""
        return self._process is not None and self._process.poll() is None

    @property
    def lines(self) -> list[str]:
        """The end of its output."""
        return list(self._lines)

    def cancel(self) -> None:
        """Ask it to end, as Ctrl-C does: a motion is brought to rest first."""
        process = self._process
        if process is not None and process.poll() is None:
            process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """End it and wait."""
        self.cancel()
        process = self._process
        if process is not None:
            try:
                process.wait(30)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
