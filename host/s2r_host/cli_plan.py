"""``s2r plan``: plan through contact on any MJCF scene with an articulated object."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from s2r_host.plan_process import PLAN_FILES, PlanOrder, plan_in_process
from s2r_protocol.cli.options import SEED, FiniteRange
from s2r_protocol.cli.outputs import check_own_results
from s2r_protocol.cli.progress import progress_line
from s2r_protocol.exits import S2RError
from s2r_protocol.targets import read_joint_value


@click.command()
@click.option(
    "--scene",
    type=click.Path(path_type=Path),
    required=True,
    help="MJCF file with the object, and the arm or a body or site 'arm_base' for it.",
)
@click.option("--joint", required=True, help="The object's joint, a slide or a hinge.")
@click.option("--target", required=True, help="Where the joint shall end: 0.15, 150mm; 0.5, 30deg.")
@click.option("--arm", default="xmate3pro", show_default=True, help="Shipped arm, or a folder with arm.yaml.")
@click.option(
    "--tool", help="Put a tool into the gripper: t_shape or semi_ring; the arm with it goes to OUT/arm."
)
@click.option("--q0", help="Start pose of the arm, comma-separated [rad] [default: its home].")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    help="Folder for the results; an earlier plan there is replaced, other files are not.",
)
@click.option("--seed", type=SEED, default=0, show_default=True, help="Of all chance; same seed, same plan.")
@click.option(
    "--time-limit",
    "time_limit_s",
    type=FiniteRange(min=1.0),
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
    help="Score every sample with N believable objects, an odd number, and take their intervals from FILE: gap.json of "
    "'s2r gap' or model.json of 's2r build-model'. May be given several times; with a file alone N is 3.",
)
@click.option("--json", "as_json", is_flag=True, help="Print plan.json on standard output.")
def plan(
    scene: Path,
    joint: str,
    target: str,
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

    Writes plan.csv (t, q.<joint>; every 2 ms), plan.mcap for 's2r replay', knots.csv, plan.json, trace.csv, strip.png
    and model/ into --out.
    Scene and object start at their qpos0. Exit 4 with a reason when there is no plan; plan.json then has it as well.
    """
    check_own_results(out, "plan.json", ("success",), PLAN_FILES)
    s_target, target_type = read_joint_value(target, "--target")
    order = PlanOrder(
        scene=str(scene),
        joint=joint,
        target=s_target,
        target_type=target_type,
        arm=arm,
        tool=tool,
        q0=q0,
        out=str(out),
        seed=seed,
        time_limit_s=time_limit_s,
        threads=threads,
        ensemble=ensemble,
    )
    try:
        with progress_line() as tell:
            answer = plan_in_process(order, tell)
    except S2RError as error:
        click.echo(f"s2r plan: {error}", err=True)
        _print(out, as_json)
        sys.exit(int(error.exit_code))
    except (KeyboardInterrupt, RuntimeError):
        _print(out, as_json)
        raise
    _print(out, as_json)
    if as_json:
        return
    unit = answer["unit"]
    click.echo(
        f"joint {joint!r}: {answer['s_initial']:+.4f} to {answer['final']:+.4f} {unit} in "
        f"{answer['duration_s']:.1f} s, {answer['error']:+.4f} {unit} from the target, held; planned "
        f"in {answer['wall_s']:.1f} s"
    )
    if answer["fragile"]:
        click.echo(f"warning: {answer['fragile']}", err=True)
    if answer["creeps"]:
        click.echo(f"warning: {answer['creeps']}", err=True)
    click.echo(f"wrote {out}")


def _print(out: Path, as_json: bool) -> None:
    if as_json:
        click.echo((out / "plan.json").read_text(), nl=False)
