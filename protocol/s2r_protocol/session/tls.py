"""The roles of a cell and where each finds its key, its certificate and the lab's authority."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from s2r_protocol.exits import NotReadyError

CA_CERTIFICATE = "ca.pem"
CA_KEY = "ca.key"


class CertificateError(NotReadyError):
    """A certificate or key is missing, unreadable, expired or of another authority."""


class Role(enum.StrEnum):
    """Who a process is. The value is the common name of its certificate."""

    HOST = "host"  # may take the lease and move the arm
    EXECUTOR = "executor"
    CAMERA = "camera"
    MONITOR = "monitor"  # reads everything, commands nothing


@dataclass(frozen=True)
class TlsFiles:
    """One process's three files in a folder made by ``s2r doctor --make-certs``."""

    role: Role
    ca: Path
    certificate: Path
    key: Path

    @staticmethod
    def of(folder: Path, role: Role) -> TlsFiles:
        """The files of ``role`` in ``folder``.

        Raises:
            CertificateError: One is missing or cannot be read.
        """
        files = TlsFiles(role, folder / CA_CERTIFICATE, folder / f"{role}.pem", folder / f"{role}.key")
        for path in (files.ca, files.certificate, files.key):
            try:
                path.open("rb").close()
            except OSError as error:
                raise CertificateError(
                    f"{role}: {path} cannot be read ({error.strerror})"
                    f"{'' if path == files.ca else _others(folder, role)}; make it with "
                    f"'s2r doctor --make-certs {folder}' on the lab's authority and copy {CA_CERTIFICATE}, "
                    f"{files.certificate.name} and {files.key.name} here"
                ) from error
        return files


def role_held(folder: Path | None, roles: Sequence[Role]) -> Role:
    """The first of some roles, any of which will do, whose files lie in ``folder``; the first of all where none do."""
    if folder is None:
        return roles[0]
    for role in roles:
        try:
            return TlsFiles.of(folder, role).role
        except CertificateError:
            continue
    return roles[0]


def _others(folder: Path, role: Role) -> str:
    """Which other roles' certificates are there, and that they will not do."""
    found = [str(other) for other in Role if other != role and (folder / f"{other}.pem").exists()]
    return f"; the certificate of {' and '.join(found)} that is there may not do this" if found else ""
