"""``s2r bench planning``: success and cost of the planner, against others, measured on this machine."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from s2r_protocol.cli.options import FiniteRange


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder; results.jsonl is continued."
)
@click.option(
    "--planners", "names", default="ours,paper", show_default=True, help="Comma-separated, interleaved."
)
@click.option("--tasks", "tasks", default="", help="Comma-separated [default: all within reach].")
@click.option(
    "--placements",
    default=4,
    show_default=True,
    type=click.IntRange(min=1),
    help="Of the object, per task.",
)
@click.option(
    "--seeds", default=1, show_default=True, type=click.IntRange(min=1), help="Of the planner, per placement."
)
@click.option(
    "--collection",
    default=1,
    show_default=True,
    type=click.IntRange(min=0),
    help="Which placements; 0 is the one for development.",
)
@click.option(
    "--threads",
    default=2,
    show_default=True,
    type=click.IntRange(min=0),
    help="Of the rollouts; 0 takes all processors.",
)
@click.option(
    "--replays",
    default=0,
    show_default=True,
    type=click.IntRange(min=0),
    help="Plays of each motion with objects drawn at random.",
)
@click.option(
    "--doubt",
    type=click.Choice(["usual", "built"]),
    default="usual",
    show_default=True,
    help="What the objects may differ in; built: in their joints too, as far as the model builder leaves them open.",
)
@click.option(
    "--pieces",
    default=0,
    show_default=True,
    type=click.IntRange(min=0),
    help="Cut each of the objects' boxes into so many convex meshes; 0: leave them as they are.",
)
@click.option(
    "--coacd", "decomposed", is_flag=True, help="Replace each body's boxes by what CoACD makes of them."
)
@click.option("--arm", default="xmate3pro", show_default=True, help="Shipped arm, or a folder with arm.yaml.")
@click.option("--tool", default="", help="Held by the gripper: t_shape or semi_ring [default: none].")
@click.option("--plan-only", is_flag=True, help="No time law and no verifier: the planner alone.")
@click.option(
    "--patience",
    "patience_s",
    default=300.0,
    show_default=True,
    type=FiniteRange(min=0.0, min_open=True),
    help="Longest that a plan may be computed [s].",
)
@click.option(
    "--curve", type=click.Path(path_type=Path, dir_okay=False), help="Picture of success over CPU time."
)
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def planning(
    out: Path,
    names: str,
    tasks: str,
    placements: int,
    seeds: int,
    collection: int,
    threads: int,
    replays: int,
    doubt: str,
    pieces: int,
    decomposed: bool,
    arm: str,
    tool: str,
    plan_only: bool,
    patience_s: float,
    curve: Path | None,
    as_json: bool,
) -> None:
    """Plan random tasks with several planners, interleaved; every delivered motion is verified apart.

    Can be interrupted and continued with the same options: results.jsonl in --out is read first. Other placements,
    seeds, tasks and planners may be added; anything else needs another --out (results.conditions.json).
    """
    from rich.console import Console
    from rich.progress import Progress

    from s2r_host.planning.bench import runner
    from s2r_host.planning.bench.curve import draw_curve
    from s2r_host.planning.bench.planners import planner_named
    from s2r_host.planning.bench.summary import by_task, ratios, summary
    from s2r_host.planning.bench.tasks import TASKS
    from s2r_protocol.cli.outputs import check_place
    from s2r_protocol.exits import UsageError

    if curve is not None:
        check_place(curve)
    if pieces and decomposed:
        raise UsageError("--pieces and --coacd exclude each other: give one of them")
    wanted = names.split(",")
    for name in wanted:
        planner_named(name)
    chosen: list[str] = tasks.split(",") if tasks else [name for name in TASKS if name != "drawer_far"]
    for name in chosen:
        if name not in TASKS:
            raise UsageError(f"unknown task {name!r}; there are {', '.join(TASKS)}")
    todo = list(runner.jobs(wanted, chosen, placements, seeds))
    with Progress(console=Console(stderr=True)) as progress:
        line = progress.add_task("planning", total=len(todo))
        done = {row["key"] for row in runner.read(out / "results.jsonl")}
        progress.advance(line, sum(job.key in done for job in todo))

        def tell(key: str) -> None:
            progress.update(line, description=key, advance=1)

        conditions = runner.Conditions(
            collection, threads, replays, plan_only=plan_only, patience_s=patience_s, arm=arm, tool=tool,
            pieces=pieces, doubt=doubt, decomposed=decomposed,
        )  # fmt: skip
        rows = runner.run(todo, out / "results.jsonl", conditions, tell)
    if curve is not None:
        draw_curve(rows, curve)
    lines, compared = summary(rows), ratios(rows, wanted[0])
    if as_json:
        click.echo(json.dumps({"planners": lines, "tasks": by_task(rows), "ratios": compared}, indent=1))
        return
    for entry in by_task(rows):
        click.echo(f"{entry['task']:<14} {_line(entry)}")
    for entry in lines:
        click.echo(f"{'all':<14} {_line(entry)}")
    for entry in compared:
        click.echo(f"CPU per held success, {entry['planner']} over {wanted[0]}: {_ratio(entry)}")
    for row in rows:
        problem = _problem(row, plan_only)
        if problem is not None:
            click.echo(f"missed {row['key']}: {problem}")


def _problem(row: dict[str, Any], plan_only: bool) -> str | None:
    """Why a row is no success, or None."""
    if not row["planned"] or not (row["delivered"] or plan_only):
        return str(row.get("reason"))
    if plan_only or row["verified"]:
        return None
    held = "held" if row["held"] else f"not held ({row['worst_hold']:.4f} off)"
    return "; ".join([held, *row["contacts"], *row["violations"]])


def _ratio(entry: dict[str, Any]) -> str:
    if entry["ratio"] is None:
        return f"one of the two holds none of {entry['jobs']} tasks"
    return f"{entry['ratio']:.1f} [{entry['low']:.1f}, {entry['high']:.1f}] over {entry['jobs']} tasks"


def _line(entry: dict[str, Any]) -> str:
    per, interval = entry["cpu_per_success_s"], entry["cpu_per_success_90"]
    low, high = (100 * bound for bound in entry["planned_90"])
    text = (
        f"{entry['planner']:<18} {entry['planned']:>3}/{entry['plans']} planned ({low:.0f} to {high:.0f} %)  "
        f"{entry['delivered']:>3} delivered  "
        f"{entry['verified']:>3} verified  CPU p50 {entry['cpu_p50_s']:.2f} p95 {entry['cpu_p95_s']:.2f} s  "
        f"wall p50 {entry['wall_p50_s']:.2f} p95 {entry['wall_p95_s']:.2f} s  CPU per success "
    )
    text += f"{per:.2f} s" if per else "-"
    if interval:
        text += f" [{interval[0]:.2f}, {interval[1]:.2f}]"
    if entry["replays"]:
        text += f"  replays {entry['replays_good']}/{entry['replays']} within 30 %"
    return text
