"""``s2r stop``: stop the arm on its path, from any terminal. Imports no numerics, so that it starts fast."""

from __future__ import annotations

import os
import time
from pathlib import Path

import click

from s2r_host.errors import CommandRefusedError, PeerUnreachableError
from s2r_host.link_session import ask, open_session, silence_hint
from s2r_protocol import codec
from s2r_protocol.cli.options import tls_option
from s2r_protocol.exits import UsageError
from s2r_protocol.faults import Cause, ExecutorState
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb

DEFAULT_EXECUTOR = "tcp/127.0.0.1:7447"
_LONGEST_WAIT_S = 3600.0


def send_stop(
    endpoint: str, keys: ArmKeys, timeout_s: float, tls: Path | None = None
) -> tuple[pb.Verdict, pb.Status]:
    """Ask the executor to stop; its verdict and its state just before.

    Raises:
        PeerUnreachableError: Nobody answered.
        CommandRefusedError: The executor would not stop.
    """
    sender = f"stop:{os.getpid()}-{os.urandom(2).hex()}"  # secrets would load OpenSSL
    session = open_session(endpoint, keys, tls)
    try:
        hello_wire = codec.seal(pb.Hello(client=sender, software="s2r"), codec.Address(sender=sender))
        deadline = time.monotonic() + timeout_s
        while not (replies := ask(session, keys.hello, hello_wire, 0.5)):
            if time.monotonic() > deadline:
                raise PeerUnreachableError(
                    f"no executor answered at {endpoint} within {timeout_s:g} s: nothing was stopped. "
                    "Use the emergency stop if the arm moves; otherwise correct --executor, --cell or --arm"
                    f"{silence_hint(tls)}"
                )
            time.sleep(0.02)
        hello = codec.open_body(codec.open_envelope(replies[0]), pb.HelloReply)
        address = codec.Address(
            sender,
            hello.boot_id,
            hello.epoch,
            seq=1,
            model_hash=hello.model_hash,
            limit_hash=hello.limit_hash,
        )
        replies = ask(session, keys.control, codec.seal(pb.Control(kind=pb.STOP), address), timeout_s)
        if not replies:
            raise PeerUnreachableError(
                f"executor at {endpoint} did not answer the stop; use the emergency stop"
            )
        verdict = codec.open_body(codec.open_envelope(replies[0]), pb.Verdict)
        if not verdict.accepted:
            raise CommandRefusedError(f"executor at {endpoint} refused the stop: {verdict.reason}")
        return verdict, hello.status
    finally:
        session.close()


@click.command()
@click.option("--executor", "endpoint", default=DEFAULT_EXECUTOR, show_default=True, help="Zenoh endpoint.")
@click.option("--cell", default="lab", show_default=True)
@click.option("--arm", default="xmate3pro", show_default=True, help="Name of the arm in the cell.")
@tls_option
@click.option("--timeout", "timeout_s", default=3.0, show_default=True, help="Seconds to wait for an answer.")
def stop(endpoint: str, cell: str, arm: str, tls: Path | None, timeout_s: float) -> None:
    """Stop the arm on its path and hold. Needs no lease. This is software, not an emergency stop."""
    if not 0.0 <= timeout_s <= _LONGEST_WAIT_S:  # says no to NaN as well
        raise UsageError(
            f"--timeout {timeout_s:g} s is outside 0..{_LONGEST_WAIT_S:g} s; nothing was stopped"
        )
    verdict, before = send_stop(endpoint, ArmKeys(cell, arm), timeout_s, tls)
    state = ExecutorState(before.state).name
    cause = Cause(before.cause).name
    click.echo(
        f"stop accepted by {cell}/{arm} at {endpoint}: it was {state} (last cause {cause}), epoch {verdict.epoch}"
    )
