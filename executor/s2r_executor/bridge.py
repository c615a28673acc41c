"""The front end on the wire: the only file of the executor that turns messages into domain objects and back.

Commands are Zenoh queries with sealed protobuf; observations are ROS 2 CDR puts on rmw_zenoh keys.
Every query gets an answer, also one that is refused unread; no answer at all means that nobody is here.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError, version

import numpy as np
import zenoh
from google.protobuf.message import Message

from s2r_executor.checks.form import check_names
from s2r_executor.config import ExecutorConfig
from s2r_executor.front_end import Accepted, FrontEnd
from s2r_executor.observations import EVENTS, PLAN, TIMING, TOPICS, Encoder, Topic
from s2r_executor.plan import CommandRefusedError, PlanRequest
from s2r_executor.refusal_log import RefusalLog
from s2r_executor.status import ExecutorStatus
from s2r_protocol import codec, session
from s2r_protocol.exits import NotReadyError
from s2r_protocol.faults import Refusal
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_protocol.ros2.keys import node_token, publisher_token, topic_key
from s2r_protocol.ros2.publisher import Publisher
from s2r_protocol.session import Role
from s2r_protocol.session.expiry import watch_certificate

logger = logging.getLogger(__name__)

_NODE = "s2r_executor"
_TIMING_PERIOD_S = 0.5


def software_name() -> str:
    """Name and version, shown in handshakes."""
    try:
        return f"sim2real2 {version('sim2real2')}"
    except PackageNotFoundError:  # run from a source tree
        return "sim2real2 (source)"


class Bridge:
    """Serves one front end on one Zenoh session until closed."""

    def __init__(self, front_end: FrontEnd, encoder: Encoder, config: ExecutorConfig) -> None:
        """Open the session and declare everything.

        Raises:
            ListenError: An address is taken.
            AddressError: An address leaves this machine and there are no certificates.
            CertificateError: A certificate cannot be used.
        """
        self._front_end = front_end
        self._encoder = encoder
        self._config = config
        self._keys = ArmKeys(config.cell, front_end.arm.name)
        self._me = codec.Address(
            sender=f"executor:{self._keys.base}",
            boot_id=front_end.identity.boot_id,
            model_hash=front_end.identity.model_hash,
            limit_hash=front_end.identity.limit_hash,
        )
        self._commands = ThreadPoolExecutor(max_workers=1, thread_name_prefix="s2r-command")
        self._refusals = RefusalLog()
        self._ended = threading.Event()
        self._failure: Exception | None = None  # of the publishing thread
        self._publish_lock = threading.Lock()
        self._session = session.listen(config.listen, Role.EXECUTOR, self._keys, config.tls)
        try:
            self._expiry = watch_certificate(config.tls, Role.EXECUTOR)
            self._tokens = self._declare_node()
            self._publishers = {topic: Publisher(self._session, self._topic_key(topic)) for topic in TOPICS}
            self._queryables = [
                self._session.declare_queryable(key, handler, complete=True)
                for key, handler in (
                    (self._keys.hello, self._direct(self._hello)),
                    (self._keys.lease, self._direct(self._lease)),
                    (self._keys.plan, self._queued(self._plan)),
                    (self._keys.control, self._on_control),
                    (self._keys.recording, self._on_recording),
                )
            ]
            self._subscriber = self._session.declare_subscriber(self._keys.heartbeat, self._on_heartbeat)
        except BaseException:
            self._session.close()
            raise
        self._publishing = threading.Thread(target=self._publish_until_ended, name="s2r-publish", daemon=True)
        self._publishing.start()

    # -- observations -------------------------------------------------------------------------------

    def publish_events(self, events: np.ndarray) -> None:
        """Publish the core's events; does nothing once closed."""
        with self._publish_lock:
            if self._ended.is_set():
                return
            for event in events:
                stamp_ns, message = self._encoder.event(event)
                self._publishers[EVENTS].put(message, stamp_ns)

    def _publish(self, topic: Topic, stamp_ns: int, message: bytes) -> None:
        with self._publish_lock:
            if not self._ended.is_set():
                self._publishers[topic].put(message, stamp_ns)

    def check(self) -> None:
        """Look after the publishing thread.

        Raises:
            NotReadyError: It ended by itself: nobody sees this executor any more.
        """
        if self._failure is not None:
            raise NotReadyError(
                f"the executor publishes no more: {self._failure}; restart it"
            ) from self._failure

    def _publish_until_ended(self) -> None:
        try:
            self._publish_loop()
        except Exception as error:
            logger.exception("publishing failed")
            self._failure = error

    def _publish_loop(self) -> None:
        timing_at_s = 0.0
        while not self._ended.wait(self._config.publish_period_s):
            if time.monotonic() >= timing_at_s:
                timing_at_s = time.monotonic() + _TIMING_PERIOD_S
                self._refusals.tell()
                if self._expiry is not None:
                    self._expiry.look()
                self._publish(TIMING, *self._encoder.timing(*self._front_end.punctuality()))
            self._publish_state()
        self._publish_state()  # how it ended, for whoever waits for a motion

    def _publish_state(self) -> None:
        status = self._front_end.status()
        stamp_ns = int(self._encoder.timeline.of(status.core.tick, status.core.stamp_ns))
        for topic, message in self._encoder.snapshot(status):
            self._publishers[topic].put(message, stamp_ns)

    def _topic(self, topic: Topic) -> str:
        return f"/{self._keys.base}/{topic.name}"

    def _topic_key(self, topic: Topic) -> str:
        return topic_key(self._topic(topic), topic.type_name, self._config.ros_domain)

    def _declare_node(self) -> list[zenoh.LivelinessToken]:
        """Make `ros2 node list` and `ros2 topic list` show this executor."""
        zid, namespace, domain = str(self._session.info.zid()), f"/{self._keys.base}", self._config.ros_domain
        tokens = [node_token(zid, _NODE, namespace, domain)] + [
            publisher_token(zid, i, _NODE, self._topic(topic), topic.type_name, namespace, domain)
            for i, topic in enumerate(TOPICS, start=1)
        ]
        return [self._session.liveliness().declare_token(token) for token in tokens]

    # -- queries ------------------------------------------------------------------------------------

    def _direct(self, answer: Callable[[pb.Envelope, bytes], Message]) -> Callable[[zenoh.Query], None]:
        """Answer in Zenoh's own thread: quick ones."""
        return lambda query: self._answer(query, answer)

    def _queued(self, answer: Callable[[pb.Envelope, bytes], Message]) -> Callable[[zenoh.Query], None]:
        """Answer in the command thread, one at a time: those that wait for the core."""
        return lambda query: self._submit(query, answer)

    def _submit(self, query: zenoh.Query, answer: Callable[[pb.Envelope, bytes], Message]) -> None:
        try:
            self._commands.submit(self._answer, query, answer)
        except RuntimeError:  # shutting down: silence means dead, which is what we are about to be
            logger.info("query on %s came while shutting down", query.key_expr)

    def _answer(self, query: zenoh.Query, answer: Callable[[pb.Envelope, bytes], Message]) -> None:
        wire, what = _payload(query), f"a message on {query.key_expr}"
        try:
            envelope = codec.open_envelope(wire)
            what = _name_of(codec.address_of(envelope), str(query.key_expr))
            reply = answer(envelope, wire)
        except codec.MessageRefusedError as error:
            self._refusals.add(what, error)
            reply = pb.Verdict(accepted=False, code=error.code, reason=str(error))
        except CommandRefusedError as error:
            self._refusals.add(what, error)
            reply = self._refused(error, 0)
        except Exception:
            logger.exception("a query on %s failed", query.key_expr)
            reply = pb.Verdict(
                accepted=False,
                code=Refusal.INTERNAL,
                reason="the executor failed on this message; see its log",
            )
        self._reply(query, [reply])

    def _sealed(self, body: Message) -> bytes:
        return codec.seal(body, self._me)

    def _reply(self, query: zenoh.Query, bodies: Sequence[Message]) -> None:
        try:
            for body in bodies:
                query.reply(query.key_expr, self._sealed(body), express=True)
        except zenoh.ZError as error:  # the asker has gone
            logger.warning("answer on %s could not be sent: %s", query.key_expr, error)
        finally:
            query.drop()  # tells the asker that this was all; without it it waits until its time is up

    def _hello(self, envelope: pb.Envelope, wire: bytes) -> pb.HelloReply:
        codec.open_body(envelope, pb.Hello)
        front_end = self._front_end
        status = front_end.status()
        return pb.HelloReply(
            boot_id=front_end.identity.boot_id,
            epoch=status.core.epoch,
            arm=front_end.arm.name,
            model_hash=front_end.identity.model_hash,
            limit_hash=front_end.identity.limit_hash,
            joint_names=front_end.arm.joint_names,
            tick_ns=self._config.tick_ns,
            software=software_name(),
            status=status_to_message(status),
            host_timeout_ms=round(self._config.effective_host_timeout_s * 1e3),
        )

    def _lease(self, envelope: pb.Envelope, wire: bytes) -> pb.LeaseReply:
        body = codec.open_body(envelope, pb.LeaseRequest)
        decision = self._front_end.lease(codec.address_of(envelope), body.release)
        return pb.LeaseReply(
            granted=decision.granted,
            epoch=self._front_end.status().core.epoch,
            holder=decision.holder,
            reason=decision.reason,
        )

    def _plan(self, envelope: pb.Envelope, wire: bytes) -> pb.Verdict:
        def act(address: codec.Address) -> Accepted:
            body = codec.open_body(envelope, pb.Plan)
            check_names(
                tuple(body.joint_names), self._front_end.arm.joint_names
            )  # the arrays' shape hangs on them
            request = plan_from_message(body)
            accepted = self._front_end.plan(address, request, wire)
            self._publish(PLAN, *self._encoder.plan(request))
            return accepted

        return self._once(envelope, wire, act)

    def _control(self, envelope: pb.Envelope, wire: bytes) -> pb.Verdict:
        body = codec.open_body(envelope, pb.Control)
        return self._once(
            envelope, wire, lambda address: self._front_end.control(address, body.kind, body.value)
        )

    def _stop(self, envelope: pb.Envelope, wire: bytes) -> pb.Verdict:
        """Needs neither lease nor epoch, and no number: whoever sends the same bytes again wants to stop again."""
        body = codec.open_body(envelope, pb.Control)
        address = codec.address_of(envelope)
        return _accepted(self._front_end.control(address, body.kind, body.value), address.seq)

    def _once(
        self, envelope: pb.Envelope, wire: bytes, act: Callable[[codec.Address], Accepted]
    ) -> pb.Verdict:
        """Carry out a new command, or repeat the verdict of one that came before."""
        address = codec.address_of(envelope)
        book = self._front_end.book
        known = book.repeated(address, wire)
        if known is not None:
            return pb.Verdict.FromString(known)
        try:
            # Wrong process, arm or epoch is refused before the body is parsed, a used number before anything acts.
            self._front_end.check_door(address)
            book.admit(address)
            verdict = _accepted(act(address), address.seq)
        except CommandRefusedError as error:
            self._refusals.add(_name_of(address, envelope.kind), error)
            verdict = self._refused(error, address.seq)
        book.remember(address, wire, verdict.SerializeToString())
        return verdict

    def _refused(self, error: CommandRefusedError, seq: int) -> pb.Verdict:
        return pb.Verdict(
            accepted=False,
            code=error.code,
            reason=str(error),
            joint=error.joint,
            t=error.t,
            quantity=error.quantity,
            value=error.value,
            limit=error.limit,
            seq=seq,
            epoch=self._front_end.status().core.epoch,
        )

    def _on_control(self, query: zenoh.Query) -> None:
        """STOP is carried out in this thread, past everything that waits."""
        if _is_stop(_payload(query)):
            self._answer(query, self._stop)
        else:
            self._submit(query, self._control)

    def _on_recording(self, query: zenoh.Query) -> None:
        """A recording may be long, so it comes as several replies, in order."""
        wire = _payload(query)
        try:
            request = codec.open_body(codec.open_envelope(wire), pb.RecordingRequest)
            replies = self._recording_replies(request.plan_seq)
        except codec.MessageRefusedError as error:
            self._refusals.add(f"a message on {query.key_expr}", error)
            replies = [pb.Verdict(accepted=False, code=error.code, reason=str(error))]
        except OSError as error:
            logger.exception("a recording cannot be read")
            replies = [pb.RecordingReply(complete=False, reason=f"the recording cannot be read: {error}")]
        self._reply(query, replies)

    def _recording_replies(self, plan_seq: int) -> list[Message]:
        answer = self._front_end.recording(plan_seq)
        if answer.path is None:
            return [pb.RecordingReply(plan_seq=plan_seq, complete=answer.complete, reason=answer.reason)]
        data = answer.path.read_bytes()
        size = self._config.recorder.reply_chunk_bytes
        begins = range(0, max(len(data), 1), size)
        return [
            pb.RecordingReply(plan_seq=plan_seq, complete=True, mcap=data[i : i + size], pieces=len(begins))
            for i in begins
        ]

    def _on_heartbeat(self, sample: zenoh.Sample) -> None:
        try:
            envelope = codec.open_envelope(sample.payload.to_bytes())
            codec.open_body(envelope, pb.Heartbeat)
        except codec.MessageRefusedError as error:
            self._refusals.add(f"a message on {self._keys.heartbeat}", error)
            return
        self._front_end.heartbeat(codec.address_of(envelope))

    def close(self) -> None:
        """Finish the commands under way and leave the network."""
        with self._publish_lock:
            self._ended.set()
        self._publishing.join()
        self._commands.shutdown(wait=True)
        for declared in (*self._queryables, self._subscriber):
            declared.undeclare()
        self._session.close()


