"""``s2r build-model``: two depth views in, joint and physics model out."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from s2r_host.model.answer_folder import ANSWER, check_room, forget
from s2r_protocol.cli.options import SEED
from s2r_protocol.exits import ExitCode, RefusedError, S2RError, UsageError

if TYPE_CHECKING:
    from s2r_host.perception.estimate import JointEstimate
    from s2r_host.perception.frames import Cloud, DepthFrame

Step = Callable[[str], None]


@click.command()
@click.option(
    "--before", type=click.Path(path_type=Path), required=True, help="First view: PLY, NPZ or depth PNG."
)
@click.option(
    "--after", type=click.Path(path_type=Path), required=True, help="Second view, after the motion."
)
@click.option(
    "--between",
    type=click.Path(path_type=Path),
    multiple=True,
    help="A view taken while the part moved; may be given several times. The axis of a lid, door or drawer gains.",
)
@click.option(
    "--out",
    type=click.Path(file_okay=False, writable=True, path_type=Path),
    required=True,
    help="Folder for model, JSON and pictures; an earlier answer there is replaced, other files are not.",
)
@click.option(
    "--frame",
    type=click.Choice(["base", "camera"]),
    default="base",
    show_default=True,
    help="base: one fixed frame, z up. camera: the camera's OpenCV frame.",
)
@click.option(
    "--camera",
    type=click.Path(path_type=Path),
    help="camera.json: intrinsics [px] and base_T_camera; needed for PNG.",
)
@click.option("--region", help="Look for motion only in xmin,xmax,ymin,ymax,zmin,zmax [m] of that frame.")
@click.option(
    "--joint",
    "joint_type",
    type=click.Choice(["revolute", "prismatic"]),
    help="Consider only this kind of joint.",
)
@click.option(
    "--several",
    is_flag=True,
    help="More than one part may have moved: one model per part, in part_1, part_2, ... of --out.",
)
@click.option(
    "--vague",
    is_flag=True,
    help="Answer also where a turn is known to half of itself only, instead of a tenth.",
)
@click.option(
    "--network/--no-network",
    default=None,
    help="Whether the shipped pair network weighs the motions too: it answers some that geometry alone knows too "
    "vaguely. [default: it does; not with --frame camera, as it knows views with z up only]",
)
@click.option("--seed", type=SEED, default=0, show_default=True, help="Of the sampling.")
@click.option("--json", "as_json", is_flag=True, help="Print the answer as JSON on standard output.")
def build_model(
    before: Path, after: Path, between: tuple[Path, ...], out: Path, frame: str, camera: Path | None,
    region: str | None, joint_type: str | None, several: bool, vague: bool, network: bool | None, seed: int,
    as_json: bool,
) -> None:  # fmt: skip
    """Estimate the joint that moved between two depth views and build a physics model of the object.

    Writes object.xml (MJCF), object.urdf, model.json and pictures into --out. Exit 4 and {"abstain": true,
    "reason": ...} when the views do not determine one joint.
    """
    try:
        _check_options(before, after, between, out, frame, region, several, network)
        with _steps(quiet=as_json) as step:
            result = _build(
                before,
                after,
                between,
                out,
                frame,
                camera,
                region,
                joint_type,
                several,
                vague,
                network,
                seed,
                step,
            )
    except RefusedError as error:
        _abstain(error, out, as_json)
    except S2RError as error:
        click.echo(f"s2r build-model: {error}", err=True)
        sys.exit(int(error.exit_code))
    if as_json:
        click.echo(json.dumps(result, indent=1))
    else:
        for part in result.get("parts_found", [result]):
            _print(part)


def _build(
    before: Path, after: Path, between: tuple[Path, ...], out: Path, frame: str, camera: Path | None,
    region: str | None, joint_type: str | None, several: bool, vague: bool, network: bool | None, seed: int,
    step: Step,
) -> dict[str, Any]:  # fmt: skip
    step("reading both views")
    box = parse_region(region)
    from s2r_host.perception.loading import load_frame

    view_before = load_frame(before, frame, camera)  # type: ignore[arg-type]
    view_after = load_frame(after, frame, camera)  # type: ignore[arg-type]
    more = [load_frame(path, frame, camera) for path in between]  # type: ignore[arg-type]
    views = _all_depth(view_before, view_after, more, several)
    from s2r_host.perception.estimate import UP
    from s2r_host.perception.verdict import KNOWN_TO, VAGUELY

    known_to = VAGUELY if vague else KNOWN_TO
    up = None if frame == "camera" else UP  # a camera's z leads into the picture, whatever way is up
    asked = None
    if network is not False and frame != "camera":
        from s2r_host.perception.pair_network import PairNetworkRuntime

        asked = PairNetworkRuntime()
    forget(out)  # not before: where the views or the options cannot be used there is no new answer
    step("estimating the joint")
    if not several:
        from s2r_host.perception.estimate import estimate_joint

        estimate = estimate_joint(
            view_before, view_after, region=box, joint_type=joint_type,  # type: ignore[arg-type]
            up=up, known_to=known_to, network=asked, seed=seed,
        )  # fmt: skip
        if between:
            from s2r_host.perception.between import refined_between

            step(f"refining it by {len(between)} views from between")
            estimate = refined_between(estimate, views[0], views[1], views[2:], region=box, up=up, seed=seed)
        return _build_one(estimate, out, frame, seed, step)
    from s2r_host.perception.several import estimate_joints

    found = estimate_joints(
        views[0],
        views[1],
        region=box,
        joint_type=joint_type,
        up=up,
        known_to=known_to,
        network=asked,
        seed=seed,
    )
    parts = [
        _build_one(estimate, out / f"part_{k}", frame, seed, step)
        for k, estimate in enumerate(found, start=1)
    ]
    result: dict[str, Any] = {"parts_found": parts}
    (out / ANSWER).write_text(json.dumps(result, indent=1) + "\n")
    return result


def _check_options(
    before: Path, after: Path, between: tuple[Path, ...], out: Path, frame: str, region: str | None, several: bool,
    network: bool | None,
) -> None:  # fmt: skip
    """Refuse what can be told from the options alone.

    Raises:
        UsageError: Names the option and what to do.
    """
    parse_region(region)
    if before.resolve() == after.resolve():
        raise UsageError(f"--before and --after are the same file ({before}); two views are needed")
    ends = {before.resolve(): "--before", after.resolve(): "--after"}
    for path in between:
        if path.resolve() in ends:
            raise UsageError(
                f"--between {path} is the view of {ends[path.resolve()]}; give one taken in between"
            )
    if between and several:
        raise UsageError("--between refines the joint of one part; it does not go with --several")
    if network and frame == "camera":
        raise UsageError("--network knows views with z up only; it does not go with --frame camera")
    check_room(out, (before, after, *between), several)


def _all_depth(
    before: DepthFrame | Cloud,
    after: DepthFrame | Cloud,
    between: Sequence[DepthFrame | Cloud],
    several: bool,
) -> list[DepthFrame]:
    """All views where some are from between or several parts are looked for, which takes a camera; none otherwise.

    Raises:
        UsageError: Some have a camera and some have none, or none has and it is needed.
    """
    from s2r_host.perception.frames import DepthFrame

    if isinstance(before, DepthFrame) != isinstance(after, DepthFrame):
        bare = "--after" if isinstance(before, DepthFrame) else "--before"
        raise UsageError(
            f"{bare} is a cloud without a camera and the other view has one: what moved is looked for in two views of"
            " one kind; give the cloud's --camera"
        )
    frames = [view for view in (before, after, *between) if isinstance(view, DepthFrame)]
    if between and len(frames) < 2 + len(between):
        raise UsageError("--between needs depth images or clouds with --camera, for all of the views")
    if several and len(frames) < 2:
        raise UsageError(
            "--several needs depth images or clouds with --camera: parts are told apart in the image"
        )
    return frames if between or several else []


def _build_one(estimate: JointEstimate, out: Path, frame: str, seed: int, step: Step) -> dict[str, Any]:
    """Model, pictures and answer of one part."""
    step("building the model")
    from s2r_host.model.answer import answer
    from s2r_host.model.build import build_model as build

    out.mkdir(parents=True, exist_ok=True)
    model = build(estimate, out, seed=seed)
    step("drawing pictures")
    from s2r_host.model.pictures import save_model_picture
    from s2r_host.perception.pictures import save_pictures

    pictures = [*save_pictures(estimate, out), save_model_picture(model, estimate, out / "model.png")]
    result = answer(estimate, model, frame)
    (out / ANSWER).write_text(json.dumps(result, indent=1) + "\n")
    step(f"wrote {out} ({len(pictures)} pictures)")
    return result


def parse_region(text: str | None) -> tuple[float, float, float, float, float, float] | None:
    """Six numbers "xmin,xmax,ymin,ymax,zmin,zmax" [m].

    Raises:
        UsageError: Not six ordered numbers.
    """
    if text is None:
        return None
    try:
        values = [float(part) for part in text.replace(" ", "").split(",")]
    except ValueError as error:
        raise UsageError(
            f"--region {text}: {error}; expected xmin,xmax,ymin,ymax,zmin,zmax in metres"
        ) from error
    if len(values) != 6 or not all(a < b for a, b in zip(values[0::2], values[1::2], strict=True)):
        raise UsageError(
            f"--region {text}: expected six numbers xmin,xmax,ymin,ymax,zmin,zmax with min < max"
        )
    return values[0], values[1], values[2], values[3], values[4], values[5]


def _abstain(error: RefusedError, out: Path, as_json: bool) -> NoReturn:
    """Say why there is no answer, in the form asked for, and leave with the code for a refusal.

    It takes the place of an earlier answer, and of the models of the parts before one that could not be built.
    """
    result = {"abstain": True, "reason": str(error)}
    with contextlib.suppress(OSError):  # the reason matters more than its copy on disk
        forget(out)
        out.mkdir(parents=True, exist_ok=True)
        (out / ANSWER).write_text(json.dumps(result, indent=1) + "\n")
    if as_json:
        click.echo(json.dumps(result, indent=1))
    else:
        click.echo(f"s2r build-model: no answer: {error}", err=True)
    sys.exit(int(ExitCode.REFUSED))


@contextlib.contextmanager
def _steps(quiet: bool) -> Iterator[Step]:
    """A spinner with the current step on standard error."""
    if quiet:
        yield lambda _: None
        return
    console = Console(stderr=True)
    with Progress(
        SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=console
    ) as progress:
        task = progress.add_task("starting", total=None)
        yield lambda text: progress.update(task, description=text)


def _print(result: dict[str, Any]) -> None:
    console = Console()
    turn = result["unit"] == "rad"
    scale, unit = (57.29577951308232, "°") if turn else (1e3, " mm")
    low, high = result["intervals90"]["delta"]
    console.print(
        f"[bold]{result['joint_type']}[/bold]: {result['delta'] * scale:.1f}{unit}"
        f" (90 %: {low * scale:.1f} to {high * scale:.1f}{unit})"
    )
    console.print(
        f"axis {result['axis_direction']} through {result['axis_origin_m']} m in the {result['frame']} frame,"
        f" within {result['intervals90']['axis_angle_rad'] * 57.29578:.1f}° (90 %),"
        f" residual {result['residual_m'] * 1e3:.1f} mm"
    )
    console.print(f"model: {result['model_mjcf']}\n       {result['model_urdf']}")
    for warning in result["warnings"]:
        console.print(f"[yellow]note:[/yellow] {warning}")
