"""The local socket that stands for the bus connector: every client is one more node on the wire."""

from __future__ import annotations

import contextlib
import logging
import os
import select
import socket
import stat
from collections.abc import Iterator

from s2r_protocol.can.frames import unix_path
from s2r_sim.errors import StandInError

logger = logging.getLogger(__name__)

_BURST = 64  # frames taken from one client at once: a babbling node must not starve the others
_BACKLOG = 16


class Client:
    """One attached node. ``lost`` counts frames it was too slow to take; it is never waited for."""

    def __init__(self, connection: socket.socket, number: int) -> None:
        self.socket = connection
        self.number = number
        self.lost = 0
        self.is_master = False

    def __repr__(self) -> str:
        return f"bus client {self.number}"


class Hub:
    """Accepts nodes on ``unix:PATH`` and moves packets. Single-threaded: all calls come from one thread."""

    def __init__(self, address: str) -> None:
        """Listen.

        Raises:
            StandInError: Another stand-in listens there, or the path cannot be used.
        """
        self.path = unix_path(address)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._remove_stale()
            self._listener.bind(self.path)
            self._listener.listen(_BACKLOG)
        except OSError as error:
            self._listener.close()
            raise StandInError(f"cannot listen on {self.path}: {error.strerror}") from error
        self._listener.setblocking(False)
        self._wake_receive, self._wake_send = socket.socketpair()
        self._wake_receive.setblocking(False)
        self.clients: list[Client] = []
        self._count = 0

    def _remove_stale(self) -> None:
        if not os.path.exists(self.path):
            return
        # A file refuses connections, too, and is somebody's.
        if not stat.S_ISSOCK(os.stat(self.path).st_mode):
            raise StandInError(
                f"cannot listen on {self.path}: what is there is no socket; choose another --bus"
            )
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
            try:
                probe.connect(self.path)
            except ConnectionRefusedError:
                os.unlink(self.path)
                return
        raise StandInError(
            f"another stand-in already listens on {self.path}; stop it or choose another --bus"
        )

    def wake(self) -> None:
        """End a :meth:`receive` from a signal handler."""
        with contextlib.suppress(OSError):
            self._wake_send.send(b"x")

    def receive(self, timeout_s: float | None) -> Iterator[tuple[Client, bytes | None]]:
        """Wait for packets, then yield them; None marks a client that left."""
        sockets = [self._listener, self._wake_receive, *(c.socket for c in self.clients)]
        ready, _, _ = select.select(sockets, [], [], timeout_s)
        if not ready:
            return
        if self._listener in ready:
            self._accept()
        if self._wake_receive in ready:
            with contextlib.suppress(BlockingIOError):
                self._wake_receive.recv(64)
        for client in list(self.clients):
            if client.socket in ready:
                yield from self._drain(client)

    def _drain(self, client: Client) -> Iterator[tuple[Client, bytes | None]]:
        for _ in range(_BURST):
            try:
                packet = client.socket.recv(128)
            except BlockingIOError:
                return
            except ConnectionError:
                packet = b""
            if not packet:
                self.drop(client)
                yield client, None
                return
            yield client, packet

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        connection.setblocking(False)
        self._count += 1
        self.clients.append(Client(connection, self._count))
        logger.info("%r joined, %d now", self.clients[-1], len(self.clients))

    def drop(self, client: Client) -> None:
        """Detach a node."""
        if client in self.clients:
            self.clients.remove(client)
            client.socket.close()
            logger.info(
                "%r left, %d now, %d frames it was too slow for", client, len(self.clients), client.lost
            )

    def broadcast(self, packet: bytes, sender: object = None) -> None:
        """Deliver a packet to every node but its sender."""
        for client in self.clients:
            if client is not sender:
                self.send(client, packet)

    def send(self, client: Client, packet: bytes) -> None:
        """Deliver a packet to one node; one that does not keep up loses it."""
        try:
            client.socket.send(packet)
        except BlockingIOError:
            client.lost += 1
        except ConnectionError:
            pass  # the next receive sees that it left

    def close(self) -> None:
        """Detach everybody and remove the socket."""
        for client in list(self.clients):
            self.drop(client)
        self._listener.close()
        self._wake_receive.close()
        self._wake_send.close()
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self.path)