def _payload(query: zenoh.Query) -> bytes:
    return query.payload.to_bytes() if query.payload is not None else b""


def _name_of(address: codec.Address, on: str) -> str:
    return f"message {address.seq} of '{address.sender}' ({on})"


def _is_stop(wire: bytes) -> bool:
    try:
        return codec.open_body(codec.open_envelope(wire), pb.Control).kind == pb.STOP
    except codec.MessageRefusedError:
        return False  # refused again, with an answer, on the ordinary way


def _accepted(accepted: Accepted, seq: int) -> pb.Verdict:
    return pb.Verdict(accepted=True, seq=seq, epoch=accepted.epoch, duration=accepted.duration_s)


def plan_from_message(body: pb.Plan) -> PlanRequest:
    """A plan as arrays.

    Raises:
        CommandRefusedError: SIZE, when an array cannot be knots times joints, or the payload has no three coordinates.
    """
    dof, n = len(body.joint_names), len(body.t)
    arrays = {}
    for name in ("q", "dq", "ddq"):
        values = np.array(getattr(body, name), dtype=float)
        if len(values) != n * dof:
            raise CommandRefusedError(
                Refusal.SIZE,
                f"{name} holds {len(values)} values, {n} knots of {dof} joints need {n * dof}; send knot "
                "after knot, a value per joint",
                quantity=name,
                value=len(values),
                limit=n * dof,
            )
        arrays[name] = values.reshape(n, dof)
    if len(body.payload_com) not in (0, 3):
        raise CommandRefusedError(
            Refusal.SIZE,
            f"payload_com holds {len(body.payload_com)} values, expected none or 3: x, y, z in the tool frame",
            quantity="payload_com",
            value=len(body.payload_com),
            limit=3,
        )
    x, y, z = body.payload_com or (0.0, 0.0, 0.0)
    return PlanRequest(
        joint_names=tuple(body.joint_names),
        t=np.array(body.t, dtype=float),
        **arrays,
        parent_seq=body.parent_seq,
        splice_t=body.splice_t,
        payload_mass=body.payload_mass,
        payload_com=(x, y, z),
        path_tolerance=body.path_tolerance,
        goal_tolerance=body.goal_tolerance,
        label=body.label[:200],
    )


def status_to_message(status: ExecutorStatus) -> pb.Status:
    """The state for a reply."""
    core = status.core
    return pb.Status(
        state=core.state,
        cause=core.cause,
        why_not_moving=status.why_not_moving,
        tick=core.tick,
        epoch=core.epoch,
        plan_seq=status.plan_seq,
        plan_t=core.plan_t,
        speed_scale=core.speed_scale,
        q_ref=core.q_ref,
        dq_ref=core.dq_ref,
        ddq_ref=core.ddq_ref,
        q_meas=core.q_meas,
        dq_meas=core.dq_meas,
        tau_meas=core.tau_meas,
        lease_holder=status.lease_holder,
        plan_done=bool(core.plan_done),
        silent_joints=status.silent_joints,
    )
