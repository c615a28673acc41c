"""``s2r replay``: send a recorded plan again and overlay both recordings."""

from __future__ import annotations

import json
from pathlib import Path

import click

from s2r_protocol.cli.options import tls_option

DEFAULT_EXECUTOR = "tcp/127.0.0.1:7447"


@click.command()
@click.argument("run_folder", metavar="RUN", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option(
    "--plan", "number", type=int, default=None, help="Plan number [default: the first manipulation]."
)
@click.option("--list", "only_list", is_flag=True, help="Only list the plans of the run.")
@click.option(
    "--executor", default=DEFAULT_EXECUTOR, show_default=True, help="Zenoh endpoint of the executor."
)
@click.option(
    "--camera", default=None, help="Endpoint of a camera: the way to the start also avoids what it sees."
)
@click.option(
    "--out", type=click.Path(path_type=Path), default=None, help="Folder [default: RUN/replay-<plan>]."
)
@click.option("--arm", default="xmate3pro", show_default=True, help="Shipped arm, or a folder with arm.yaml.")
@click.option("--cell", default="lab", show_default=True)
@tls_option
@click.option("--json", "as_json", is_flag=True, help="Print the comparison on standard output.")
def replay(
    run_folder: Path,
    number: int | None,
    only_list: bool,
    executor: str,
    camera: str | None,
    out: Path | None,
    arm: str,
    cell: str,
    tls: Path | None,
    as_json: bool,
) -> None:
    """Send a plan recorded in RUN through admission again and compare the executions.

    The arm first goes to the plan's start by a checked move. The object is not put back.
    """
    from s2r_host.link import ExecutorLink
    from s2r_host.motion.arm_model import ArmModel
    from s2r_host.recording import read_plans
    from s2r_host.replay.overlay import write_overlay
    from s2r_host.replay.replay import pick_plan, replay_plan
    from s2r_protocol.arms import load_arm
    from s2r_protocol.keys import ArmKeys

    if only_list:
        for plan in read_plans(run_folder / "run.mcap"):
            click.echo(f"{plan.number:3d}  {plan.t[-1]:6.2f} s  {plan.label}")
        return
    plan = pick_plan(run_folder, number)
    description = load_arm(arm)
    model = ArmModel(description)
    with ExecutorLink(executor, description, ArmKeys(cell, description.name), tls=tls) as link:
        obstacles = _seen(camera, ArmKeys(cell, description.name), tls, model, link.status().q_meas)
        try:
            replayed = replay_plan(link, model, run_folder, plan, obstacles)
        except KeyboardInterrupt:
            link.stop()
            link.wait_at_rest()
            raise
    folder = out or run_folder / f"replay-{plan.number}"
    path = write_overlay(replayed, description.joint_names, run_folder, folder)
    (folder / "replay.mcap").write_bytes(replayed.recording)
    found = replayed.comparison
    rms = dict(zip(description.joint_names, found.rms_rad.tolist(), strict=True))
    values = {
        "plan": plan.number,
        "label": plan.label,
        "plan_seq": replayed.seq,
        "rms_rad": rms,
        "page": str(path),
    }
    (folder / "replay.json").write_text(json.dumps(values, indent=1) + "\n")
    if as_json:
        click.echo(json.dumps(values, indent=1))
        return
    click.echo(f"plan {plan.number} '{plan.label}' replayed; RMS difference per joint [mrad]:")
    click.echo("  " + "  ".join(f"{name} {1e3 * value:.3f}" for name, value in rms.items()))
    click.echo(f"overlay: {path}")


def _seen(camera: str | None, keys, tls: Path | None, arm, q_meas) -> list:  # noqa: ANN001 - types would import the heavy modules
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
