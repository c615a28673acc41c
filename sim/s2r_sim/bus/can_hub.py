"""The stand-in on a SocketCAN interface, such as vcan0: the kernel carries the frames, and shows them to candump.

No error frame can be injected there, so the bus model's "transmit queue full" and end-of-period marks stay silent.
"""

from __future__ import annotations

import contextlib
import logging
import select
import socket
from collections.abc import Iterator

from s2r_sim.bus.hub import Client, Hub
from s2r_sim.errors import StandInError

logger = logging.getLogger(__name__)

_BURST = 64


def open_hub(address: str) -> Hub | CanHub:
    """The hub for ``unix:PATH`` or ``can:IFACE``.

    Raises:
        StandInError: It cannot be opened.
    """
    return CanHub(address) if address.startswith("can:") else Hub(address)


class CanHub:
    """One raw socket; everybody else on the interface counts as one client."""

    def __init__(self, address: str) -> None:
        """Join ``can:IFACE``.

        Raises:
            StandInError: There is no such interface, it is down, or the kernel knows no CAN.
        """
        self.path = address
        try:
            self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        except OSError as error:
            raise StandInError(
                f"cannot join {address}: this kernel has no CAN ({error.strerror}); use unix:PATH"
            ) from error
        try:
            self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            self._socket.bind((address.partition(":")[2],))
        except OSError as error:
            self._socket.close()
            raise StandInError(
                f"cannot join {address}: {error.strerror}; bring the interface up, or correct --bus"
            ) from error
        self._socket.setblocking(False)
        self._wake_receive, self._wake_send = socket.socketpair()
        self.others = Client(self._socket, 1)
        self.clients = [self.others]

    def wake(self) -> None:
        """End a :meth:`receive` from a signal handler."""
        with contextlib.suppress(OSError):
            self._wake_send.send(b"x")

    def receive(self, timeout_s: float | None) -> Iterator[tuple[Client, bytes | None]]:
        """Wait for frames, then yield them. Nobody ever leaves."""
        ready, _, _ = select.select([self._socket, self._wake_receive], [], [], timeout_s)
        if self._wake_receive in ready:
            self._wake_receive.recv(64)
        if self._socket in ready:
            for _ in range(_BURST):
                try:
                    packet = self._socket.recv(128)
                except BlockingIOError:
                    return
                except OSError as error:  # the interface went down: as silent as a cut cable
                    logger.warning("%s: %s", self.path, error.strerror)
                    return
                yield self.others, packet

    def broadcast(self, packet: bytes, sender: object = None) -> None:
        """Send a drive's frame; what a client sent, the kernel has delivered already."""
        if sender is not None:
            return
        try:
            self._socket.send(packet)
        except OSError:  # queue full or interface down
            self.others.lost += 1

    def send(self, client: Client, packet: bytes) -> None:
        """Error frames belong to one client; a shared interface cannot carry them."""

    def close(self) -> None:
        """Leave the interface."""
        self._socket.close()
        self._wake_receive.close()
        self._wake_send.close()
