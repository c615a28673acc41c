"""What a command is doing, for somebody who waits."""

from __future__ import annotations

import contextlib
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import click

LINE_S = 10.0  # at least, between two lines


@contextlib.contextmanager
def progress_line() -> Iterator[Callable[[str], None]]:
    """A line on standard error that says what is being done; gone at the end, absent where nobody looks."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        line = progress.add_task("starting", total=None)
        yield lambda text: progress.update(line, description=text)


class Count(Protocol):
    """How many of a known number are done."""

    length: int | None

    def update(self, n_steps: int) -> None:
        """So many more are."""


@dataclass
class CountedLines:
    """A line on standard error now and then: "running: 3 of 12"."""

    label: str
    length: int | None
    _done: int = 0
    _told_s: float = -math.inf

    def update(self, n_steps: int) -> None:
        """So many more are done."""
        self._done += n_steps
        last = self._done == self.length
        if n_steps and (last or time.monotonic() - self._told_s >= LINE_S):
            self._told_s = time.monotonic()
            click.echo(f"{self.label}: {self._done} of {self.length}", err=True)


@contextlib.contextmanager
def counted(label: str, length: int = 0) -> Iterator[Count]:
    """A bar on standard error where somebody looks, else lines; ``length`` may be set once it is known."""
    if not sys.stderr.isatty():
        yield CountedLines(label, length)
        return
    with click.progressbar(length=length, label=label, file=sys.stderr) as bar:
        yield bar
