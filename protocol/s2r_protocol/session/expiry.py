"""A process that goes on for longer than its certificate says so: links end then, and nothing else tells why."""

from __future__ import annotations

import datetime
import logging
from pathlib import Path

from s2r_protocol.session.tls import Role, TlsFiles

SOON = datetime.timedelta(days=7)
_AGAIN = datetime.timedelta(days=1)

logger = logging.getLogger(__name__)


class ExpiryWatch:
    """Tells in the log, once a day, that a certificate ends soon, and when it has ended.

    What counts is the certificate that the process was started with: one that was renewed since is not in use yet.
    """

    def __init__(
        self, files: TlsFiles, ends: datetime.datetime, now: datetime.datetime | None = None
    ) -> None:
        """Watch from now on; that it ends soon already was told where it was opened."""
        now = now or datetime.datetime.now(datetime.UTC)
        self._files, self._ends = files, ends
        self._next = min(now + _AGAIN, ends) if ends - now < SOON else ends - SOON

    def look(self, now: datetime.datetime | None = None) -> None:
        """Tell what is to be told now; costs nothing in between."""
        now = now or datetime.datetime.now(datetime.UTC)
        if now < self._next:
            return
        if now < self._ends:
            tell_soon(self._files, self._ends)
            self._next = min(now + _AGAIN, self._ends)
            return
        logger.error(
            "%s ended on %s UTC: nobody reaches this %s over its links any more; renew it with "
            "'s2r doctor --make-certs' where the authority's key is, then start this process again",
            self._files.certificate,
            f"{self._ends:%Y-%m-%d %H:%M}",
            self._files.role,
        )
        self._next = now + _AGAIN


def tell_soon(files: TlsFiles, ends: datetime.datetime) -> None:
    """In the log: a certificate ends soon."""
    logger.warning(
        "%s ends on %s UTC: renew it with 's2r doctor --make-certs' where the authority's key is, then start what uses "
        "it again",
        files.certificate,
        f"{ends:%Y-%m-%d %H:%M}",
    )


def watch_certificate(tls: Path | None, role: Role) -> ExpiryWatch | None:
    """A watch over the certificate that a session has just been opened with; None without one.

    Raises:
        CertificateError: It cannot be used.
    """
    if tls is None:
        return None
    from s2r_protocol.session.certificates import check_certificate

    files = TlsFiles.of(tls, role)
    return ExpiryWatch(files, check_certificate(files))
