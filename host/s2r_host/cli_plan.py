"""``s2r plan``: plan through contact on any MJCF scene with an articulated object."""

from __future__ import annotations

import contextlib
import json
import logging
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import click

from s2r_protocol.exits import S2RError, UsageError


@click.command()
@click.option(
    "--scene",
    type=click.Path(path_type=Path),
    required=True,
    help="MJCF file with the object, and the arm or a body or site 'arm_base' for it.",
)
@click.option("--joint", required=True, help="The object's joint, a slide or a hinge.")
@click.option("--target", type=float, required=True, help="Where the joint shall end [m or rad].")
@click.option("--arm", default="xmate3pro", show_default=True, help="Shipped arm, or a folder with arm.yaml.")
@click.option(
    "--tool", help="Put a tool into the gripper: t_shape or semi_ring; the arm with it goes to OUT/arm."
)
@click.option("--q0", help="Start pose of the arm, comma-separated [rad] [default: its home].")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder for the results."
)
@click.option("--seed", default=0, show_default=True, help="Of all chance; same seed, same plan.")
@click.option(
    "--time-limit",
    "time_limit_s",
    type=click.FloatRange(min=1.0),
    default=120.0,
    show_default=True,
    help="Give up after so many seconds.",
)
@click.option(
    "--threads", type=click.IntRange(min=0), default=0, help="Of the rollouts; 0 takes all processors."
)
@click.option(
    "--ensemble",
    metavar="N|FILE",
    multiple=True,
    help="Score every sample with N believable objects, and take their intervals from FILE: gap.json of 's2r gap' or "
    "model.json of 's2r build-model'. May be given several times; with a file alone N is 3.",
)
@click.option("--json", "as_json", is_flag=True, help="Print plan.json on standard output.")
def plan(
    scene: Path,
    joint: str,
    target: float,
    arm: str,
    tool: str | None,
    q0: str | None,
    out: Path,
    seed: int,
    time_limit_s: float,
    threads: int,
    ensemble: tuple[str, ...],
    as_json: bool,
) -> None:
    """Plan how the arm moves a joint of an object in SCENE to a target value, without moving anything.

    Writes plan.csv (t, q.<joint>; every 2 ms), knots.csv, plan.json, trace.csv, strip.png and model/ into --out.
    Scene and object start at their qpos0. Exit 4 with a reason when there is no plan.
    """
    from s2r_host.planning.patience import Patience
    from s2r_host.planning.settings import PlanSettings
    from s2r_host.planning.tools import tool_named, write_arm_with_tool
    from s2r_host.trajectory.plan_scene import PlanTask, plan_scene
    from s2r_protocol.arms import load_arm

    logging.getLogger("toppra").setLevel(logging.ERROR)
    try:
        description = load_arm(arm)
        if tool is not None:
            description = write_arm_with_tool(description, tool_named(tool), out / "arm")
        members, doubt_files = _ensemble(ensemble)
        task = PlanTask(
            scene=scene,
            joint=joint,
            s_target=target,
            arm=description,
            out=out,
            q_initial=_posture(q0, description.joint_names),
            seed=seed,
            settings=PlanSettings(threads=threads, ensemble=members),
            doubt_files=doubt_files,
        )
        with _progress() as tell:
            answer = plan_scene(task, Patience(time_limit_s, tell))
    except S2RError as error:
        click.echo(f"s2r plan: {error}", err=True)
        if as_json:
            refused = {"success": False, "held": False, "reason": str(error), "seed": seed}
            saved = out / "plan.json"
            click.echo(saved.read_text() if saved.is_file() else json.dumps(refused, indent=1))
        sys.exit(int(error.exit_code))
    if as_json:
        click.echo(json.dumps(answer, indent=1))
        return
    unit = answer["unit"]
    click.echo(
        f"joint {joint!r}: {answer['s_initial']:+.4f} to {answer['final']:+.4f} {unit} in "
        f"{answer['duration_s']:.1f} s, {answer['error']:+.4f} {unit} from the target, held; planned "
        f"in {answer['wall_s']:.1f} s"
    )
    if answer["fragile"]:
        click.echo(f"warning: {answer['fragile']}", err=True)
    click.echo(f"wrote {out}")


_MEMBERS = 3  # of an ensemble whose size nobody told
_MOST_MEMBERS = 99


def _ensemble(values: tuple[str, ...]) -> tuple[int, tuple[Path, ...]]:
    """Number of members and files with intervals that ``--ensemble`` was given."""
    numbers = [int(value) for value in values if value.isdigit()]
    files = tuple(Path(value) for value in values if not value.isdigit())
    if len(numbers) > 1:
        raise UsageError(
            f"--ensemble was given {len(numbers)} numbers of members; give one, and files besides"
        )
    members = numbers[0] if numbers else (_MEMBERS if files else 1)
    if not 1 <= members <= _MOST_MEMBERS:
        raise UsageError(f"--ensemble {members} is not allowed: 1 to {_MOST_MEMBERS} believable objects")
    return members, files


def _posture(text: str | None, joint_names: tuple[str, ...]):  # noqa: ANN202 - numpy is imported late
    import numpy as np

    if text is None:
        return None
    try:
        values = [float(part) for part in text.replace(" ", "").split(",")]
    except ValueError as error:
        raise UsageError(f"--q0 {text!r}: expected comma-separated numbers [rad]") from error
    if len(values) != len(joint_names):
        raise UsageError(
            f"--q0 has {len(values)} numbers; the arm needs {len(joint_names)}: {', '.join(joint_names)}"
        )
    return np.array(values)


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """A line on standard error that says what is being done; gone at the end, absent where nobody looks."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        line = progress.add_task("starting", total=None)
        yield lambda text: progress.update(line, description=text)
