"""Telling systemd how we are: ready, alive, stopping (sd_notify(3), one datagram of text each).

Outside systemd every call does nothing.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Mapping

logger = logging.getLogger(__name__)


class ServiceManager:
    """The socket that the service manager gave us, if it did.

    Attributes:
        watchdog_s: How long it waits for a sign of life [s]; None if it does not.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        """Read ``NOTIFY_SOCKET``, ``WATCHDOG_USEC`` and ``WATCHDOG_PID``."""
        self._address = environment.get("NOTIFY_SOCKET", "")
        self._reached = True
        usec = environment.get("WATCHDOG_USEC", "")
        ours = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.watchdog_s = int(usec) * 1e-6 if usec.isdigit() and ours and int(usec) > 0 else None

    def ready(self, status: str) -> None:
        """Everything listens; ``status`` is shown by ``systemctl status``."""
        self._send(f"READY=1\nSTATUS={_one_line(status)}", wait_s=1.0)

    def alive(self, status: str = "") -> None:
        """A sign of life; leaving it out for ``watchdog_s`` gets the process killed and restarted."""
        self._send("WATCHDOG=1" + (f"\nSTATUS={_one_line(status)}" if status else ""))

    def stopping(self) -> None:
        """The end has begun: the arm is being brought to rest."""
        self._send("STOPPING=1")

    def _send(self, text: str, wait_s: float = 0.0) -> None:
        if not self._address:
            return
        # A leading @ means Linux's abstract namespace.
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as line:
                line.settimeout(wait_s)
                line.sendto(text.encode(), address)
            self._reached = True
        except OSError as error:  # gone or busy: no reason to drop the arm, nor to fall silent for good
            if self._reached:
                logger.warning("service manager not reached at %s: %s", self._address, error)
            self._reached = False


def _one_line(text: str) -> str:
    return " ".join(text.split())
