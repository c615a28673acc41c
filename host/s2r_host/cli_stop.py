"""``s2r stop``: stop the arm on its path, from any terminal. Imports no numerics, so that it starts fast."""

from __future__ import annotations

from pathlib import Path

import click

from s2r_host.cli_talk import talk_options
from s2r_host.talk import Talk
from s2r_protocol.cli.arm_name import arm_name
from s2r_protocol.faults import Cause, ExecutorState
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb


def send_stop(
    endpoint: str, keys: ArmKeys, timeout_s: float, tls: Path | None = None
) -> tuple[pb.Verdict, pb.Status]:
    """Ask the executor to stop; its verdict and its state just before.

    Raises:
        PeerUnreachableError: Nobody answered.
        CommandRefusedError: The executor would not stop.
    """
    in_vain = "nothing was stopped. Use the emergency stop if the arm moves"
    with Talk("stop", endpoint, keys, timeout_s, tls, in_vain) as talk:
        return talk.control(pb.STOP), talk.hello.status


@click.command()
@talk_options(timeout_s=3.0, in_vain="nothing was stopped")
def stop(endpoint: str, cell: str, arm: str, tls: Path | None, timeout_s: float) -> None:
    """Stop the arm on its path and hold. Needs no lease. This is software, not an emergency stop."""
    keys = ArmKeys(cell, arm_name(arm))
    verdict, before = send_stop(endpoint, keys, timeout_s, tls)
    state = ExecutorState(before.state).name
    cause = Cause(before.cause).name
    click.echo(
        f"stop accepted by {keys.base} at {endpoint}: it was {state} (last cause {cause}), epoch {verdict.epoch}"
    )
