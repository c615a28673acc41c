"""``s2r replay``: send a recorded plan again, on a stand-in of its own or on the real arm, and compare."""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from s2r_host.log.recording_file import recording_file
from s2r_protocol.cli.options import UNUSED_FOLDER, FiniteRange, tls_option
from s2r_protocol.exits import ExitCode, UsageError

if TYPE_CHECKING:
    from s2r_host.link import ExecutorLink
    from s2r_host.motion.arm_model import ArmModel
    from s2r_host.motion.obstacles import Obstacle
    from s2r_host.replay.replay import Replayed
    from s2r_host.replay.sources import Replayable
    from s2r_protocol.arms import ArmDescription
    from s2r_protocol.keys import ArmKeys

DEFAULT_EXECUTOR = "tcp/127.0.0.1:7447"


@click.command()
@click.argument("source", metavar="SOURCE", type=click.Path(path_type=Path, exists=True))
@click.option(
    "--plan", "number", type=int, default=None, help="Plan number [default: the first manipulation]."
)
@click.option("--list", "only_list", is_flag=True, help="Only list the plans.")
@click.option(
    "--speed",
    type=FiniteRange(0, 1, min_open=True),
    default=1.0,
    show_default=True,
    help="Share of the recorded speed.",
)
@click.option(
    "--from",
    "t_start",
    type=float,
    default=0.0,
    show_default=True,
    help="Begin at this plan time [s]. An arm that does not stand there plays the plan up to it first, at half speed.",
)
@click.option("--step", "step_s", type=FiniteRange(0), default=0.0, help="Pause after each so many seconds.")
@click.option(
    "--loop",
    "loops",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    help="Replays; 2 or more: statistics.",
)
@click.option("--real", is_flag=True, help="Send it to the executor at --executor instead of a stand-in.")
@click.option("--yes", is_flag=True, help="With --real: do not ask.")
@click.option(
    "--executor", default=None, help=f"With --real: its Zenoh endpoint [default: {DEFAULT_EXECUTOR}]."
)
@click.option(
    "--camera", default=None, help="With --real: a camera; the way to the start also avoids what it sees."
)
@click.option(
    "--world",
    type=click.Path(path_type=Path, exists=True),
    help="Stand-in's world, not with --real [default: SOURCE's own].",
)
@click.option("--out", type=UNUSED_FOLDER, help="Folder, new or empty [default: replay-<plan> beside].")
@click.option("--arm", default="xmate3pro", show_default=True, help="Shipped arm, or a folder with arm.yaml.")
@click.option("--cell", default="lab", show_default=True, help="Name of the cell in the key space.")
@tls_option
@click.option(
    "--json", "as_json", is_flag=True, help="Print the comparison, or the plans, on standard output."
)
def replay(
    source: Path,
    number: int | None,
    only_list: bool,
    speed: float,
    t_start: float,
    step_s: float,
    loops: int,
    real: bool,
    yes: bool,
    executor: str | None,
    camera: str | None,
    world: Path | None,
    out: Path | None,
    arm: str,
    cell: str,
    tls: Path | None,
    as_json: bool,
) -> int:
    """Send a plan of SOURCE through admission again and compare the executions.

    SOURCE is the folder of a run or of 's2r plan', a recording, or a table (.csv) of t [s] and q.<joint> [rad].

    On a stand-in of its own by default; --real sends it to a running executor, after showing where it starts and
    how fast it gets. The arm first goes to the start: along the plans recorded before it when it
    stands where one of them begins, else by a move checked against the arm and the table. A stand-in gets all of them,
    so that the object is where the plan met it; with --real nothing puts the object back.
    With --from it then plays the plan itself up to that time, at half of its speed, and comes to rest there: only that
    way is free of the object, which it moves.
    """
    for name, value in (("--executor", executor), ("--camera", camera), ("--tls", tls), ("--yes", yes)):
        if value and not real:
            raise UsageError(
                f"{name} is for a running executor: add --real, or leave it out to use a stand-in"
            )
    if real and world is not None:
        raise UsageError(
            "--world is what a stand-in shows, and --real goes to a running executor: leave out --world, or --real to "
            "use a stand-in"
        )
    recording_file(source)  # refuses a folder without one before all that is loaded now
    from s2r_host.motion.arm_model import ArmModel
    from s2r_host.replay.replay import ReplaySettings, as_sent, replay_plan
    from s2r_host.replay.sources import pick, read_source
    from s2r_protocol.arms import load_arm
    from s2r_protocol.keys import ArmKeys

    description = load_arm(arm)
    plans = read_source(source, description)
    if only_list and as_json:
        listed = [
            {
                "plan": plan.number,
                "label": plan.label,
                "duration_s": plan.trajectory.duration_s,
                "broken_off_s": plan.cut_s,
            }
            for plan in plans
        ]
        click.echo(json.dumps(listed, indent=1))
        return int(ExitCode.OK)
    if only_list:
        for plan in plans:
            cut = "" if plan.cut_s is None else f"  (broken off by a stop at {plan.cut_s:.2f} s)"
            click.echo(f"{plan.number:3d}  {plan.trajectory.duration_s:6.2f} s  {plan.label}{cut}")
        return int(ExitCode.OK)
    plan = pick(plans, number, source)
    settings = ReplaySettings(speed, t_start, step_s, _ask_next)
    sent = as_sent(plan, settings)
    folder = out or _unused((source if source.is_dir() else source.parent) / f"replay-{plan.number}")
    keys = ArmKeys(cell, description.name)
    model = ArmModel(description)

    def report(done: Sequence[Replayed]) -> int:
        return _report(done, description, source, folder, as_json, "real" if real else "stand-in", speed)

    if real:
        endpoint = executor or DEFAULT_EXECUTOR
        with _linked(endpoint, description, keys, tls) as link:
            link.check_records()  # the comparison needs one; told before the arm moves
            _confirm(plan, sent, t_start, description, endpoint, yes)

            def on_the_arm(_: int) -> Replayed:
                """Looking anew each time: the one before has moved the object."""
                obstacles = _seen(camera, keys, tls, model, link.status().q_meas)
                return replay_plan(link, model, plan, settings, obstacles, plans)

            return _replays(loops, on_the_arm, folder, report)
    from s2r_protocol.cli.peers import stand_in_cell

    drawn = world or _own_world(source)
    if drawn is None:
        click.echo(
            f"s2r replay: no world file beside {source}: the stand-in shows the drawer of seed 1. If the plan was "
            "made for another, draw that with 's2r world draw --seed N --out FILE' and give --world FILE",
            err=True,
        )
    shown = ("--world", drawn) if drawn else ("--seed", "1")
    cell_options = ("--cell", cell, "--arm", arm)

    def on_a_stand_in(number: int) -> Replayed:
        """On a stand-in of its own: the one before has moved the object, and may still hold it."""
        place = folder / ("stand-in" if loops == 1 else f"stand-in-{number}")
        with (
            stand_in_cell(place, shown, stand_in=cell_options, executor=cell_options) as started,
            _linked(started.executor, description, keys, None) as link,
        ):
            return replay_plan(link, model, plan, settings, (), plans, as_found=True)

    return _replays(loops, on_a_stand_in, folder, report)


