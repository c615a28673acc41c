"""``s2r ros2``: take motions from ROS 2 nodes."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from s2r_protocol.cli.ending import hear, restore
from s2r_protocol.cli.options import tls_option
from s2r_protocol.session import AddressError, endpoint_for

if TYPE_CHECKING:
    import zenoh

DEFAULT_EXECUTOR = "tcp/127.0.0.1:7447"
DEFAULT_LISTEN = "tcp/127.0.0.1:7449"
_ROUTER_WAIT_S = 1.0


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
@click.option("--cell", default="lab", show_default=True, help="Name of the cell in the key space.")
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

    _check_loopback("--router" if router else "--listen", router or listen)
    description = load_arm(arm)
    keys = ArmKeys(cell, description.name)
    ended = threading.Event()
    before = hear(lambda *_: ended.set())
    try:
        with (
            join(router, Role.HOST, keys)
            if router
            else serve([listen], Role.HOST, keys, who="s2r ros2") as session,
            ExecutorLink(executor, description, keys, tls=tls) as link,
            contextlib.closing(TrajectoryRelay(session, link, description, keys, domain, enable_drives)),
        ):
            where = f"the router at {router}" if router else listen
            click.echo(f"s2r ros2: /{keys.base}/joint_trajectory, domain {domain}, {where}")
            if router and not _is_met(session):
                click.echo(
                    f"s2r ros2: nobody answers at {router} yet; is 'rmw_zenohd' running there?", err=True
                )
            if ready_file is not None:
                ready_file.write_text(f"/{keys.base}/joint_trajectory\n", encoding="utf-8")
            ended.wait()
    finally:
        restore(before)


def _check_loopback(option: str, address: str) -> None:
    """Refuse an address that leaves this machine; the usual advice, certificates, does not exist on ROS 2's side.

    Raises:
        AddressError: It does, or is malformed.
    """
    try:
        endpoint_for(address, has_tls=False)
    except AddressError as error:
        raise AddressError(
            f"{option} {address}: ROS 2 brings no certificates, so only tcp/127.0.0.1:PORT is used towards its nodes. "
            "Run 's2r ros2' on their machine; --executor and --tls reach the arm from there"
        ) from error


def _is_met(session: zenoh.Session) -> bool:
    """Whether the router, or whoever is in its place, is connected; it may also come later."""
    deadline = time.monotonic() + _ROUTER_WAIT_S
    while not (met := bool(session.info.routers_zid() or session.info.peers_zid())):
        if time.monotonic() > deadline:
            break
        time.sleep(0.02)
    return met
