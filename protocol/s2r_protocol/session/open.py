"""Opening a Zenoh session: the one place that decides how processes of a cell reach each other.

Without certificates everything stays on this machine: loopback and local sockets only, no scouting.
With certificates both sides prove who they are (mutual TLS) and the access table of
:mod:`s2r_protocol.session.access` holds; nothing is ever spoken in the clear.
"""

from __future__ import annotations

import datetime
import ipaddress
import json
import re
import stat
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import zenoh

from s2r_protocol.exits import NotReadyError, UsageError
from s2r_protocol.keys import ArmKeys
from s2r_protocol.session.access import access_control
from s2r_protocol.session.tls import Role, TlsFiles

_LOCAL_PROTOCOLS = ("unixsock-stream", "unixpipe")
_MAX_MESSAGE_BYTES = (
    64 * 1024 * 1024
)  # a depth frame is about 3 MB, a part of a recording 4 MB, a plan below 1 MB
_ACCEPT_TIMEOUT_MS = 2000  # a peer that opens a socket and says nothing
_OPEN_TIMEOUT_MS = 2000


class ListenError(NotReadyError):
    """An address cannot be listened on."""


class AddressError(UsageError):
    """An address is malformed, or would open the arm to a network without certificates."""


def listen(
    endpoints: Sequence[str], role: Role, keys: ArmKeys, tls: Path | None = None, who: str = ""
) -> zenoh.Session:
    """A peer that listens and connects to nobody.

    Args:
        endpoints: Zenoh endpoints, e.g. ``tcp/127.0.0.1:7447``. With ``tls`` they are served as ``tls/…``.
        role: Who this process is.
        keys: Cell and arm.
        tls: Folder with the certificates, or None for this machine only.
        who: What people call this process where its role does not say it.

    Raises:
        AddressError: An endpoint leaves this machine and there are no certificates.
        CertificateError: A certificate is missing, expired or of another authority.
        ListenError: An endpoint is taken.
    """
    addresses = [endpoint_for(endpoint, tls is not None, "listen on") for endpoint in endpoints]
    settings = {
        "listen/endpoints": addresses,
        "listen/exit_on_failure": True,
        "connect/endpoints": [],
    }
    config = _config(settings, role, keys, tls)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        name = who or str(role)
        raise ListenError(
            f"{name} cannot listen on {', '.join(addresses)}: {_reason(error)}. Is another {name} running? "
            "Stop it or choose another address with --listen"
        ) from error


def _reason(error: zenoh.ZError) -> str:
    """Zenoh's sentence without the places in its sources that it went through."""
    text = str(error)
    said = re.search(r"[^\[\]:]+\(os error \d+\)", text)
    return said.group().strip() if said is not None else text.rstrip(".")


def connect(
    endpoint: str, role: Role, keys: ArmKeys, tls: Path | None = None, may_come_later: bool = False
) -> zenoh.Session:
    """A peer that connects to one endpoint and listens nowhere; a link that was lost is tried again every 100 ms.

    Returns at once even when nobody listens there, or does not accept the certificate; a query then has zero replies.

    Args:
        endpoint: Zenoh endpoint, e.g. ``tcp/127.0.0.1:7447``.
        role: Who this process is.
        keys: Cell and arm.
        tls: Folder with the certificates, or None for this machine only.
        may_come_later: Also try every 100 ms where nobody listens yet. Now and then that takes half a second longer,
            which a stop cannot wait for.

    Raises:
        AddressError: The endpoint leaves this machine and there are no certificates.
        CertificateError: A certificate is missing, expired or of another authority.
    """
    settings = {
        "connect/endpoints": [endpoint_for(endpoint, tls is not None, "connect to")],
        "connect/timeout_ms": -1 if may_come_later else 0,  # 0: Zenoh tries once, whatever the retries below
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 100, "period_increase_factor": 1},
        "listen/endpoints": [],
    }
    return zenoh.open(_config(settings, role, keys, tls))


def endpoint_for(endpoint: str, has_tls: bool, what: str = "use") -> str:
    """The endpoint as it is used: ``tls/…`` with certificates, unchanged and local without.

    Raises:
        AddressError: It is malformed, or leaves this machine without certificates.
    """
    protocol, _, address = endpoint.partition("/")
    if not protocol or not address:
        raise AddressError(f"address {endpoint!r}: expected PROTOCOL/ADDRESS, e.g. tcp/127.0.0.1:7447")
    if has_tls:
        if protocol not in ("tcp", "tls"):
            raise AddressError(f"cannot {what} {endpoint} with certificates: use tls/HOST:PORT")
        return f"tls/{address}"
    if protocol in _LOCAL_PROTOCOLS:
        return endpoint
    if protocol != "tcp":
        raise AddressError(
            f"cannot {what} {endpoint} without certificates: use tcp/127.0.0.1:PORT, or --tls DIR"
        )
    if not _is_loopback(address):
        raise AddressError(
            f"will not {what} {endpoint} without certificates: anybody on that network could command the arm. "
            "Use tcp/127.0.0.1:PORT, or make certificates with 's2r doctor --make-certs DIR' and pass --tls DIR"
        )
    return endpoint


def _is_loopback(address: str) -> bool:
    host = address.partition("#")[0].partition("?")[0].rpartition(":")[0].strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:  # a name: who it is today is not ours to trust
        return False


def _config(settings: dict[str, Any], role: Role, keys: ArmKeys, tls: Path | None) -> zenoh.Config:
    common = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "adminspace/enabled": False,
        "plugins_loading/enabled": False,
        "transport/unicast/accept_timeout": _ACCEPT_TIMEOUT_MS,
        "transport/unicast/open_timeout": _OPEN_TIMEOUT_MS,
        "transport/link/rx/max_message_size": _MAX_MESSAGE_BYTES,
        # Its pool of 16 MB pays for pictures; what an executor sends is small.
        "transport/shared_memory/enabled": role is not Role.EXECUTOR,
    }
    secure = _secured(TlsFiles.of(tls, role), keys) if tls is not None else {}
    config = zenoh.Config()
    for key, value in (common | settings | secure).items():
        config.insert_json5(key, json.dumps(value))
    return config


@cache  # once per process: a host opens several sessions with one certificate
def _warn(files: TlsFiles, ends: datetime.datetime) -> None:
    """Tell what still works and should not stay so."""
    import logging  # not on the way to a stop

    logger = logging.getLogger(__name__)
    if files.key.stat().st_mode & stat.S_IROTH:
        logger.warning(
            "%s can be read by every user of this machine, who then may do what '%s' may: chmod 400 %s",
            files.key,
            files.role,
            files.key,
        )
    from s2r_protocol.session.expiry import SOON, tell_soon

    if ends - datetime.datetime.now(datetime.UTC) < SOON:
        tell_soon(files, ends)


def _secured(files: TlsFiles, keys: ArmKeys) -> dict[str, Any]:
    from s2r_protocol.session.certificates import check_certificate  # 30 ms that loopback need not pay

    ends = check_certificate(files)
    _warn(files, ends)
    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls": {
            "root_ca_certificate": str(files.ca),
            "listen_private_key": str(files.key),
            "listen_certificate": str(files.certificate),
            "connect_private_key": str(files.key),
            "connect_certificate": str(files.certificate),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        },
        "access_control": access_control(files.role, keys),
    }