def _unused(folder: Path) -> Path:
    """The folder, or with a number behind it: an earlier replay is kept."""
    candidates = itertools.chain(
        [folder], (folder.with_name(f"{folder.name}-{k}") for k in itertools.count(2))
    )
    return next(one for one in candidates if not one.exists())


def _replays(
    loops: int, once: Callable[[int], Replayed], folder: Path, report: Callable[[Sequence[Replayed]], int]
) -> int:
    """``once`` for the numbers from 1 on, and what ``report`` makes of them; each one's recording is written at once.

    Whatever ends the row of them, those that were made are reported.
    """
    done: list[Replayed] = []
    try:
        _one_by_one(loops, once, folder, done)
    except BaseException:
        if done:
            click.echo(f"s2r replay: {len(done)} of {loops} replays were made before it ended:", err=True)
            report(done)
        raise
    return report(done)


def _one_by_one(loops: int, once: Callable[[int], Replayed], folder: Path, done: list[Replayed]) -> None:
    with click.progressbar(length=loops, label="replays", file=sys.stderr, hidden=loops == 1) as bar:
        for number in range(1, loops + 1):
            done.append(once(number))
            folder.mkdir(parents=True, exist_ok=True)
            name = "replay.mcap" if loops == 1 else f"replay-{number}.mcap"
            (folder / name).write_bytes(done[-1].recording)
            bar.update(1)


