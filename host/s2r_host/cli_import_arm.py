"""``s2r import-arm``: a first arm.yaml from the URDF of an arm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import click

from s2r_protocol.cli.options import UNUSED_FOLDER, FiniteRange
from s2r_protocol.exits import ExitCode, UsageError

_POSITIVE = FiniteRange(min=0.0, min_open=True)


@click.command()
@click.argument("urdf", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--out", type=UNUSED_FOLDER, required=True, help="Folder for arm.yaml, new or empty.")
@click.option(
    "--base",
    default="",
    help="Link that stands on the table, z up [default: the first with a mass or a shape].",
)
@click.option(
    "--tip",
    default="",
    help="Link whose frame is at the fingertip, z out of the gripper [default: the only one at the end].",
)
@click.option(
    "--tip-axis",
    type=click.Choice(["x", "y", "z", "-x", "-y", "-z"]),
    default="z",
    show_default=True,
    help="Axis of the tip's frame that points out of the gripper.",
)
@click.option(
    "--leave-out",
    "left_out",
    multiple=True,
    metavar="LINK",
    help="Link that is left out with all that hangs off it, a second arm or a pedestal; repeatable.",
)
@click.option("--name", default="", help="Name of the arm in keys [default: the robot's].")
@click.option(
    "--hold",
    multiple=True,
    metavar="JOINT=VALUE",
    help="Keep a joint at a value [rad, m], e.g. a gripper's where it is closed; repeatable. "
    "Joints off the way to the tip are held at 0 otherwise.",
)
@click.option(
    "--finger",
    "fingers",
    multiple=True,
    metavar="LINK",
    help="Link that may touch the object; repeatable [default: those with 'finger' in their name].",
)
@click.option(
    "--exclude",
    multiple=True,
    metavar="LINK,LINK",
    help="Two links that cannot hurt each other and are not to be checked; repeatable. Those that touch in every pose "
    "are not anyway.",
)
@click.option(
    "--home",
    default="",
    help="Home pose, comma-separated [rad] [default: 'ready' or 'home' of an SRDF beside URDF if that is fit, else one "
    "that is looked for].",
)
@click.option(
    "--packages",
    multiple=True,
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder that holds the packages of package:// names; repeatable. Those above URDF are looked through anyway.",
)
@click.option("--ddq-max", type=_POSITIVE, default=6.0, show_default=True, help="Of every joint [rad/s²].")
@click.option("--dddq-max", type=_POSITIVE, default=300.0, show_default=True, help="Of every joint [rad/s³].")
def import_arm(
    urdf: Path,
    out: Path,
    base: str,
    tip: str,
    tip_axis: str,
    left_out: Sequence[str],
    name: str,
    hold: Sequence[str],
    fingers: Sequence[str],
    exclude: Sequence[str],
    home: str,
    packages: Sequence[Path],
    ddq_max: float,
    dddq_max: float,
) -> int:
    """Write a first arm.yaml from the URDF of an arm, and say what is left to decide.

    Masses, joints and their limits are taken over; shapes become boxes, cylinders and capsules; a home pose is looked
    for; what the URDF does not say (acceleration, jerk) is a default to be looked at. Ends with what 's2r doctor
    --arm' says of it.
    Exit 2: the URDF cannot be read or holds what an arm.yaml cannot say; nothing is written then.
    """
    from s2r_host.arm_import import Wishes, to_yaml, with_home
    from s2r_host.arm_import import import_arm as convert
    from s2r_protocol.arms import load_arm
    from s2r_protocol.cli.doctor import check_arm
    from s2r_protocol.cli.findings import print_findings
    from s2r_protocol.whole_file import write_whole

    wishes = Wishes(
        base=base,
        tip=tip,
        tip_axis=tip_axis,
        name=name,
        left_out=tuple(left_out),
        held=dict(_held(text) for text in hold),
        fingers=tuple(fingers),
        exclude=tuple(_pair(text) for text in exclude),
        home=_numbers("--home", home.split(",")) if home else (),
        packages=tuple(packages),
        ddq_max=ddq_max,
        dddq_max=dddq_max,
    )
    found = with_home(convert(urdf, wishes), urdf, wishes)
    out.mkdir(parents=True, exist_ok=True)
    write_whole(out / "arm.yaml", to_yaml(found.source, urdf.name, found.told))
    for line in found.told:
        click.echo(line)
    print_findings(check_arm(load_arm(out)))
    click.echo(f"wrote {out / 'arm.yaml'}")
    return int(ExitCode.OK)


def _held(text: str) -> tuple[str, float]:
    joint, equals, value = text.partition("=")
    if not joint or not equals:
        raise UsageError(f"--hold {text}: expected JOINT=VALUE, e.g. finger_joint=0.7 [rad, m]")
    return joint, _numbers(f"--hold {joint}", [value])[0]


def _pair(text: str) -> tuple[str, str]:
    first, comma, second = (word.strip() for word in text.partition(","))
    if not first or not comma or not second or first == second:
        raise UsageError(f"--exclude {text}: expected LINK,LINK, two links")
    return first, second


def _numbers(option: str, words: Sequence[str]) -> tuple[float, ...]:
    try:
        values = tuple(float(word) for word in words)
    except ValueError as error:
        raise UsageError(f"{option}: {error}; give numbers [rad, m], separated by commas") from error
    if not all(map(math.isfinite, values)):
        raise UsageError(f"{option}: the numbers must be finite")
    return values
