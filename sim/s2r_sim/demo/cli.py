"""``s2r demo``: hidden world, stand-in, executor and host, started as an operator would, then scored."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import click

from s2r_protocol.cli.ending import hear, restore
from s2r_protocol.cli.options import SEED, UNUSED_FOLDER, FiniteRange, attempts_option
from s2r_protocol.exits import ExitCode

if TYPE_CHECKING:
    from s2r_sim.demo.goals import Goal
    from s2r_sim.demo.verdict import DemoVerdict


@click.command()
@click.option("--seed", type=SEED, default=1, show_default=True, help="Which hidden object.")
@click.option(
    "--object",
    "kind",
    type=click.Choice(["drawer", "drawers", "laptop", "faucet"]),
    default="drawer",
    show_default=True,
    help="drawers: two in one chest, both of which move.",
)
@click.option(
    "--target",
    help="Joint value; 0 = as found, + = out, opening or counter-clockwise  [default: 150mm, 100mm, -35deg or 30deg].",
)
@click.option(
    "--then", "further", multiple=True, help="A further target once the one before is reached, see s2r run."
)
@click.option("--arm", default="xmate3pro", show_default=True, help="Shipped arm, or a folder with arm.yaml.")
@attempts_option
@click.option("--reactive", is_flag=True, help="The host watches the part while it moves it, see s2r run.")
@click.option(
    "--clock",
    type=click.Choice(["lockstep", "real"]),
    default="lockstep",
    show_default=True,
    help="lockstep: simulated time, as fast as --pace and the work allow; real: this machine's clock.",
)
@click.option(
    "--pace",
    type=FiniteRange(0, 1000),
    default=1.0,
    show_default=True,
    help="Lock-step: simulated over real seconds; 0: no limit.",
)
@click.option(
    "--packing",
    type=click.Choice(["fd", "classic"]),
    default="fd",
    show_default=True,
    help="CAN FD at 1 kHz or classical CAN at 250 Hz.",
)
@click.option("--out", type=UNUSED_FOLDER, help="Folder, new or empty [default: runs/demo-<object>-<time>].")
@click.option("--json", "as_json", is_flag=True, help="Print the verdict on standard output.")
def demo(
    seed: int,
    kind: str,
    target: str | None,
    further: tuple[str, ...],
    arm: str,
    attempts: int,
    reactive: bool,
    clock: str,
    pace: float,
    packing: str,
    out: Path | None,
    as_json: bool,
) -> int:
    """Move a never-seen drawer, laptop lid or faucet end to end on the stand-in, then open the sealed truth.

    Exit 0: it is truly within 5 mm, 2° or 3° of the target. 7: it is not. Otherwise the failing part's code.
    """
    from s2r_protocol.arms import load_arm
    from s2r_sim.demo.goals import GOALS
    from s2r_sim.demo.processes import free_port, peer, s2r_command
    from s2r_sim.demo.verdict import draw_truth, open_truth
    from s2r_sim.sealed import TRUTH, WORLD, host_seed, out_of_sight

    goal, asked = GOALS[kind], target or GOALS[kind].target
    # What is no arm, no number or no angle of this kind is refused before anything starts.
    load_arm(arm)
    goal.targets.read(asked)
    for one in further:
        goal.targets.read(one, "--then")
    folder = out or Path("runs") / f"demo-{kind}-{time.strftime('%Y%m%d-%H%M%S')}"
    folder.mkdir(parents=True, exist_ok=True)
    camera, executor = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    both = ("--arm", arm, "--clock", clock, "--pace", str(pace), "--packing", packing)
    with out_of_sight(folder) as hidden, tempfile.TemporaryDirectory(prefix="s2r-") as sockets:
        world, truth, bus = hidden / WORLD, hidden / TRUTH, f"unix:{sockets}/bus.sock"
        _say(f"drawing hidden {kind} {seed}")
        drawn = subprocess.run(
            s2r_command("world", "draw", "--kind", kind, "--seed", str(seed), "--arm", arm, "--out", world),
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
        if drawn.returncode != ExitCode.OK:
            return drawn.returncode  # it has said why
        published = drawn.stdout.strip()
        _say(f"commitment to the hidden world: {published}")
        stand_in = (
            "sim-arm",
            "--world",
            world,
            "--truth",
            truth,
            "--bus",
            bus,
            "--listen",
            camera,
            *both,
        )
        front_end = ("executor", "--record", folder / "recordings", "--bus", bus, "--listen", executor, *both)
        host = (
            "run",
            goal.targets.kind,
            f"--target={asked}",
            *(f"--then={one}" for one in further),
            "--attempts",
            str(attempts),
            "--acknowledge-contact",
            "--seed",
            str(host_seed(seed)),
            "--arm",
            arm,
            *(["--reactive"] if reactive else []),
        )
        _say("starting stand-in and executor")
        with peer("sim-arm", stand_in, folder), peer("executor", front_end, folder):
            ended = _run_host([*host, "--executor", executor, "--camera", camera, "--out", folder / "run"])
    if ended == ExitCode.INTERRUPTED or not (folder / "run/run.json").exists():
        return ended  # without a run there is nothing to judge, and the host has said why
    verdict = open_truth(seed, folder, published)
    picture = draw_truth(folder, verdict, goal)
    (folder / "demo.json").write_text(json.dumps(verdict.as_dict(), indent=1) + "\n")
    _print_verdict(verdict, picture, goal)
    if as_json:
        click.echo(json.dumps(verdict.as_dict(), indent=1))
    if ended not in (ExitCode.OK, ExitCode.DIFFERENCE):
        return ended
    within = abs(verdict.delta_true) <= goal.tolerance and verdict.commitment_holds
    return int(ExitCode.OK if within else ExitCode.DIFFERENCE)


def _run_host(arguments: list[str | Path]) -> int:
    """Run the host in the foreground; it brings the arm to rest before executor and stand-in go.

    Signals reach only us and are passed on, whether a terminal sent them to all of its processes or somebody to one.
    """
    from s2r_sim.demo.processes import with_parent

    host = subprocess.Popen(with_parent(*arguments), stdout=sys.stderr, start_new_session=True)

    def pass_on(number: int, _frame: FrameType | None) -> None:
        if number == signal.SIGINT:
            _say("interrupted: waiting for the host to bring the arm to rest")
        host.send_signal(number)

    before = hear(pass_on)
    try:
        return host.wait()
    finally:
        restore(before)


def _say(text: str) -> None:
    click.secho(f"demo: {text}", err=True, bold=True)


def _print_verdict(verdict: DemoVerdict, picture: Path, goal: Goal) -> None:
    from rich.console import Console
    from rich.table import Table

    def shown(value: float | None) -> str:
        return "–" if value is None else goal.targets.unit.show(value)

    table = Table(title="the sealed world, opened", show_header=False, title_justify="left")
    table.add_row("target", shown(verdict.s_target))
    table.add_row("true joint value", shown(verdict.s_true))
    table.add_row("true δ after the first attempt", shown(verdict.delta_first_true))
    table.add_row("true δ at the end", f"[bold]{shown(verdict.delta_true)}[/]")
    if len(verdict.deltas_true) > 1:
        table.add_row("true δ of every target", ", ".join(shown(delta) for delta in verdict.deltas_true))
    table.add_row("true δ_r", "–" if verdict.delta_r_true is None else f"{100 * verdict.delta_r_true:+.1f} %")
    table.add_row("δ as the camera saw it", shown(verdict.delta_measured))
    if verdict.others_moved:
        moved = ", ".join(shown(change) for change in verdict.others_moved)
        table.add_row("other parts moved by", moved)
    table.add_row("planned manipulations", str(verdict.attempts))
    table.add_row(
        "commitment", "holds" if verdict.commitment_holds else "[red]BROKEN: the world file was changed[/]"
    )
    table.add_row("truth over time", str(picture))
    table.add_row("report", f"[bold]{verdict.report}[/]")
    Console(stderr=True).print(table)
