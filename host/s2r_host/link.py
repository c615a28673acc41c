"""The host's side of the wire: the only host module that turns messages into domain objects and back.

One :class:`ExecutorLink` holds one Zenoh session to one executor; one :class:`CameraLink` holds its own
session to the camera process, so that a megabyte of depth never queues in front of a heartbeat.
"""

from __future__ import annotations

import logging
import os
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from google.protobuf.message import Message

from s2r_host.errors import ArmMismatchError, ArmStoppedError, CommandRefusedError, PeerUnreachableError
from s2r_host.link_camera import CameraLink, Capture
from s2r_host.link_heartbeat import Heart
from s2r_host.link_observations import JointSample, ObservationFeed, StateSample
from s2r_host.link_session import (
    answer,
    ask,
    body_of,
    certificate_trouble,
    envelope_of,
    open_session,
    silence_hint,
)
from s2r_host.link_types import (
    LATCHED,
    MOVING,
    ExecutorIdentity,
    ExecutorStatus,
    Payload,
    SeenState,
    TickWatch,
    TimedPath,
    Verdict,
    identity_from_message,
    refusal_error,
    replaced_error,
    status_from_message,
    stop_error,
    stopped_meanwhile_error,
)
from s2r_protocol import codec
from s2r_protocol.faults import NOTHING_RECORDED, ExecutorState, Refusal
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb

if TYPE_CHECKING:
    import zenoh

    from s2r_protocol.arms import ArmDescription

logger = logging.getLogger(__name__)


__all__ = [
    "CameraLink",
    "Capture",
    "ExecutorIdentity",
    "ExecutorLink",
    "ExecutorStatus",
    "Payload",
    "TimedPath",
    "Verdict",
]

R = TypeVar("R", bound=Message)

_STALLED_S = 5.0  # of wall time without a new tick, however slow a stepped clock is
_BUSY_LIMIT_S = 90.0
"""Lock-step on a busy machine: the executor counts only time in which the arm's clock goes on, for up to a minute."""


