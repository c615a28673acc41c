"""Which commands filled a folder of results, with commit, jobs and time: kept beside them, for the head of the page."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from s2r_sim.batch import jobs_in
from s2r_sim.errors import ResultsTakenError
from s2r_sim.paper.score import Row

CORES, GOAL_H = 2, 8.0  # of the machine that a whole campaign is to be done on, and in how long


@dataclass(frozen=True)
class Call:
    """One call of the command that added trials.

    Attributes:
        command: As typed, but for the folder.
        commit: Of the code, "-dirty" with changes; None where it was not under git.
        jobs: Trials at a time.
        added: Names of the jobs that it added to the results: kind, number, manipulations at most.
        wall_s: How long it took.
    """

    command: str
    commit: str | None
    jobs: int
    added: list[list[Any]]
    wall_s: float


@dataclass(frozen=True, eq=False)
class Campaign:
    """Trials of one folder that a page shows, with the same number of manipulations, and the calls that added them."""

    rows: Sequence[Row]
    attempts: int
    calls: Sequence[Call]

    def shown(self, call: Call) -> int:
        """How many of a call's trials the page shows."""
        names = {(row["kind"], row["number"], self.attempts) for row in self.rows}
        return sum(tuple(name) in names for name in call.added)


def campaign_of(rows: Sequence[Row], attempts: int, results: Path) -> Campaign:
    """Those rows of a file of results, with the calls that are noted beside it."""
    path = calls_of(results)
    lines = path.read_text().splitlines() if path.is_file() else []
    campaign = Campaign(rows, attempts, [Call(**json.loads(line)) for line in lines])
    return replace(campaign, calls=[call for call in campaign.calls if campaign.shown(call)])


@contextmanager
def noted(results: Path, command: str, jobs: int) -> Iterator[None]:
    """Add a line beside the results for what the block adds to them, however it ends."""
    before, began_s, code = jobs_in(results), time.monotonic(), commit()

    def note() -> None:
        added = jobs_in(results)[len(before) :]
        if added:
            call = Call(command, code, jobs, added, round(time.monotonic() - began_s, 1))
            with calls_of(results).open("a") as file:
                file.write(json.dumps(asdict(call)) + "\n")

    try:
        yield
    except ResultsTakenError:
        raise  # what is there now, another process added
    except BaseException:
        note()
        raise
    note()


def calls_of(results: Path) -> Path:
    """Where the calls that filled a file of results are kept."""
    return results.with_suffix(".calls.jsonl")


def commit() -> str | None:
    """The commit of this code, "-dirty" with changes; None where it is not under git."""
    here, told = Path(__file__), ""
    try:
        for words in (
            ("ls-files", "--error-unmatch", here.name),
            ("describe", "--always", "--dirty", "--exclude=*"),
        ):
            done = subprocess.run(
                ["git", *words], cwd=here.parent, capture_output=True, text=True, check=True
            )
            told = done.stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
    return told


def told(campaigns: Sequence[Campaign]) -> list[str]:
    """Markdown: every command with its commit, and what the campaigns took and would take on two cores."""
    lines, wall_s = ["Run by:", ""], 0.0
    for campaign in campaigns:
        for (command, code, jobs), calls in _by_command(campaign.calls).items():
            took_s = sum(call.wall_s for call in calls)
            wall_s += took_s
            several = f" in {len(calls)} calls" if len(calls) > 1 else ""
            at_a_time = f"{jobs} at a time" if jobs > 1 else "one at a time"
            added, shown = sum(len(call.added) for call in calls), sum(map(campaign.shown, calls))
            trials = f"{shown} trial{'s' * (shown != 1)}" if shown == added else f"{shown} of {added} trials"
            lines.append(
                f"- `{command}`, commit {code or 'not known'}: {trials}{several}, {at_a_time}, {took_s / 3600:.2f} h"
            )
        unnoted = len(campaign.rows) - sum(map(campaign.shown, campaign.calls))
        if unnoted > 0:
            lines.append(f"- {unnoted} trials ({_named(campaign.rows)}): their command was not noted")
    rows = [row for campaign in campaigns for row in campaign.rows]
    walls = [row["wall_s"] for row in rows if row.get("wall_s") is not None]
    shares = [row["cpu_s"] for row in rows if row.get("cpu_s") is not None]
    if not walls or not shares:
        return lines
    trials_h, cpu_h = sum(walls) / 3600, sum(shares) / 3600
    took = f"These calls took {wall_s / 3600:.2f} h. " if wall_s else ""
    lines += [
        "",
        f"{took}Their trials have {trials_h:.2f} h of wall time and {cpu_h:.2f} h of processor time in all: two at a "
        f"time on {CORES} cores they take {max(trials_h, cpu_h) / CORES:.2f} h, half of the larger of the two; the "
        f"goal is {GOAL_H:g} h at most.",
    ]
    return lines


def _by_command(calls: Sequence[Call]) -> dict[tuple[str, str | None, int], list[Call]]:
    """A campaign that was interrupted and continued is one line."""
    found: dict[tuple[str, str | None, int], list[Call]] = {}
    for call in calls:
        found.setdefault((call.command, call.commit, call.jobs), []).append(call)
    return found


def _named(rows: Sequence[Row]) -> str:
    numbers: dict[str, list[int]] = {}
    for row in rows:
        numbers.setdefault(row["kind"], []).append(row["number"])
    return ", ".join(f"{kind} {min(some)} to {max(some)}" for kind, some in numbers.items())
