"""Zenoh sessions of all processes: one policy for addresses, certificates and who may send what to whom."""

from s2r_protocol.session.open import AddressError, ListenError, connect, endpoint_for, listen
from s2r_protocol.session.tls import CertificateError, Role, TlsFiles, role_held

__all__ = [
    "AddressError",
    "CertificateError",
    "ListenError",
    "Role",
    "TlsFiles",
    "connect",
    "endpoint_for",
    "listen",
    "role_held",
]
