"""``s2r bench executor``."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from s2r_protocol.exits import UsageError

CONDITION_NAMES = ("alone", "zenoh", "mujoco", "hogs", "killed")
DEFAULT_TICKS = 1_000_000
FIGURE_NAMES = ("admission", "memory", "stop_latency", "bus_load", "splices", "stepped_clock")


@click.command()
@click.option("--slices", type=click.IntRange(1), default=5, show_default=True, help="Per load.")
@click.option("--seconds", type=click.IntRange(1), default=10, show_default=True, help="Of each slice.")
@click.option(
    "--load", "loads", multiple=True, type=click.Choice(CONDITION_NAMES), help="Only these. [default: all]"
)
@click.option(
    "--ticks",
    type=click.IntRange(1),
    default=DEFAULT_TICKS,
    show_default=True,
    help="Of the stepped clock with the stand-in.",
)
@click.option("--cpu", type=int, help="Of the loop and its reference [default: the last one].")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("runs/bench-executor"),
    show_default=True,
    help="Slices are kept here: a second call measures only what is missing.",
)
@click.option("--fresh", is_flag=True, help="Measure everything again.")
@click.option(
    "--write",
    type=click.Path(dir_okay=False, exists=True, path_type=Path),
    help="Page to put the tables in, e.g. docs/benchmarks/executor.md.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def executor(
    slices: int,
    seconds: int,
    loads: tuple[str, ...],
    ticks: int,
    cpu: int | None,
    out: Path,
    fresh: bool,
    write: Path | None,
    as_json: bool,
) -> None:
    """The real-time loop against a reference thread, and what the executor costs.

    Needs real-time rights, two CPUs and the stand-in ('sim'). Interrupt it whenever you like: it goes on where it was.
    """
    from s2r_executor.bench import figures as measured
    from s2r_executor.bench import long_run
    from s2r_executor.bench.report import summarise, to_markdown, write_into
    from s2r_executor.bench.slice import SliceSettings, run_slice

    chosen = loads or CONDITION_NAMES
    usable = os.sched_getaffinity(0)
    core = max(usable) if cpu is None else cpu
    if core not in usable:
        raise UsageError(f"--cpu {core}: this process may use {', '.join(map(str, sorted(usable)))}")
    out.mkdir(parents=True, exist_ok=True)
    tasks: dict[str, Callable[[], Any]] = {
        f"{name}-{seconds}s-{k}": lambda name=name: run_slice(SliceSettings(name, seconds, core))
        for k in range(slices)  # loads take turns, so that a change of the machine hits all of them
        for name in chosen
    }
    figure_tasks: dict[str, Callable[[], Any]] = {
        "admission": measured.admission_time,
        "memory": measured.memory,
        "stop_latency": measured.stop_latency,
        "bus_load": measured.bus_load,
        "splices": long_run.splices,
        "stepped_clock": lambda: long_run.stepped_clock(ticks),
    }
    names = {name: f"figure-{name}" for name in figure_tasks}
    if ticks != DEFAULT_TICKS:
        names["stepped_clock"] += f"-{ticks}"
    results = _run_all(tasks | {names[name]: task for name, task in figure_tasks.items()}, out, fresh)
    result = {
        "command": f"s2r bench executor --slices {slices} --seconds {seconds}",
        "machine": _machine(),
        "preflight": _preflight(),
        "slices": [results[name] for name in tasks],
        "summary": summarise([results[name] for name in tasks]),
        "figures": {name: results[kept] for name, kept in names.items()},
    }
    (out / "result.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    markdown = to_markdown(result)
    if write is not None:
        write_into(write, markdown)
    click.echo(json.dumps(result, indent=1) if as_json else markdown)


def _run_all(tasks: dict[str, Callable[[], Any]], out: Path, fresh: bool) -> dict[str, Any]:
    """Run what has no result yet, each kept as soon as it is there."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    results: dict[str, Any] = {}
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        bar = progress.add_task("bench executor", total=len(tasks))
        for name, task in tasks.items():
            progress.update(bar, description=f"bench executor: {name}")
            path = out / f"{name}.json"
            if path.exists() and not fresh:
                results[name] = json.loads(path.read_text(encoding="utf-8"))
            else:
                results[name] = task()
                part = path.with_suffix(".part")
                part.write_text(json.dumps(results[name], indent=1) + "\n", encoding="utf-8")
                part.replace(path)
            progress.advance(bar)
    return results


def _machine() -> str:
    name = "unknown CPU"
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            name = line.partition(":")[2].strip()
            break
    return f"{len(os.sched_getaffinity(0))} CPUs ({name}), Linux {platform.release().split('-')[0]}"


def _preflight() -> str:
    from s2r_protocol.machine.realtime import Verdict, judge, read_facts, worst

    checks = judge(read_facts())
    bad = [f"{c.topic}: {c.text}" for c in checks if c.verdict != Verdict.RT_OK]
    return worst(checks).name + (f" ({'; '.join(bad)})" if bad else "")
