"""``s2r bench missing``: one concealed effect per object; learnt from three manipulations, tried on the next ones."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import click

from s2r_protocol.exits import UsageError


@click.command()
@click.option(
    "--cases", default="all", show_default=True, help="Labels as 'drawer: stiction', comma-separated."
)
@click.option("--objects", default=1, show_default=True, type=click.IntRange(min=1), help="Per case.")
@click.option(
    "--first", default=0, show_default=True, type=click.IntRange(min=0), help="Number of the first object."
)
@click.option(
    "--later",
    default=10,
    show_default=True,
    type=click.IntRange(1, 10),
    help="Targets after the first three.",
)
@click.option(
    "--no-control", is_flag=True, help="Leave out the second run of each object, in which nothing is learnt."
)
@click.option(
    "--lost-motion-alone",
    is_flag=True,
    help="Run each object once more, with all that is learnt but for 's2r gap'.",
)
@click.option("--jobs", default=1, show_default=True, type=click.IntRange(min=1), help="Runs at a time.")
@click.option(
    "--ray", metavar="ADDRESS", help="Run the jobs on this Ray cluster, 'local' for one on this machine."
)
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder; results.jsonl is continued."
)
@click.option("--page", type=click.Path(path_type=Path, dir_okay=False), help="Where to write the page.")
@click.option("--page-only", is_flag=True, help="Run nothing; write the page from the results there are.")
@click.option("--note", default="", help="A remark for the page, e.g. under which conditions it was run.")
@click.option(
    "--what-if",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Result of tests/bench/bench_left_out.py, for the page: what an effect could change at all.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def missing(
    cases: str,
    objects: int,
    first: int,
    later: int,
    no_control: bool,
    lost_motion_alone: bool,
    jobs: int,
    ray: str | None,
    out: Path,
    page: Path | None,
    page_only: bool,
    note: str,
    what_if: Path | None,
    as_json: bool,
) -> None:
    """Hide one effect in an object's joint, let the host learn it, and score its next manipulations.

    Each object is run twice, with and without ``s2r run --learn-physics``. An interrupted campaign goes on where it
    was.
    """
    from s2r_sim.batch import results_for_page, run_jobs
    from s2r_sim.missing.cases import HIDDEN
    from s2r_sim.missing.page import summaries, write_page
    from s2r_sim.missing.trial import run_case
    from s2r_sim.missing.what_if import read_what_if
    from s2r_sim.paper.own_page import check_page

    labels = list(HIDDEN) if cases == "all" else [label.strip() for label in cases.split(",")]
    for label in labels:
        if label not in HIDDEN:
            raise UsageError(f"unknown case {label!r}; there are {', '.join(HIDDEN)}")
    shifts = read_what_if(what_if) if what_if is not None else []  # refused before the hours of work
    page = page or out / "physics-left-out.md"
    check_page(page, "s2r bench missing")
    arms = ["learnt"]
    arms += [] if no_control else ["as it is"]
    arms += ["lost motion alone"] if lost_motion_alone else []
    todo = [
        (label, number, arm, later)
        for number in range(first, first + objects)
        for label in labels
        for arm in arms
    ]
    results = out / "results.jsonl"
    if page_only:
        # The same object with fewer targets after the first three is another run.
        rows = results_for_page(
            results, lambda job, row: row["case"] in labels and job[3] == later, f"cases with --later {later}"
        )
    else:
        rows = run_jobs(partial(run_case, out), todo, results, jobs, "runs", ray)
    order = list(HIDDEN)
    rows = sorted(rows, key=lambda row: (order.index(row["case"]), row["number"], row["arm"]))
    chosen = f" --cases '{cases}'" if cases != "all" else ""
    alone = (" --no-control" if no_control else "") + (" --lost-motion-alone" if lost_motion_alone else "")
    command = (
        f"s2r bench missing{chosen} --objects {objects} --first {first} --later {later}{alone} --out DIR"
    )
    write_page(rows, page, command, note, shifts)
    found = summaries(rows)
    if as_json:
        click.echo(json.dumps([one.as_json() for one in found], indent=1))
        return
    for one in found:
        click.echo(
            f"{one.case:<38} objects {one.objects}  first {_percent(one.first)}  as it is {_percent(one.plain)}  "
            f"learnt {_percent(one.learnt)}  named {one.right} of {one.right + one.wrong}, alone {one.alone}, "
            f"open {one.open}"
        )
    click.echo(f"page: {page}")


def _percent(value: float | None) -> str:
    return "    – " if value is None else f"{100 * value:5.1f} %"