class ExecutorLink:
    """A session with one executor: hello, lease, heartbeat, plans, control, recordings.

    Use as a context manager; leaving it returns the lease and closes the session. Thread-safe for one
    commanding thread plus :meth:`stop` from any other.

    Every stop and every arming makes a new epoch. The link commands in the epoch that it knows of by its own doing; a
    stop by anybody else makes its commands stale and its next lease an :class:`ArmStoppedError`. Whoever wants to go on
    after such a stop says so with :meth:`meet`.
    """

    def __init__(
        self,
        endpoint: str,
        arm: ArmDescription,
        keys: ArmKeys | None = None,
        connect_timeout_s: float = 5.0,
        query_timeout_s: float = 5.0,
        tls: Path | None = None,
    ) -> None:
        """Connect and check that both sides mean the same arm.

        Args:
            endpoint: Zenoh endpoint, e.g. ``tcp/127.0.0.1:7447``.
            arm: The arm the host plans for; its hashes must be the executor's.
            keys: Cell and arm names; by default cell "lab" and the arm's own name.
            connect_timeout_s: How long to retry (every 100 ms) until the executor answers hello.
            query_timeout_s: Silence after which the executor counts as gone. While it publishes its state a verdict
                may take longer: a long plan's admission, or arming in lock-step on a busy machine.
            tls: Folder with the certificates; None when the executor is on this machine.

        Raises:
            PeerUnreachableError: Nobody answered in time.
            ArmMismatchError: The executor runs another arm model or other limits.
        """
        self._endpoint = endpoint
        self._who = f"executor at {endpoint}"
        self._arm = arm
        self._keys = keys or ArmKeys(arm=arm.name)
        self._timeout_s = query_timeout_s
        self._sender = f"host:{os.getpid()}-{secrets.token_hex(2)}"
        self._lock = threading.Lock()
        self._seq = 0
        self._epoch = 0
        self._heart: Heart | None = None
        self._met = False
        self._tls = tls
        self._session: zenoh.Session = open_session(endpoint, self._keys, tls, may_come_later=True)
        try:
            self.identity, status = self._greet(connect_timeout_s)
            self._epoch = status.epoch
            check_same_arm(self.identity, arm)
            self._feed = ObservationFeed(self._session, f"/{self._keys.base}")
        except BaseException:
            self._session.close()
            raise

    @property
    def name(self) -> str:
        """Under which the executor knows this client: the lease's holder, where it has the lease."""
        return self._sender

    # -- asking -------------------------------------------------------------------------------------

    def status(self) -> ExecutorStatus:
        """The executor's state right now.

        Raises:
            PeerUnreachableError: No answer.
        """
        return self._greet(self._timeout_s)[1]

    def meet(self) -> None:
        """Say hello anew and go on from there, whoever stopped the arm since.

        An executor that was started again meanwhile is checked like the first.

        Raises:
            PeerUnreachableError: No answer.
            ArmMismatchError: It now runs another arm model or other limits.
        """
        identity, status = self._greet(self._timeout_s)
        check_same_arm(identity, self._arm)
        self.identity, self._epoch = identity, status.epoch

    def state(self) -> StateSample | None:
        """The newest published state, without asking; None when none arrived within 0.2 s. For any thread."""
        return self._feed.state()

    def joints(self) -> JointSample | None:
        """The newest published joint state; None when none arrived within 0.2 s."""
        return self._feed.joints()

    def recording(self, plan_seq: int, timeout_s: float = 20.0) -> bytes:
        """The MCAP bytes the executor recorded of one plan; waits until the file is complete.

        Raises:
            CommandRefusedError: There is no such recording.
            PeerUnreachableError: No answer.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            request = pb.RecordingRequest(plan_seq=plan_seq)
            replies = [
                answer(wire, pb.RecordingReply, self._who)
                for wire in self._ask_all(self._keys.recording, codec.seal(request, self._address()))
            ]
            if any(reply.reason for reply in replies):
                reason = next(reply.reason for reply in replies if reply.reason)
                raise CommandRefusedError(
                    f"executor at {self._endpoint} has no recording of plan {plan_seq}: {reason}"
                )
            complete = all(reply.complete for reply in replies)
            if complete and len(replies) == replies[0].pieces:
                return b"".join(reply.mcap for reply in replies)
            if time.monotonic() > deadline:
                why = (
                    f"{len(replies)} of {replies[0].pieces} pieces came"
                    if complete
                    else "is the plan still running?"
                )
                raise CommandRefusedError(
                    f"recording of plan {plan_seq} is incomplete after {timeout_s:g} s; {why}"
                )
            time.sleep(0.1)

    def check_records(self) -> None:
        """Refuse an executor that records nothing, for what is worth nothing without a recording.

        Raises:
            CommandRefusedError: It records nothing.
            PeerUnreachableError: No answer.
        """
        wire = codec.seal(pb.RecordingRequest(plan_seq=0), self._address())
        for told in self._ask_all(self._keys.recording, wire):
            reply = answer(told, pb.RecordingReply, self._who)
            if reply.reason == NOTHING_RECORDED:
                raise CommandRefusedError(
                    f"executor at {self._endpoint}: {NOTHING_RECORDED}; nothing was moved"
                )

    # -- the right to move ----------------------------------------------------------------------------

    def take_lease(self) -> None:
        """Take the lease and start the heartbeat.

        Raises:
            CommandRefusedError: Somebody else holds it.
            ArmStoppedError: Somebody stopped, disarmed or armed since this link's last command; nobody has it then.
        """
        reply = self._command(self._keys.lease, pb.LeaseRequest(release=False), pb.LeaseReply)
        if not reply.granted:
            raise CommandRefusedError(
                f"lease refused: {reply.reason or 'held by ' + reply.holder}; stop that client or wait until it ends",
                Refusal.NO_LEASE,
            )
        if reply.epoch != self._epoch:
            self._command(self._keys.lease, pb.LeaseRequest(release=True), pb.LeaseReply)
            raise stopped_meanwhile_error(self.status())
        self._heart = Heart(self._session, self._keys.heartbeat, self._heartbeat_bytes)

    def return_lease(self) -> None:
        """Stop the heartbeat and give the lease back; harmless without one."""
        if self._heart is None:
            return
        try:
            self._command(self._keys.lease, pb.LeaseRequest(release=True), pb.LeaseReply)
        finally:
            self._heart.stop()
            self._heart = None

    @contextmanager
    def leased(self) -> Iterator[None]:
        """Hold the lease inside the block. Long computations belong outside: they may starve the heartbeat.

        A block that raises leaves the arm at rest, as far as the executor can be reached; why it ended is what the
        caller hears. A caller that goes on after an :class:`ArmStoppedError` knows of that stop, and of no other.

        Raises:
            CommandRefusedError, ArmStoppedError: As :meth:`take_lease`.
        """
        self.take_lease()
        try:
            yield
        except BaseException as error:
            if isinstance(error, ArmStoppedError) and error.epoch is not None:
                self._epoch = error.epoch
            try:
                self._rest_if_possible()  # while the lease still holds: its end would stop the arm as "host lost"
            finally:
                self._return_lease_if_possible()
            raise
        self.return_lease()

    # -- commands -------------------------------------------------------------------------------------

    def arm_drives(self, timeout_s: float = 10.0) -> ExecutorStatus:
        """Enable the drives (DISARMED -> HOLD) and wait until the executor holds; no-op when it already does.

        Raises:
            CommandRefusedError: The executor refused, e.g. because a fault is latched.
            ArmStoppedError: Arming ended in a fault.
        """
        status = self.status()
        if status.state == ExecutorState.HOLD:
            return status
        self._count_own(self._control(pb.ARM))
        return self._wait(
            lambda now: now.state == ExecutorState.HOLD, "arming", stalled_s=timeout_s, wall_limit_s=timeout_s
        )

    def wait_for_drives(self, timeout_s: float = 3.0) -> None:
        """Until every drive has answered the executor once: before that nobody knows where the arm is.

        Raises:
            PeerUnreachableError: Some did not; names their joints.
        """
        deadline = time.monotonic() + timeout_s
        while silent := self.status().silent_joints:
            if time.monotonic() > deadline:
                raise PeerUnreachableError(
                    f"the executor at {self._endpoint} hears nothing from the drives of {', '.join(silent)}; look at "
                    "power, cables and bus, and whether its --packing is theirs ('s2r executor --commission')"
                )
            time.sleep(0.05)

    def disarm(self) -> None:
        """Switch the drives off (HOLD -> DISARMED)."""
        self._count_own(self._control(pb.DISARM))

    def stop(self) -> Verdict:
        """Stop on the path, then hold. Needs no lease; may be called from any thread and any state.

        Whatever was to be sent is stale from then on, whichever thread is about to send it.
        """
        return self._control(pb.STOP)

    def come_to_rest(self) -> ExecutorStatus:
        """Stop, wait until nothing moves, and be able to go on: for the commanding thread, which knows of its own stop.

        Raises:
            CommandRefusedError, PeerUnreachableError: It is not known whether the arm is at rest.
        """
        self._count_own(self.stop())
        return self.wait_at_rest()

    def pause(self) -> Verdict:
        """Bring path time to a stand-still."""
        return self._control(pb.PAUSE)

    def resume(self) -> Verdict:
        """Go on after a pause."""
        return self._control(pb.RESUME)

    def set_speed(self, scale: float) -> Verdict:
        """Play plans at ``scale`` in (0, 1] of their planned speed."""
        return self._control(pb.SET_SPEED, scale)

    def reset(self) -> Verdict:
        """Clear a latch whose cause is gone."""
        return self._control(pb.RESET)

    def send_plan(
        self,
        path: TimedPath,
        label: str,
        payload: Payload | None = None,
        running: Verdict | None = None,
        splice_t: float = 0.0,
    ) -> Verdict:
        """Send a plan through admission; it starts at once when accepted.

        With ``running``, the verdict of the plan that plays, it takes over at ``splice_t`` [s] of that plan's time
        instead. It should begin in the state the running plan has there; where it misses it a little, the executor
        puts a bridge in front. If it is refused, the running plan goes on.

        Raises:
            CommandRefusedError: With the verdict's sentence: joint, time, quantity, value and limit.
            PeerUnreachableError: No answer, or the heartbeat has ended.
        """
        self.require_heartbeat()
        body = pb.Plan(
            joint_names=self._arm.joint_names,
            t=np.asarray(path.t, float),
            q=np.asarray(path.q, float).ravel(),
            dq=np.asarray(path.dq, float).ravel(),
            ddq=np.asarray(path.ddq, float).ravel(),
            label=label,
        )
        if running is not None:
            body.parent_seq, body.splice_t = running.seq, splice_t
        if payload is not None and payload.mass_kg > 0.0:
            body.payload_mass = payload.mass_kg
            body.payload_com.extend(payload.com_m)
        return self._judged(self._keys.plan, body, f"plan '{label}'")

    def wait_done(self, verdict: Verdict, stalled_s: float = _STALLED_S) -> ExecutorStatus:
        """Wait until an accepted plan has ended at rest inside its goal tolerance.

        There is no limit on the wall time of the plan (a stepped clock may be slow); there is one on the
        executor's ticks standing still.

        Args:
            verdict: Of :meth:`send_plan`.
            stalled_s: Largest wall time without a new tick [s].

        Raises:
            ArmStoppedError: The plan was stopped by a protection or on request, or another plan took its place; also
                before it began.
            PeerUnreachableError: The executor fell silent or was started again, or the heartbeat has ended.
        """
        boot_id = self.identity.boot_id

        def done(now: SeenState) -> bool:
            self.require_heartbeat()
            if now.state in MOVING:
                return False
            if now.plan_seq != verdict.seq:
                # Published before it began, or it never will: only an answer tells.
                identity, now = self._greet(self._timeout_s)
                if identity.boot_id != boot_id:
                    raise PeerUnreachableError(
                        f"the executor at {self._endpoint} was started again during plan {verdict.seq}, of which it "
                        "knows nothing: the arm stopped on the way; look at it, then start again"
                    )
                if now.state in MOVING:
                    return False
            if now.plan_seq == verdict.seq and now.plan_done and now.state == ExecutorState.HOLD:
                return True
            if now.epoch != verdict.epoch:  # every stop bumps the epoch
                raise stop_error(now)
            if now.plan_seq != verdict.seq:
                raise replaced_error(verdict, now)
            return False

        return self._wait(done, f"plan {verdict.seq}", stalled_s)

    def wait_at_rest(self, stalled_s: float = _STALLED_S) -> ExecutorStatus:
        """Wait until nothing moves, whatever state that ends in."""
        return self._wait(lambda now: now.state not in MOVING, "coming to rest", stalled_s, latched_ok=True)

    def require_heartbeat(self) -> None:
        """Notice that the lease will be lost.

        Raises:
            PeerUnreachableError: The heartbeat has ended.
        """
        if self._heart is not None and self._heart.error is not None:
            raise PeerUnreachableError(
                f"the heartbeat to the executor at {self._endpoint} has ended ({self._heart.error}): "
                "it will take the lease away; start again"
            )

    def watch(self, what: str, stalled_s: float = _STALLED_S, wall_limit_s: float | None = None) -> TickWatch:
        """Notices that the executor's clock stands still.

        Args:
            what: Is waited for, for the text.
            stalled_s: Largest wall time without a new tick [s].
            wall_limit_s: Largest wall time in all [s], None for no limit.
        """
        return TickWatch(f"executor at {self._endpoint}", what, stalled_s, wall_limit_s)

    # -- plumbing -------------------------------------------------------------------------------------

    def close(self) -> None:
        """Return the lease if held and close the session."""
        try:
            self._return_lease_if_possible()
        finally:
            self._session.close()

    def _count_own(self, verdict: Verdict) -> None:
        """Go on in the epoch that an own command began; a later one holds somebody else's stop and stays unknown."""
        if verdict.epoch == self._epoch + 1:
            self._epoch = verdict.epoch

    def _rest_if_possible(self) -> None:
        try:
            self.come_to_rest()
        except (PeerUnreachableError, CommandRefusedError) as error:
            logger.warning("the stop was not confirmed: %s", error)

    def _return_lease_if_possible(self) -> None:
        try:
            self.return_lease()
        except (PeerUnreachableError, CommandRefusedError) as error:
            logger.warning("lease was not returned: %s", error)

    def __enter__(self) -> ExecutorLink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _wait(
        self,
        condition: Callable[[SeenState], bool],
        what: str,
        stalled_s: float,
        wall_limit_s: float | None = None,
        latched_ok: bool = False,
    ) -> ExecutorStatus:
        """Watch the published state (or ask, when none arrives); a yes and a latch are confirmed by asking.

        What was published last may be older than the newest command: a fault that has just been reset is still in it.
        """
        watch = self.watch(what, stalled_s, wall_limit_s)
        while True:
            now: SeenState = self._feed.state() or self.status()
            if condition(now):
                status = self.status()
                if condition(status):
                    return status
            if now.state in LATCHED and not latched_ok:
                status = self.status()
                if status.state in LATCHED:
                    raise stop_error(status)
            watch.check(now)
            time.sleep(0.01)

    def _address(self) -> codec.Address:
        with self._lock:
            self._seq += 1
            return replace(self._address_template(), seq=self._seq)

    def _address_template(self) -> codec.Address:
        return codec.Address(
            sender=self._sender,
            boot_id=self.identity.boot_id,
            epoch=self._epoch,
            model_hash=self._arm.model_hash,
            limit_hash=self._arm.limit_hash,
        )

    def _heartbeat_bytes(self, count: int) -> bytes:
        # Numbered by its own count: the sequence numbers of commands also name plans and recordings.
        return codec.seal(pb.Heartbeat(count=count), replace(self._address_template(), seq=count))

    def _ask_all(self, key: str, wire: bytes) -> list[bytes]:
        """Every reply, in order. One that publishes but has no verdict yet is asked again, and repeats its verdict."""
        began = time.monotonic()
        while True:
            asked = time.monotonic()
            replies = ask(self._session, key, wire, self._timeout_s)
            if replies:
                return replies
            now = time.monotonic()
            busy = now - asked >= self._timeout_s and self._feed.heard_within(self._timeout_s)
            if not busy or now - began > _BUSY_LIMIT_S:
                # Zenoh tells at once that nobody is there; a time would then say nothing.
                waited = f" within {now - began:.0f} s" if now - asked >= self._timeout_s else ""
                raise PeerUnreachableError(
                    f"executor at {self._endpoint} did not answer on '{key}'{waited}; "
                    "it has ended or refused the message unread: look at its output"
                )

    def _command(self, key: str, body: Message, expected: type[R]) -> R:
        envelope = envelope_of(self._ask_all(key, codec.seal(body, self._address()))[0], self._who)
        if envelope.kind == pb.Verdict.DESCRIPTOR.full_name and expected is not pb.Verdict:
            raise refusal_error(body_of(envelope, pb.Verdict, self._who), f"'{key}'")
        return body_of(envelope, expected, self._who)

    def _judged(self, key: str, body: Message, what: str) -> Verdict:
        verdict = self._command(key, body, pb.Verdict)
        if not verdict.accepted:
            raise refusal_error(verdict, what)
        return Verdict(verdict.seq, verdict.epoch, verdict.duration)

    def _control(self, kind: pb.ControlKind, value: float = 0.0) -> Verdict:
        return self._judged(self._keys.control, pb.Control(kind=kind, value=value), pb.ControlKind.Name(kind))

    def _greet(self, timeout_s: float) -> tuple[ExecutorIdentity, ExecutorStatus]:
        wire = codec.seal(pb.Hello(client=self._sender, software="s2r"), codec.Address(sender=self._sender))
        deadline = time.monotonic() + timeout_s
        while True:
            replies = ask(self._session, self._keys.hello, wire, min(1.0, timeout_s))
            if replies:
                break
            if time.monotonic() > deadline:
                if self._met:
                    ended = "it has ended or hangs; look at its output, and at the arm"
                    if self._tls is not None:
                        ended += ". Its certificate may have ended as well"
                    raise PeerUnreachableError(
                        f"executor at {self._endpoint} has not answered for {timeout_s:g} s, and did before: "
                        + (certificate_trouble(self._tls) or ended)
                    )
                raise PeerUnreachableError(
                    f"no executor answered at {self._endpoint} within {timeout_s:g} s; "
                    f"start it with 's2r executor' or correct --executor, --cell or --arm{silence_hint(self._tls)}"
                )
            time.sleep(0.1)
        self._met = True
        body = answer(replies[0], pb.HelloReply, self._who)
        return identity_from_message(body), status_from_message(body.status)


def check_same_arm(identity: ExecutorIdentity, arm: ArmDescription) -> None:
    """Refuse to go on when host and executor mean different arms.

    Raises:
        ArmMismatchError: Names what differs and the first digits of both hashes.
    """
    for what, theirs, ours in (
        ("model", identity.model_hash, arm.model_hash),
        ("limits", identity.limit_hash, arm.limit_hash),
    ):
        if theirs != ours:
            raise ArmMismatchError(
                f"executor runs arm '{identity.arm}' with {what} {theirs.hex()[:12] or 'unknown'}, this host has "
                f"'{arm.name}' with {what} {ours.hex()[:12]}; start both with the same arm description and release"
            )
