"""What happened and how long it took: stages, verdicts and warnings, shown as they come and kept for the report."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from rich.console import Console
from rich.markup import escape
from rich.status import Status

from s2r_host.run.tries import FailedTry

logger = logging.getLogger(__name__)


@dataclass
class Stage:
    """One stage of a run. Times in seconds since the run began; ``note`` is its result in one phrase."""

    name: str
    start_s: float
    wall_s: float = 0.0
    cpu_s: float = 0.0
    note: str = ""
    failed: bool = False


class Journal:
    """Stages, verdicts and warnings of one run; prints to standard error."""

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(stderr=True, highlight=False)
        self._begin_s = time.monotonic()
        self.stages: list[Stage] = []
        self.warnings: list[str] = []
        self.verdicts: list[dict[str, object]] = []
        self.failed_tries: list[FailedTry] = []  # to plan a manipulation
        self._spinner: Status | None = None  # of the stage that is under way, on a terminal
        self.on_stage: Callable[[str, str, str], None] = lambda name, phase, note: (
            None
        )  # for who follows the run

    @property
    def elapsed_s(self) -> float:
        """Time since the run began."""
        return time.monotonic() - self._begin_s

    @contextmanager
    def stage(self, name: str) -> Iterator[Stage]:
        """Time a stage; the caller may set its ``note``.

        Of a stage that failed its own error is raised, also where whoever follows the run cannot be told of its end.
        """
        stage = Stage(name, self.elapsed_s)
        self.stages.append(stage)
        self.on_stage(name, "begun", "")
        cpu = time.process_time()
        try:
            if self._console.is_terminal:
                with self._console.status(name, spinner="dots") as self._spinner:
                    yield stage
            else:
                yield stage
        except BaseException:
            stage.failed = True
            raise
        finally:
            self._spinner = None
            stage.wall_s = self.elapsed_s - stage.start_s
            stage.cpu_s = time.process_time() - cpu
            self._tell_end(stage)
            mark = "[red]✗[/red]" if stage.failed else "[green]✓[/green]"
            self._console.print(
                f"{mark} {stage.start_s:6.1f} s  {name:<28s} {stage.wall_s:6.2f} s  {escape(stage.note)}",
                soft_wrap=True,
            )

    def doing(self, text: str) -> None:
        """Show what the stage under way is at, as long as it is; kept nowhere."""
        if self._spinner is not None:
            self._spinner.update(f"{escape(self.stages[-1].name)}: {escape(text)}")

    def _tell_end(self, stage: Stage) -> None:
        try:
            self.on_stage(stage.name, "failed" if stage.failed else "ended", stage.note)
        except Exception as error:
            if not stage.failed:
                raise
            self.warn(f"the end of '{stage.name}' is not recorded: {error}")

    def warn(self, text: str) -> None:
        """Keep and show a warning; the run goes on in a worse way."""
        logger.debug("warning: %s", text)
        self.warnings.append(text)
        self._console.print(f"[yellow]! {escape(text)}[/yellow]", soft_wrap=True)

    def verdict(self, label: str, seq: int, duration_s: float) -> None:
        """Keep what the executor said to a plan."""
        self.verdicts.append(
            {"label": label, "plan_seq": seq, "duration_s": round(duration_s, 4), "accepted": True}
        )

    def say(self, text: str) -> None:
        """Show a line without keeping it."""
        self._console.print(escape(text), soft_wrap=True)