def _report(
    done: Sequence[Replayed],
    arm: ArmDescription,
    source: Path,
    folder: Path,
    as_json: bool,
    where: str,
    speed: float,
) -> int:
    from s2r_host.replay.overlay import write_overlay
    from s2r_host.replay.replay import repeatability

    last = done[-1]
    spread = repeatability(done, arm.joint_names) if len(done) > 1 else None
    page = write_overlay(last, arm.joint_names, source, folder, spread, speed)
    rms = dict(zip(arm.joint_names, last.comparison.rms_rad.tolist(), strict=True))
    values: dict[str, Any] = {
        "plan": last.plan.number,
        "label": last.plan.label,
        "where": where,
        "speed": speed,
        "plan_seq": last.seq,
        "against": "first execution" if last.plan.first is not None else "plan",
        "rms_rad": rms,
        "page": str(page),
    }
    if last.left_out:
        values["left_out"] = [one.number for one in last.left_out]
        named = ", ".join(f"{one.number} '{one.label}'" for one in last.left_out)
        click.echo(
            f"s2r replay: not sent before it: plans {named}; they do not form one row with it (one was stopped or "
            "changed on its way), so the object need not stand where the plan met it",
            err=True,
        )
    if spread is not None:
        values["loops"] = len(done)
        values["sigma_rad"] = dict(zip(arm.joint_names, spread.sigma_rad.tolist(), strict=True))
        values["range_rad"] = dict(zip(arm.joint_names, spread.range_rad.tolist(), strict=True))
    (folder / "replay.json").write_text(json.dumps(values, indent=1) + "\n")
    if as_json:
        click.echo(json.dumps(values, indent=1))
        return int(ExitCode.OK)
    click.echo(
        f"plan {last.plan.number} '{last.plan.label}' replayed on the {'arm' if where == 'real' else where}; "
        f"RMS difference to its {values['against']} per joint [mrad]:"
    )
    click.echo("  " + "  ".join(f"{name} {1e3 * value:.3f}" for name, value in rms.items()))
    if spread is not None:
        click.echo(f"repeatability of {len(done)} replays, standard deviation per joint [mrad]:")
        click.echo("  " + "  ".join(f"{n} {1e3 * v:.4f}" for n, v in values["sigma_rad"].items()))
    click.echo(f"overlay: {page}")
    return int(ExitCode.OK)


@contextmanager
def _linked(endpoint: str, arm: ArmDescription, keys: ArmKeys, tls: Path | None) -> Iterator[ExecutorLink]:
    from s2r_host.link import ExecutorLink

    with ExecutorLink(endpoint, arm, keys, tls=tls) as link:
        link.wait_for_drives()
        yield link


def _confirm(
    plan: Replayable, sent: Any, t_start: float, arm: ArmDescription, endpoint: str, yes: bool
) -> None:
    """Show where it starts, how it gets there and how fast it gets; go on only when told to.

    Raises:
        UsageError: Nobody is there to answer.
    """
    import numpy as np

    times = np.linspace(0.0, sent.duration_s, 500)
    fastest = np.abs(sent.sample(times)[1]).max(axis=0)
    click.echo(
        f"plan {plan.number} '{plan.label}', {sent.duration_s:.2f} s, to the executor at {endpoint}", err=True
    )
    click.echo("  joint      starts at [rad]   fastest [rad/s]   of its limit", err=True)
    for i, name in enumerate(arm.joint_names):
        share = fastest[i] / arm.limits.dq_max[i]
        click.echo(f"  {name:10s} {sent.q[0, i]:+15.4f} {fastest[i]:17.3f} {share:13.0%}", err=True)
    if t_start > 0.0:
        click.echo(
            f"  unless the arm stands there, the plan's first {t_start:g} s are played before, at half of its speed; "
            "they move what they moved",
            err=True,
        )
    if yes:
        return
    if not sys.stdin.isatty():
        raise UsageError("--real moves an arm and nobody can be asked here; add --yes when the cell is clear")
    click.confirm("Is the cell clear and a hand on the emergency stop?", abort=True, err=True)


def _ask_next(t: float) -> bool:
    answer = click.prompt(
        f"paused at {t:.2f} s; Enter to go on, s to stop", default="", show_default=False, err=True
    )
    return answer.strip().lower() != "s"


def _own_world(source: Path) -> Path | None:
    """The hidden world a demo's run was made in: the stand-in opens it, the host does not."""
    folder = source if source.is_dir() else source.parent
    for candidate in (folder / "world.json", folder.parent / "world.json"):
        if candidate.is_file():
            return candidate
    return None


def _seen(camera: str | None, keys: ArmKeys, tls: Path | None, arm: ArmModel, q_meas: Any) -> list[Obstacle]:
    if camera is None:
        return []
    from s2r_host.link import CameraLink
    from s2r_host.motion.obstacles import cloud_obstacle
    from s2r_host.motion.robot_mask import robot_mask
    from s2r_host.motion.scene import observed_scene

    with CameraLink(camera, keys, tls=tls) as link:
        frame = link.capture().frame
    scene = observed_scene(frame, robot_mask(arm, q_meas, frame))
    return [cloud_obstacle(scene.p_base, scene.p_camera)]
