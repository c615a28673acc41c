"""A short talk with one executor from a terminal: hello, a command, its verdict. No numerics: it starts fast."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType

from google.protobuf.message import Message

from s2r_host.errors import CommandRefusedError, PeerUnreachableError
from s2r_host.link_session import answer, ask, body_of, envelope_of, open_session, silence_hint
from s2r_protocol import codec
from s2r_protocol.faults import Refusal
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_protocol.session import Role


class Talk:
    """A session of its own with a greeting; a context manager."""

    def __init__(
        self,
        who: str,
        endpoint: str,
        keys: ArmKeys,
        timeout_s: float,
        tls: Path | None,
        in_vain: str,
        role: Role = Role.HOST,
    ) -> None:
        """Connect and say hello.

        Args:
            who: Kind of client, a word.
            endpoint: Zenoh endpoint, e.g. ``tcp/127.0.0.1:7447``.
            keys: Cell and arm.
            timeout_s: Longest wait for any answer [s].
            tls: Folder with the certificates; None when the executor is on this machine.
            in_vain: What silence means to whoever asks: "nothing was stopped".
            role: Whose certificate is shown.

        Raises:
            PeerUnreachableError: Nobody answered.
        """
        self.endpoint, self.keys = endpoint, keys
        self._who = f"executor at {endpoint}"
        self._timeout_s, self._tls, self._in_vain = timeout_s, tls, in_vain
        self._seq = 0
        self._me = codec.Address(f"{who}:{os.getpid()}-{os.urandom(2).hex()}")  # secrets would load OpenSSL
        self._session = open_session(endpoint, keys, tls, role)
        try:
            self.hello = self.greet()
        except BaseException:
            self._session.close()
            raise

    def greet(self) -> pb.HelloReply:
        """Who is there, and in which state; commands are addressed to that process and epoch from then on.

        Raises:
            PeerUnreachableError: Nobody answered.
        """
        wire = codec.seal(pb.Hello(client=self._me.sender, software="s2r"), codec.Address(self._me.sender))
        deadline = time.monotonic() + self._timeout_s
        while not (replies := ask(self._session, self.keys.hello, wire, 0.5)):
            if time.monotonic() > deadline:
                raise PeerUnreachableError(
                    f"no executor answered at {self.endpoint} within {self._timeout_s:g} s: {self._in_vain}; "
                    f"correct --executor, --cell or --arm if it runs elsewhere{silence_hint(self._tls)}"
                )
            time.sleep(0.02)
        hello = answer(replies[0], pb.HelloReply, self._who)
        self._me = replace(
            self._me,
            boot_id=hello.boot_id,
            epoch=hello.epoch,
            model_hash=hello.model_hash,
            limit_hash=hello.limit_hash,
        )
        return hello

    def control(self, kind: pb.ControlKind) -> pb.Verdict:
        """Send a command; its verdict, which is a yes.

        Raises:
            PeerUnreachableError: No answer.
            CommandRefusedError: The executor refused it.
        """
        name = pb.ControlKind.Name(kind)
        envelope = self._ask(self.keys.control, pb.Control(kind=kind), name)
        verdict = body_of(envelope, pb.Verdict, self._who)
        if not verdict.accepted:
            raise self._refused(name, verdict.reason, verdict.code)
        return verdict

    @contextmanager
    def leased(self) -> Iterator[None]:
        """Hold the lease inside the block, with a heartbeat.

        Raises:
            CommandRefusedError: Somebody else holds it.
            PeerUnreachableError: No answer.
        """
        from s2r_host.link_heartbeat import Heart  # loads logging, which a stop does not wait for

        self._lease(release=False)
        heart = Heart(self._session, self.keys.heartbeat, self._beat)
        try:
            yield
        finally:
            try:
                self._lease(release=True)
            finally:
                heart.stop()

    def _lease(self, release: bool) -> None:
        what = "the lease's return" if release else "the lease"
        envelope = self._ask(self.keys.lease, pb.LeaseRequest(release=release), what)
        if envelope.kind == pb.Verdict.DESCRIPTOR.full_name:
            verdict = body_of(envelope, pb.Verdict, self._who)
            raise self._refused(what, verdict.reason, verdict.code)
        reply = body_of(envelope, pb.LeaseReply, self._who)
        if not reply.granted:
            told = f"{reply.reason}; stop that client or wait until it ends"
            raise self._refused(what, told, Refusal.NO_LEASE)

    def _beat(self, count: int) -> bytes:
        return codec.seal(pb.Heartbeat(count=count), replace(self._me, seq=count))

    def _ask(self, key: str, body: Message, what: str) -> pb.Envelope:
        self._seq += 1
        replies = ask(self._session, key, codec.seal(body, replace(self._me, seq=self._seq)), self._timeout_s)
        if not replies:
            raise PeerUnreachableError(
                f"executor at {self.endpoint} did not answer {what} within {self._timeout_s:g} s: it is not known "
                "whether that was done; look at its output, and at the arm"
            )
        return envelope_of(replies[0], self._who)

    def _refused(self, what: str, reason: str, code: int) -> CommandRefusedError:
        known = code in Refusal._value2member_map_
        return CommandRefusedError(
            f"executor at {self.endpoint} refused {what}: {reason}",
            Refusal(code) if known else Refusal.INTERNAL,
        )

    def __enter__(self) -> Talk:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._session.close()
