"""The host's sessions, and asking one question: no arrays, no messages, quick to import."""

from __future__ import annotations

from pathlib import Path

import zenoh

from s2r_protocol.keys import ArmKeys
from s2r_protocol.session import CertificateError, Role, TlsFiles, connect, role_held


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
    endpoint: str, keys: ArmKeys, tls: Path | None = None, role: Role = Role.HOST
) -> zenoh.Session:
    """A session with one executor or camera; see :func:`s2r_protocol.session.connect`.

    Returns at once even when nobody listens there; a query then has zero replies.
    """
    return connect(endpoint, role, keys, tls)


def ask(session: zenoh.Session, key: str, wire: bytes, timeout_s: float) -> list[bytes]:
    """Send one query; all good replies' payloads in order. Empty means refused unread, dead or absent."""
    # Without NONE, Zenoh keeps only the newest reply of a key, and a recording comes as several.
    replies = session.get(key, payload=wire, timeout=timeout_s, consolidation=zenoh.ConsolidationMode.NONE)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]
