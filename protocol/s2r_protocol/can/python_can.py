"""``python-can`` interface "s2r": loggers, sniffers and ``canopen`` attach to the stand-in's bus.

``can.Bus(interface="s2r", channel="unix:/run/s2r.sock")``, or ``python -m can.logger -i s2r -c unix:/run/s2r.sock``.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from typing import Any

import can
from can import CanProtocol

from s2r_protocol.can.frames import CanFrame, connect_unix


class StandInBus(can.BusABC):
    """One node on the stand-in's bus; sees every frame but its own."""

    def __init__(
        self, channel: Any, can_filters: can.typechecking.CanFilters | None = None, **_: Any
    ) -> None:
        """Attach to ``unix:PATH``.

        Raises:
            CanInitializationError: Nobody listens there.
        """
        try:
            self._socket = connect_unix(str(channel))
        except ConnectionError as error:
            raise can.CanInitializationError(str(error)) from error
        self._socket.setblocking(False)
        self._can_protocol = CanProtocol.CAN_FD
        self.channel_info = f"s2r stand-in bus at {channel}"
        self._channel = str(channel)  # every message carries it; log formats want one word
        super().__init__(channel=channel, can_filters=can_filters)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        ready, _, _ = select.select([self._socket], [], [], timeout)
        if not ready:
            return None, False
        packet = self._socket.recv(128)
        if not packet:
            raise can.CanOperationError(f"{self.channel_info} was closed by the stand-in")
        return to_message(CanFrame.unpack(packet), self._channel), False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put a frame on the bus.

        Raises:
            CanOperationError: The stand-in did not take it within ``timeout`` [s] (None: do not wait).
        """
        packet = from_message(msg).pack()
        deadline = time.monotonic() + (timeout or 0.0)
        while True:
            try:
                self._socket.send(packet)
                return
            except BlockingIOError as error:
                left = deadline - time.monotonic()
                if left <= 0:
                    raise can.CanOperationError(f"{self.channel_info}: transmit buffer full") from error
                select.select([], [self._socket], [], left)
            except OSError as error:
                raise can.CanOperationError(f"{self.channel_info}: {error.strerror}") from error

    def fileno(self) -> int:
        """The socket, for ``select``."""
        return self._socket.fileno()

    def shutdown(self) -> None:
        """Leave the bus."""
        super().shutdown()
        if self._socket.fileno() >= 0:
            close_node(self._socket)


def close_node(node: socket.socket) -> None:
    """Close a socket whether or not the peer is still there."""
    with contextlib.suppress(OSError):  # the peer may have gone first; closing is all that is left then
        node.shutdown(socket.SHUT_RDWR)
    node.close()


def to_message(frame: CanFrame, channel: str) -> can.Message:
    """A frame as python-can's message."""
    return can.Message(
        timestamp=time.time(),
        arbitration_id=frame.can_id,
        is_extended_id=frame.extended,
        is_error_frame=frame.is_error,
        is_fd=frame.is_fd,
        bitrate_switch=frame.brs,
        data=frame.data,
        channel=channel,
    )


def from_message(message: can.Message) -> CanFrame:
    """python-can's message as a frame."""
    return CanFrame(
        can_id=message.arbitration_id,
        data=bytes(message.data),
        is_fd=message.is_fd,
        brs=message.bitrate_switch,
        extended=message.is_extended_id,
        is_error=message.is_error_frame,
    )
