"""``s2r run``: the whole loop on one object."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import click

from s2r_protocol.cli.no_rendering import without_rendering
from s2r_protocol.cli.options import SEED, UNUSED_FOLDER, FiniteRange, attempts_option, tls_option
from s2r_protocol.exits import UsageError

DEFAULT_EXECUTOR = "tcp/127.0.0.1:7447"
DEFAULT_CAMERA = "tcp/127.0.0.1:7448"


@click.command()
@click.argument("object_kind", metavar="OBJECT", type=click.Choice(["drawer", "laptop", "faucet"]))
@click.option(
    "--target",
    required=True,
    help="Joint value: 0 = as found, + = out of the cabinet or opening. 0.15, 150mm; -30deg, -0.52rad; or 'ask': "
    "read from standard input once the joint is known.",
)
@click.option(
    "--then",
    "further",
    multiple=True,
    help="A further target once the one before is reached, with all that was learnt meanwhile; may be given again.",
)
@click.option(
    "--from",
    "origin",
    type=click.Choice(["found", "pushed"]),
    default="found",
    show_default=True,
    help="What targets count from: the part as found, or as the first push leaves it.",
)
@click.option(
    "--at",
    metavar="X,Y,Z",
    help="Of several drawers or levers the one at this point [m, base frame, good to 8 cm]; else the host chooses.",
)
@click.option(
    "--push-near-axis",
    is_flag=True,
    help="Make the first push on a lever in its inner third, as if the rest were out of reach: an experiment.",
)
@click.option(
    "--executor", default=DEFAULT_EXECUTOR, show_default=True, help="Zenoh endpoint of the executor."
)
@click.option("--camera", default=DEFAULT_CAMERA, show_default=True, help="Zenoh endpoint of the camera.")
@click.option(
    "--out", type=UNUSED_FOLDER, default=None, help="Run folder, new or empty [default: runs/<time>]."
)
@click.option("--arm", default="xmate3pro", show_default=True, help="Shipped arm, or a folder with arm.yaml.")
@click.option("--cell", default="lab", show_default=True, help="Name of the cell in the key space.")
@tls_option
@click.option("--seed", type=SEED, default=0, show_default=True, help="Of all chance on the host.")
@attempts_option
@click.option(
    "--plan-time",
    type=FiniteRange(1.0),
    default=300.0,
    show_default=True,
    help="Begin no further try at a plan after so many seconds, nor at the next best after as many more.",
)
@click.option(
    "--ensemble",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Plan with so many believable objects, an odd number, drawn from the estimate's intervals.",
)
@click.option(
    "--reactive",
    is_flag=True,
    help="Watch the part while it is moved and correct the motion on its way; needs a camera that looks on.",
)
@click.option(
    "--learn-physics",
    is_flag=True,
    help="After every third target, ask 's2r gap' what the arm felt of the joint; plan on with what it names. After"
    " every target, learn how far beside the foreseen place motions leave the part.",
)
@click.option(
    "--go-on", is_flag=True, help="After a target that was missed or has no plan, go on to the next one."
)
@click.option(
    "--without",
    multiple=True,
    type=click.Choice(["torque", "touch", "gap"]),
    help="Do not learn from joint torques (mass, friction), from touches and misses (surfaces), or, with"
    " --learn-physics, what 's2r gap' names: an ablation.",
)
@click.option(
    "--acknowledge-contact",
    is_flag=True,
    help="After a collision stop on the way into contact, reset and back off; without it the run ends there.",
)
@click.option(
    "--dry-run", is_flag=True, help="Look and plan the first push from where the arm stands; move nothing."
)
@click.option("--json", "as_json", is_flag=True, help="Print run.json on standard output.")
def run(
    object_kind: str,
    target: str,
    further: tuple[str, ...],
    origin: str,
    at: str | None,
    push_near_axis: bool,
    executor: str,
    camera: str,
    out: Path | None,
    arm: str,
    cell: str,
    tls: Path | None,
    seed: int,
    attempts: int,
    plan_time: float,
    ensemble: int,
    reactive: bool,
    learn_physics: bool,
    go_on: bool,
    without: tuple[str, ...],
    acknowledge_contact: bool,
    dry_run: bool,
    as_json: bool,
) -> int:
    """Look at OBJECT, push it, build its model, plan, execute and measure, until it is at the target.

    Ctrl-C stops the arm on its path, waits for rest and still writes the recording. This is software, not an
    emergency stop.
    """
    without_rendering()
    from s2r_host.run.task import TASKS, parse_point

    task = TASKS[object_kind]
    place = None if at is None else parse_point(at)
    first = None if target == "ask" else task.targets.read(target)
    then = tuple(task.targets.read(one, "--then") for one in further)
    if learn_physics and len(then) < 2:
        raise UsageError(
            f"--learn-physics learns after every third target, and there are only {1 + len(then)}: add some with --then"
        )

    if push_near_axis and object_kind != "faucet":
        raise UsageError(f"--push-near-axis is about levers, and a {object_kind} has none; leave it out")

    from s2r_protocol.arms import load_arm
    from s2r_protocol.keys import ArmKeys

    ArmKeys(cell, load_arm(arm).name)

    # A slip of the hand above is told at once; what follows takes seconds to load.
    from s2r_host.motion.lever_proposals import LeverPushSettings
    from s2r_host.report.page import write_report
    from s2r_host.run.journal import Journal
    from s2r_host.run.pipeline import run_task
    from s2r_host.run.settings import RunSettings

    folder = out or Path("runs") / time.strftime("%Y%m%d-%H%M%S")
    settings = RunSettings(
        target=first,
        then=then,
        task=task,
        from_pushed=origin == "pushed",
        at=place,
        out=folder,
        executor=executor,
        camera=camera,
        cell=cell,
        tls=tls,
        arm=arm,
        seed=seed,
        attempts=attempts,
        plan_time_s=plan_time,
        ensemble=ensemble,
        reactive=reactive,
        learn_physics=learn_physics,
        go_on=go_on,
        without=without,
        acknowledge_contact=acknowledge_contact,
        dry_run=dry_run,
        lever_push=LeverPushSettings(near_axis=push_near_axis),
    )
    folder.mkdir(parents=True, exist_ok=True)  # before anything moves: a run that cannot be kept is none
    journal = Journal()
    record = run_task(settings, journal, tuple(sys.argv[1:]))
    click.echo(f"{'s2r run: ' if record.code else ''}{record.reason}", err=True)
    report = write_report(record, folder / "report.html")  # last: a disk may take no more
    click.echo(f"report: {report}", err=True)
    if as_json:
        click.echo(json.dumps(json.loads((folder / "run.json").read_text()), indent=1))
    return int(record.code)
