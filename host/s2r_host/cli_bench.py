"""``s2r bench planning``: success and cost of the planner, against others, measured on this machine."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder; results.jsonl is continued."
)
@click.option(
    "--planners", "names", default="ours,paper", show_default=True, help="Comma-separated, interleaved."
)
@click.option("--tasks", "tasks", default="", help="Comma-separated [default: all].")
@click.option("--placements", default=4, show_default=True, type=click.IntRange(min=1))
@click.option("--seeds", default=1, show_default=True, type=click.IntRange(min=1))
@click.option(
    "--collection", default=1, show_default=True, help="Which placements; 0 is the one for development."
)
@click.option("--threads", default=2, show_default=True, type=click.IntRange(min=0))
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def planning(
    out: Path,
    names: str,
    tasks: str,
    placements: int,
    seeds: int,
    collection: int,
    threads: int,
    as_json: bool,
) -> None:
    """Plan random tasks with several planners, interleaved; every delivered motion is verified apart.

    Can be interrupted and continued: results.jsonl in --out is read first.
    """
    from rich.console import Console
    from rich.progress import Progress

    from s2r_host.planning.bench import runner
    from s2r_host.planning.bench.tasks import TASKS
    from s2r_protocol.exits import UsageError

    wanted = names.split(",")
    chosen: list[str] = tasks.split(",") if tasks else [*TASKS]
    for given, known, what in ((wanted, runner.planners(), "planner"), (chosen, TASKS, "task")):
        for name in given:
            if name not in known:
                raise UsageError(f"unknown {what} {name!r}; there are {', '.join(known)}")
    todo = list(runner.jobs(wanted, chosen, placements, seeds))
    with Progress(console=Console(stderr=True)) as progress:
        line = progress.add_task("planning", total=len(todo))
        done = {row["key"] for row in runner.read(out / "results.jsonl")}
        progress.advance(line, sum(job.key in done for job in todo))

        def tell(key: str) -> None:
            progress.update(line, description=key, advance=1)

        rows = runner.run(todo, out / "results.jsonl", collection, threads, tell)
    lines = runner.summary(rows)
    if as_json:
        click.echo(json.dumps(lines, indent=1))
        return
    for entry in lines:
        click.echo(_line(entry))
    for row in rows:
        if not row["verified"] and row["planner"] == "ours":
            why = (
                row.get("reason")
                if not row["delivered"]
                else (row["contacts"], row["violations"], row["held"])
            )
            click.echo(f"missed {row['key']}: {why}")


def _line(entry: dict[str, Any]) -> str:
    per = entry["cpu_per_success_s"]
    return (
        f"{entry['planner']:<16} {entry['planned']:>3}/{entry['plans']} planned  {entry['delivered']:>3} delivered  "
        f"{entry['verified']:>3} verified  CPU p50 {entry['cpu_p50_s']:.2f} p95 {entry['cpu_p95_s']:.2f} s  "
        f"wall p50 {entry['wall_p50_s']:.2f} p95 {entry['wall_p95_s']:.2f} s  "
        f"CPU per success {f'{per:.2f} s' if per else '-'}"
    )
