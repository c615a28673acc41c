"""``s2r bench paper``: Table I of the paper on concealed objects, through the whole system."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from s2r_protocol.cli.options import FiniteRange
from s2r_protocol.exits import UsageError

if TYPE_CHECKING:
    from s2r_sim.paper.calls import Campaign


@click.command()
@click.option("--kinds", default="drawer,laptop,faucet", show_default=True, help="Comma-separated.")
@click.option("--trials", default=32, show_default=True, type=click.IntRange(min=1), help="Per kind.")
@click.option(
    "--first", default=0, show_default=True, type=click.IntRange(min=0), help="Number of the first trial."
)
@click.option(
    "--attempts", default=3, show_default=True, type=click.IntRange(min=1), help="Planned manipulations each."
)
@click.option("--arm", default="xmate3pro", show_default=True, help="Shipped arm, or a folder with arm.yaml.")
@click.option(
    "--run-options", default="", help="Further options of s2r run, as '--reactive --without torque'."
)
@click.option(
    "--pace",
    type=FiniteRange(0, 1000),
    default=0.0,
    show_default=True,
    help="Simulated over real seconds, 0: no limit; --reactive is to be measured with 1.",
)
@click.option(
    "--compare",
    multiple=True,
    metavar="LABEL=DIR",
    help="Campaigns with other options: the page tells them apart on the trials they share.",
)
@click.option("--jobs", default=1, show_default=True, type=click.IntRange(min=1), help="Trials at a time.")
@click.option(
    "--ray", metavar="ADDRESS", help="Run the jobs on this Ray cluster, 'local' for one on this machine."
)
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder; results.jsonl is continued."
)
@click.option(
    "--page", type=click.Path(path_type=Path, dir_okay=False), help="Where to write the results page."
)
@click.option("--page-only", is_flag=True, help="Run nothing; write the page from the results there are.")
@click.option(
    "--also",
    multiple=True,
    type=click.Path(path_type=Path, file_okay=False),
    help="With --page-only: another campaign's --out, joined with this one on the page; may be given again.",
)
@click.option("--note", default="", help="A remark for the page, e.g. under which conditions it was run.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def paper(
    kinds: str,
    trials: int,
    first: int,
    attempts: int,
    arm: str,
    run_options: str,
    pace: float,
    compare: tuple[str, ...],
    jobs: int,
    ray: str | None,
    out: Path,
    page: Path | None,
    page_only: bool,
    also: tuple[Path, ...],
    note: str,
    as_json: bool,
) -> None:
    """Move parts of never-seen drawers, laptops and faucets by random amounts and score against the sealed truth.

    Each trial runs stand-in, executor and host in lock-step: look, push, model, plan, execute, measure. An interrupted
    campaign goes on where it was.
    """
    from s2r_sim.batch import run_jobs
    from s2r_sim.paper.calls import campaign_of, noted, told
    from s2r_sim.paper.own_page import check_page
    from s2r_sim.paper.page import write_page
    from s2r_sim.paper.summary import causes, merit
    from s2r_sim.paper.trial import run_trial
    from s2r_sim.paper.trials import KINDS

    names = [name.strip() for name in kinds.split(",")]
    for name in names:
        if name not in KINDS:
            raise UsageError(f"unknown kind {name!r}; there are {', '.join(KINDS)}")
    if also and not page_only:
        raise UsageError("--also joins campaigns that were run: give --page-only, too")
    others = _others(compare)
    words = _words(run_options)
    page = page or out / "results.md"
    check_page(page, "s2r bench paper")
    conditions = {"--run-options": run_options, "--pace": pace, "--arm": arm}
    options = f" --arm {arm}" if arm != "xmate3pro" else ""
    options += f" --run-options '{run_options}'" if run_options else ""
    options += f" --pace {pace:g}" if pace else ""
    results = out / "results.jsonl"
    if page_only:
        campaigns = _campaigns((out, *also), names, attempts, conditions)
        command = (
            f"s2r bench paper --page-only --kinds {','.join(names)} --attempts {attempts}{options} --out DIR"
        )
        command += " --also DIR" * len(also)
        _refuse_strangers(others, {(row["kind"], row["number"]) for one in campaigns for row in one.rows})
    else:
        todo = [(name, number, attempts) for number in range(first, first + trials) for name in names]
        _refuse_strangers(others, {(name, number) for name, number, _ in todo})  # before the hours of work
        command = f"s2r bench paper --kinds {','.join(names)} --trials {trials} --first {first} --attempts {attempts}"
        command += f" --jobs {jobs}{f' --ray {ray}' if ray else ''}{options} --out DIR"
        work = partial(run_trial, out, words, pace, arm)
        with noted(results, command, jobs):
            rows = run_jobs(work, todo, results, jobs, "manipulations", ray, conditions)
        campaigns = [campaign_of(rows, attempts, results)]
    rows = [row for campaign in campaigns for row in campaign.rows]
    write_page(rows, page, command, attempts, note, others, told(campaigns))
    last = [asdict(merit(rows, name)) | asdict(causes(rows, name)) for name in names]
    if as_json:
        first_done = [asdict(merit(rows, name, "delta_first")) for name in names]
        click.echo(json.dumps({"last": last, "first": first_done}, indent=1))
        return
    for entry in last:
        ten, thirty, fifty = entry["below"]
        click.echo(
            f"{entry['kind']:<8} n {entry['n']:>3}  manipulated {entry['done']:>3}  "
            f"below 10 / 30 / 50 %: {ten} / {thirty} / {fifty}  failures {entry['failures'] or '-'}"
        )
    click.echo(f"page: {page}")


def _campaigns(
    folders: tuple[Path, ...], kinds: list[str], attempts: int, conditions: dict[str, Any]
) -> list[Campaign]:
    """What a page from results alone is to show of each folder.

    Raises:
        UsageError: A folder holds none of them, or was run with other conditions, or two hold the same trial.
    """
    from s2r_sim.batch import results_for_page
    from s2r_sim.paper.calls import campaign_of

    found: list[Campaign] = []
    holder: dict[tuple[str, int], Path] = {}
    for folder in folders:
        results = folder / "results.jsonl"
        # The same trial with more or fewer manipulations is another one.
        rows = results_for_page(
            results,
            lambda job, row: row["kind"] in kinds and job[2] == attempts,
            f"kinds with --attempts {attempts}",
            conditions,
        )
        for row in rows:
            if (other := holder.setdefault((row["kind"], row["number"]), folder)) is not folder:
                raise UsageError(
                    f"--also {folder}: {row['kind']} {row['number']} is in {other} as well and would count twice; "
                    "join campaigns of other trials (--first) or kinds (--kinds)"
                )
        found.append(campaign_of(rows, attempts, results))
    return found


def _words(run_options: str) -> tuple[str, ...]:
    try:
        return tuple(shlex.split(run_options))
    except ValueError as error:
        raise UsageError(f"--run-options {run_options!r}: {error}; close every quotation") from error


def _others(compare: tuple[str, ...]) -> dict[str, list[dict[str, Any]]]:
    """Rows of other campaigns by their label.

    Raises:
        UsageError: Not LABEL=DIR, or no results there, or those of several numbers of attempts.
    """
    from s2r_sim.paper.ablations import campaign_in

    found = {}
    for entry in compare:
        label, separator, folder = entry.partition("=")
        results = Path(folder) / "results.jsonl"
        if not separator or not results.is_file():
            raise UsageError(f"--compare {entry!r}: give LABEL=DIR with a results.jsonl in DIR")
        found[label] = campaign_in(results)
    return found


def _refuse_strangers(others: dict[str, list[dict[str, Any]]], trials: set[tuple[str, int]]) -> None:
    """Refuse campaigns to compare with that hold none of these trials (kind, number).

    Raises:
        UsageError: One does; there is nothing to compare.
    """
    for label, rows in others.items():
        if trials.isdisjoint((row["kind"], row["number"]) for row in rows):
            raise UsageError(
                f"--compare {label!r}: that campaign shares no trial with this one; compare campaigns of the same "
                "numbers (--first) and kinds (--kinds)"
            )
