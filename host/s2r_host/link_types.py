"""What the link hands to the rest of the host: plain frozen values, no messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from s2r_host.errors import ArmStoppedError, CommandRefusedError
from s2r_protocol.faults import Cause, ExecutorState, Refusal
from s2r_protocol.proto import s2r_pb2 as pb

MOVING = (ExecutorState.RUN, ExecutorState.PAUSED, ExecutorState.STOPPING, ExecutorState.STOP1)
LATCHED = (ExecutorState.FAULT, ExecutorState.ESTOP)


class TimedPath(Protocol):
    """What :meth:`ExecutorLink.send_plan` needs of a trajectory: quintic knots at rest at both ends."""

    @property
    def t(self) -> np.ndarray:
        """Knot times [s], shape (n,), ``t[0] = 0``."""
        ...

    @property
    def q(self) -> np.ndarray:
        """[rad], shape (n, dof)."""
        ...

    @property
    def dq(self) -> np.ndarray:
        """[rad/s], shape (n, dof)."""
        ...

    @property
    def ddq(self) -> np.ndarray:
        """[rad/s²], shape (n, dof)."""
        ...


@dataclass(frozen=True)
class Payload:
    """What the tool carries: mass [kg], centre of mass in the tool frame [m]."""

    mass_kg: float = 0.0
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Verdict:
    """The executor's answer to an accepted plan or control command."""

    seq: int
    epoch: int
    duration_s: float


@dataclass(frozen=True)
class ExecutorStatus:
    """One consistent view of the executor. Joint arrays have shape (dof,) [rad, rad/s, N·m]."""

    state: ExecutorState
    cause: Cause
    why_not_moving: str
    tick: int
    epoch: int
    plan_seq: int
    plan_t: float
    plan_done: bool
    speed_scale: float
    lease_holder: str
    q_ref: np.ndarray
    dq_ref: np.ndarray
    ddq_ref: np.ndarray
    q_meas: np.ndarray
    dq_meas: np.ndarray
    tau_meas: np.ndarray


@dataclass(frozen=True)
class ExecutorIdentity:
    """Who answered the hello."""

    boot_id: int
    arm: str
    model_hash: bytes
    limit_hash: bytes
    joint_names: tuple[str, ...]
    tick_ns: int
    software: str
    host_timeout_s: float


def status_from_message(body: pb.Status) -> ExecutorStatus:
    """The wire's Status as a domain object."""
    return ExecutorStatus(
        state=ExecutorState(body.state),
        cause=Cause(body.cause),
        why_not_moving=body.why_not_moving,
        tick=body.tick,
        epoch=body.epoch,
        plan_seq=body.plan_seq,
        plan_t=body.plan_t,
        plan_done=body.plan_done,
        speed_scale=body.speed_scale,
        lease_holder=body.lease_holder,
        q_ref=np.array(body.q_ref),
        dq_ref=np.array(body.dq_ref),
        ddq_ref=np.array(body.ddq_ref),
        q_meas=np.array(body.q_meas),
        dq_meas=np.array(body.dq_meas),
        tau_meas=np.array(body.tau_meas),
    )


def identity_from_message(body: pb.HelloReply) -> ExecutorIdentity:
    """The hello's answer as a domain object."""
    return ExecutorIdentity(
        boot_id=body.boot_id,
        arm=body.arm,
        model_hash=body.model_hash,
        limit_hash=body.limit_hash,
        joint_names=tuple(body.joint_names),
        tick_ns=body.tick_ns,
        software=body.software,
        host_timeout_s=body.host_timeout_ms / 1000.0,
    )


def refusal_error(verdict: pb.Verdict, what: str) -> CommandRefusedError:
    """The sentence of a verdict that said no."""
    try:
        code = Refusal(verdict.code)
    except ValueError:
        code = Refusal.INTERNAL
    return CommandRefusedError(f"executor refused {what} ({code.name}): {verdict.reason}", code)


def stop_error(status: ExecutorStatus) -> ArmStoppedError:
    """Why the arm stands still although its plan has not ended."""
    asked = status.cause in (Cause.STOP_REQUESTED, Cause.DISARM_REQUESTED)
    who = "on request" if asked else "by a protection"
    text = f"arm was stopped {who}: {status.cause.name} (state {status.state.name}, plan time {status.plan_t:.2f} s)"
    if status.why_not_moving:
        text += f"; {status.why_not_moving}"
    return ArmStoppedError(text, status.cause)
