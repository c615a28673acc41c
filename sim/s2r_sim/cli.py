"""``s2r sim-arm`` and ``s2r world``."""

from __future__ import annotations

from pathlib import Path

import click

from s2r_protocol.cli.no_rendering import without_rendering
from s2r_protocol.cli.options import SEED, UNUSED_FOLDER, tls_option
from s2r_protocol.cli.outputs import check_new_file
from s2r_protocol.exits import UsageError

PACKINGS = ("fd", "classic")
CLOCKS = ("lockstep", "real")
SPLITS = ("train", "validation", "test")


@click.command("sim-arm")
@click.option(
    "--world", "world_file", type=click.Path(path_type=Path), help="World file, from 's2r world draw'."
)
@click.option("--seed", type=SEED, help="Draw a world instead of reading one.")
@click.option(
    "--kind",
    default="drawer",
    show_default=True,
    help="Kind of object in a drawn world: drawer, drawers, chest, laptop, faucet, door, lid or dial.",
)
@click.option(
    "--clock",
    type=click.Choice(CLOCKS),
    default="lockstep",
    show_default=True,
    help="lockstep: time goes on with the executor's setpoints; real: with the clock here. As the executor has it.",
)
@click.option(
    "--pace", type=float, default=1.0, show_default=True, help="Simulated over real seconds; 0: no limit."
)
@click.option(
    "--bus",
    default="unix:/tmp/s2r.sock",
    show_default=True,
    help="unix:PATH to listen on, or can:IFACE to join (vcan0).",
)
@click.option(
    "--packing",
    type=click.Choice(PACKINGS),
    default="fd",
    show_default=True,
    help="CAN FD at 1 kHz or classical CAN at 250 Hz, as the executor has it.",
)
@click.option(
    "--listen", default="tcp/127.0.0.1:7448", show_default=True, help="Zenoh endpoint of the camera."
)
@tls_option
@click.option(
    "--truth",
    "truth_file",
    type=click.Path(path_type=Path),
    help="New file to log what really happens in (CSV).",
)
@click.option("--cell", default="lab", show_default=True, help="Name of the cell in the key space.")
@click.option("--arm", "arm_name", default="xmate3pro", show_default=True, help="Name or folder of an arm.")
@click.option(
    "--inject",
    multiple=True,
    metavar="RULE",
    help="Disturb the bus: ACTION:ID@FIRST[-LAST], e.g. drop:0x183@100-140; repeatable. ACTION: drop (sent, received "
    "by nobody), corrupt (one bit of the payload flips), delay (one tick late), enobufs (the sender's queue is full). "
    "ID: a frame's identifier (docs/protocol.md), * for all. Ticks count from 0: the bus periods since this command "
    "began, in lock-step the executor's since it came. How many frames each rule met is printed at the end.",
)
@click.option("--ready-file", type=click.Path(path_type=Path), help="Created once everything listens.")
def sim_arm(
    world_file: Path | None,
    seed: int | None,
    kind: str,
    clock: str,
    pace: float,
    bus: str,
    packing: str,
    listen: str,
    tls: Path | None,
    truth_file: Path | None,
    cell: str,
    arm_name: str,
    inject: tuple[str, ...],
    ready_file: Path | None,
) -> None:
    """Run the stand-in: arm, object, drives, bus and camera of a hidden world.

    Prints the commitment (salted hash) of the world, never its contents.
    """
    if (world_file is None) == (seed is None):
        raise UsageError("give either --world FILE or --seed N")
    if truth_file is not None:
        check_new_file(truth_file)
    without_rendering()

    from s2r_protocol.arms import load_arm
    from s2r_sim.stand_in import StandInConfig, run_stand_in
    from s2r_sim.world import draw_world, load_world

    if world_file is not None:
        world = load_world(world_file)
    else:
        world = draw_world(seed or 0, kind, arm=load_arm(arm_name))
    config = StandInConfig(
        arm=arm_name,
        clock=clock,
        pace=pace,
        bus=bus,
        packing=packing,
        listen=listen,
        tls=tls,
        truth_file=truth_file,
        cell=cell,
        injections=inject,
        ready_file=ready_file,
    )
    run_stand_in(world, config)


@click.group()
def world() -> None:
    """Draw hidden worlds and commit to them."""


@world.command()
@click.option("--seed", type=SEED, required=True)
@click.option(
    "--kind",
    default="drawer",
    show_default=True,
    help="Kind of object: drawer, drawers, chest, laptop, faucet, door, lid or dial.",
)
@click.option("--arm", default="xmate3pro", show_default=True, help="Shipped arm, or a folder with arm.yaml.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="New file for the world (JSON).")
def draw(seed: int, kind: str, arm: str, out: Path) -> None:
    """Draw a world, write it to a file and print its commitment."""
    from s2r_protocol.arms import load_arm
    from s2r_sim.world import draw_world

    if out.exists():
        raise UsageError(
            f"'{out}' exists: another world there could not be held against its commitment; give another --out"
        )
    drawn = draw_world(seed, kind, arm=load_arm(arm))
    drawn.save(out)
    click.echo(drawn.commitment)


@world.command("object")
@click.option(
    "--kind", required=True, help="Kind of object: drawer, drawers, chest, laptop, faucet, door, lid or dial."
)
@click.option(
    "--split",
    type=click.Choice(SPLITS),
    default="train",
    show_default=True,
    help="Series of objects that --seed counts in; no two series share one.",
)
@click.option("--seed", type=SEED, required=True)
@click.option("--out", type=UNUSED_FOLDER, required=True, help="Folder, new or empty.")
def write_object(kind: str, split: str, seed: int, out: Path) -> None:
    """Write one procedural object as MJCF with its parameters and true joint."""
    from s2r_sim.objects import scene
    from s2r_sim.objects.splits import Split, draw_object

    scene.write_object(draw_object(kind, Split[split.upper()], seed), out)


@world.command()
@click.argument("file", type=click.Path(path_type=Path))
def commit(file: Path) -> None:
    """Print the commitment of a world file: the same as before the run, or somebody changed it."""
    from s2r_sim.world import load_world

    click.echo(load_world(file).commitment)
