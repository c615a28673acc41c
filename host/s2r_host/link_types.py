"""What the link hands to the rest of the host: plain frozen values, no messages."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from s2r_host.errors import ArmStoppedError, CommandRefusedError, PeerUnreachableError
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


class SeenState(Protocol):
    """What both a published state and an answered status say."""

    @property
    def state(self) -> ExecutorState:
        """State machine."""
        ...

    @property
    def cause(self) -> Cause:
        """Of the last stop or latch."""
        ...

    @property
    def why_not_moving(self) -> str:
        """One sentence."""
        ...

    @property
    def tick(self) -> int:
        """Since the core started."""
        ...

    @property
    def epoch(self) -> int:
        """Bumped by every stop."""
        ...

    @property
    def plan_seq(self) -> int:
        """Running or last plan."""
        ...

    @property
    def plan_t(self) -> float:
        """Time in that plan [s]."""
        ...

    @property
    def plan_done(self) -> bool:
        """It has ended at rest in its goal tolerance."""
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
    silent_joints: tuple[str, ...] = ()


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
        silent_joints=tuple(body.silent_joints),
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


def stop_error(status: SeenState) -> ArmStoppedError:
    """Why the arm stands still although its plan has not ended."""
    asked = status.cause in (Cause.STOP_REQUESTED, Cause.DISARM_REQUESTED)
    who = "on request" if asked else "by a protection"
    text = f"arm was stopped {who}: {status.cause.name} (state {status.state.name}, plan time {status.plan_t:.2f} s)"
    if status.why_not_moving:
        text += f"; {status.why_not_moving}"
    return ArmStoppedError(text, status.cause, status.epoch)


def replaced_error(verdict: Verdict, status: SeenState) -> ArmStoppedError:
    """Why a plan did not come to its end although nothing stopped the arm."""
    return ArmStoppedError(
        f"plan {verdict.seq} was not played to its end: plan {status.plan_seq} was spliced in instead of it, and the "
        f"arm is at rest (state {status.state.name}); wait for the plan that was sent last",
        status.cause,
        status.epoch,
    )


def stopped_meanwhile_error(status: SeenState) -> ArmStoppedError:
    """Why a host that computed without the lease does not go on."""
    return ArmStoppedError(
        "the arm was stopped, disarmed or armed by somebody else since this client's last command "
        f"(state {status.state.name}, last cause {status.cause.name}): nothing was sent; start again when it may move",
        status.cause,
    )


class TickWatch:
    """Notices that the executor's clock stands still, or that something takes too long."""

    def __init__(self, who: str, what: str, stalled_s: float, wall_limit_s: float | None) -> None:
        """Start watching.

        Args:
            who, what: For the text: whose clock, and what is being waited for.
            stalled_s: Largest wall time without a new tick [s].
            wall_limit_s: Largest wall time in all [s], None for no limit.
        """
        self._who, self._what = who, what
        self._stalled_s, self._wall_limit_s = stalled_s, wall_limit_s
        self._started = self._changed = time.monotonic()
        self._tick = -1

    def check(self, now: SeenState) -> None:
        """Look at one more state.

        Raises:
            PeerUnreachableError: No new tick for too long.
            ArmStoppedError: It takes too long in all.
        """
        wall = time.monotonic()
        if now.tick != self._tick:
            self._tick, self._changed = now.tick, wall
        if wall - self._changed > self._stalled_s:
            raise PeerUnreachableError(
                f"{self._who}: its clock stands still at tick {now.tick} for {self._stalled_s:g} s while waiting for "
                f"{self._what}; is the arm or its stand-in still on the bus?"
            )
        if self._wall_limit_s is not None and wall - self._started > self._wall_limit_s:
            text = f"{self._who} is still {now.state.name} after {self._wall_limit_s:g} s of {self._what}"
            raise ArmStoppedError(text, now.cause)
