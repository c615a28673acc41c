"""``s2r state``, ``reset``, ``arm`` and ``disarm``: what a fault's page asks for, from a terminal. No numerics."""

from __future__ import annotations

import json
from pathlib import Path

import click

from s2r_host.cli_talk import talk_options
from s2r_host.talk import Talk
from s2r_protocol.cli.arm_name import arm_name
from s2r_protocol.faults import Cause, ExecutorState
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_protocol.session import Role, role_held

_WAIT_S = 15.0  # arming takes seconds, in lock-step on a busy machine more


@click.command()
@talk_options(timeout_s=3.0, in_vain="nothing was asked")
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def state(endpoint: str, cell: str, arm: str, tls: Path | None, timeout_s: float, as_json: bool) -> None:
    """Tell the executor's state, and why the arm does not move. Changes nothing."""
    role = role_held(tls, (Role.HOST, Role.MONITOR))  # both may ask
    keys = ArmKeys(cell, arm_name(arm))
    with Talk("state", endpoint, keys, timeout_s, tls, "its state is unknown", role) as talk:
        status = talk.hello.status
        if as_json:
            click.echo(json.dumps(_as_dict(talk.hello), indent=2, ensure_ascii=False))
            return
        holder = f"'{status.lease_holder}'" if status.lease_holder else "nobody"
        click.echo(f"{_who(talk)}: {_in_words(status)} Epoch {status.epoch}, lease held by {holder}.")


@click.command()
@talk_options(timeout_s=_WAIT_S, in_vain="nothing was sent")
def reset(endpoint: str, cell: str, arm: str, tls: Path | None, timeout_s: float) -> None:
    """Clear a latched fault whose cause is gone. The drives stay off: 's2r arm' switches them on.

    Takes the lease, and gives it back.
    """
    _send(pb.RESET, endpoint, cell, arm, tls, timeout_s)


@click.command()
@talk_options(timeout_s=_WAIT_S, in_vain="nothing was sent")
def arm(endpoint: str, cell: str, arm: str, tls: Path | None, timeout_s: float) -> None:
    """Switch the drives on: the brakes open and the arm holds its position, under power.

    Takes the lease, and gives it back. Not needed before 's2r run' and 's2r replay --real', which do so themselves.
    """
    _send(pb.ARM, endpoint, cell, arm, tls, timeout_s)


@click.command()
@talk_options(timeout_s=_WAIT_S, in_vain="nothing was sent")
def disarm(endpoint: str, cell: str, arm: str, tls: Path | None, timeout_s: float) -> None:
    """Close the brakes and switch the drives off. Not possible while the arm moves: 's2r stop' first.

    Takes the lease, and gives it back.
    """
    _send(pb.DISARM, endpoint, cell, arm, tls, timeout_s)


def _send(
    kind: pb.ControlKind, endpoint: str, cell: str, arm: str, tls: Path | None, timeout_s: float
) -> None:
    name = pb.ControlKind.Name(kind)
    in_vain = f"{name} was not sent"
    with Talk(name.lower(), endpoint, ArmKeys(cell, arm_name(arm)), timeout_s, tls, in_vain) as talk:
        before = talk.hello.status
        with talk.leased():
            talk.control(kind)
        was = ExecutorState(before.state).name
        click.echo(f"{name} done by {_who(talk)}: it was {was}, it is {_in_words(talk.greet().status)}")


def _who(talk: Talk) -> str:
    return f"{talk.keys.base} at {talk.endpoint}"


def _in_words(status: pb.Status) -> str:
    return f"{ExecutorState(status.state).name}. {status.why_not_moving}"


def _as_dict(hello: pb.HelloReply) -> dict[str, object]:
    status = hello.status
    return {
        "arm": hello.arm,
        "software": hello.software,
        "boot_id": f"{hello.boot_id:016x}",
        "state": ExecutorState(status.state).name,
        "cause": Cause(status.cause).name,
        "why_not_moving": status.why_not_moving,
        "epoch": status.epoch,
        "tick": status.tick,
        "lease_holder": status.lease_holder,
        "plan_seq": status.plan_seq,
        "plan_t_s": status.plan_t,
        "plan_done": status.plan_done,
        "speed_scale": status.speed_scale,
        "joint_names": list(hello.joint_names),
        "q_meas": list(status.q_meas),
        "q_ref": list(status.q_ref),
        "silent_joints": list(status.silent_joints),
    }
