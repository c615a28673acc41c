"""``s2r ros2``: take motions from ROS 2 nodes."""

from __future__ import annotations

import contextlib
import logging
import signal
import threading
from pathlib import Path

import click

from s2r_protocol.cli.options import tls_option

DEFAULT_EXECUTOR = "tcp/127.0.0.1:7447"
DEFAULT_LISTEN = "tcp/127.0.0.1:7449"


@click.command()
@click.option(
    "--executor", default=DEFAULT_EXECUTOR, show_default=True, help="Zenoh endpoint of the executor."
)
@click.option(
    "--listen", default=DEFAULT_LISTEN, show_default=True, help="Where ROS 2 nodes connect; loopback only."
)
@click.option("--router", help="Connect to this rmw_zenoh router instead of listening; loopback only.")
@click.option(
    "--domain", type=click.IntRange(0, 232), default=0, show_default=True, help="ROS_DOMAIN_ID of the nodes."
)
@click.option("--enable-drives", is_flag=True, help="Enable the drives when a trajectory finds them off.")
@click.option("--arm", default="xmate3pro", show_default=True, help="Shipped arm, or a folder with arm.yaml.")
@click.option("--cell", default="lab", show_default=True)
@tls_option
@click.option(
    "--ready-file", type=click.Path(dir_okay=False, path_type=Path), help="Written when ready: the topic."
)
def ros2(
    executor: str,
    listen: str,
    router: str | None,
    domain: int,
    enable_drives: bool,
    arm: str,
    cell: str,
    tls: Path | None,
    ready_file: Path | None,
) -> None:
    """Carry out trajectory_msgs/JointTrajectory from ROS 2 nodes with rmw_zenoh, through the executor's admission.

    Nodes publish on /CELL/ARM/joint_trajectory and read each outcome on /CELL/ARM/trajectory_log. An empty trajectory
    stops the arm on its path. Ctrl-C ends the relay and stops its motion.
    """
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    from s2r_host.link import ExecutorLink
    from s2r_host.ros2.relay import TrajectoryRelay
    from s2r_protocol.arms import load_arm
    from s2r_protocol.keys import ArmKeys
    from s2r_protocol.session import Role
    from s2r_protocol.session import connect as join
    from s2r_protocol.session import listen as serve

    description = load_arm(arm)
    keys = ArmKeys(cell, description.name)
    ended = threading.Event()
    before = {n: signal.signal(n, lambda *_: ended.set()) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        with (
            join(router, Role.HOST, keys) if router else serve([listen], Role.HOST, keys) as session,
            ExecutorLink(executor, description, keys, tls=tls) as link,
            contextlib.closing(TrajectoryRelay(session, link, description, keys, domain, enable_drives)),
        ):
            where = f"the router at {router}" if router else listen
            click.echo(f"s2r ros2: /{keys.base}/joint_trajectory, domain {domain}, {where}")
            if ready_file is not None:
                ready_file.write_text(f"/{keys.base}/joint_trajectory\n", encoding="utf-8")
            ended.wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
