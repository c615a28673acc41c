"""The host's sessions, and asking one question: no arrays, no messages, quick to import."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import zenoh
from google.protobuf.message import Message

from s2r_host.errors import DamagedAnswerError
from s2r_protocol import codec
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_protocol.session import CertificateError, Role, TlsFiles, connect, role_held

M = TypeVar("M", bound=Message)


def certificate_trouble(tls: Path | None) -> str:
    """Why this side's certificate cannot be used now, as when it ended while the link was up; empty when it can."""
    if tls is None:
        return ""
    from s2r_protocol.session.certificates import check_certificate

    try:
        check_certificate(TlsFiles.of(tls, role_held(tls, (Role.HOST, Role.MONITOR))))
    except CertificateError as error:
        return str(error)
    return ""


def silence_hint(tls: Path | None) -> str:
    """What silence may mean besides: with certificates a peer of another name or lab is not spoken to at all."""
    if tls is None:
        return ""
    if trouble := certificate_trouble(tls):
        return f". {trouble}"
    return (
        f". With --tls {tls} its address must also be one that was named to 's2r doctor --make-certs DIR --name', "
        "and both certificates of one lab and not expired"
    )


def open_session(
    endpoint: str,
    keys: ArmKeys,
    tls: Path | None = None,
    role: Role = Role.HOST,
    may_come_later: bool = False,
) -> zenoh.Session:
    """A session with one executor or camera; see :func:`s2r_protocol.session.connect`.

    Returns at once even when nobody listens there; a query then has zero replies.
    """
    return connect(endpoint, role, keys, tls, may_come_later)


def ask(session: zenoh.Session, key: str, wire: bytes, timeout_s: float) -> list[bytes]:
    """Send one query; all good replies' payloads in order. Empty means refused unread, dead or absent."""
    # Without NONE, Zenoh keeps only the newest reply of a key, and a recording comes as several.
    replies = session.get(key, payload=wire, timeout=timeout_s, consolidation=zenoh.ConsolidationMode.NONE)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


def envelope_of(wire: bytes, who: str) -> pb.Envelope:
    """The envelope of an answer.

    Raises:
        DamagedAnswerError: It is none; names who sent it.
    """
    try:
        return codec.open_envelope(wire)
    except codec.MessageRefusedError as error:
        raise DamagedAnswerError(f"{who} sent an answer that cannot be read: {error}") from error


def body_of(envelope: pb.Envelope, expected: type[M], who: str) -> M:
    """The body of an answer.

    Raises:
        DamagedAnswerError: It is none of this kind; names who sent it.
    """
    try:
        return codec.open_body(envelope, expected)
    except codec.MessageRefusedError as error:
        raise DamagedAnswerError(f"{who} sent an answer that cannot be read: {error}") from error


def answer(wire: bytes, expected: type[M], who: str) -> M:
    """An answer's body at once.

    Raises:
        DamagedAnswerError: It cannot be read; names who sent it.
    """
    return body_of(envelope_of(wire, who), expected, who)
