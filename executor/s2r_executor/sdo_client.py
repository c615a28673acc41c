"""Asking drives for entries of their object dictionaries, over any bus python-can knows."""

from __future__ import annotations

import struct
import time
from types import TracebackType

import can

from s2r_protocol.can import sdo
from s2r_protocol.can.frames import CanFrame
from s2r_protocol.can.python_can import from_message, to_message
from s2r_protocol.exits import S2RError, UnreachableError

_LONGEST_BYTES = 1 << 16  # no entry that is asked for comes near
_ABORTS = {
    sdo.NO_OBJECT: "there is no such object",
    sdo.NO_SUBINDEX: "there is no such subindex",
    sdo.READ_ONLY: "it is read only",
}


class SdoAbortError(S2RError, RuntimeError):
    """The drive answered with an abort; ``code`` is CiA 301's."""

    def __init__(self, node: int, index: int, subindex: int, code: int) -> None:
        why = _ABORTS.get(code, "abort code of CiA 301")
        super().__init__(f"node {node}: object {index:#06x}:{subindex}: {why} ({code:#010x})")
        self.code = code


class SdoTimeoutError(UnreachableError, TimeoutError):
    """The node did not answer."""


class CanLine:
    """One attachment to a bus: frames out, frames in. A context manager."""

    def __init__(self, address: str) -> None:
        """Join ``unix:PATH`` or ``can:IFACE``.

        Raises:
            UnreachableError: It is not there.
        """
        kind, _, channel = address.partition(":")
        try:
            if kind == "can":
                self._bus: can.BusABC = can.Bus(interface="socketcan", channel=channel, fd=True)
            else:
                from s2r_protocol.can.python_can import StandInBus

                self._bus = StandInBus(address)
        except (can.CanError, OSError) as error:
            more = (
                f"; see 's2r doctor --bus {address}'" if kind == "can" else ""
            )  # the stand-in's says it itself
            raise UnreachableError(f"bus {address} cannot be opened: {error}{more}") from error

    def send(self, frame: CanFrame) -> None:
        """Put a frame on the bus."""
        self._bus.send(to_message(frame, ""))

    def receive(self, until_s: float) -> CanFrame | None:
        """The next data frame, or None when the monotonic clock reaches ``until_s``."""
        while (left := until_s - time.monotonic()) > 0:
            message = self._bus.recv(left)
            if message is not None and not message.is_error_frame and not message.is_remote_frame:
                return from_message(message)
        return None

    def listen(self, duration_s: float) -> list[CanFrame]:
        """Everything heard in that time."""
        until = time.monotonic() + duration_s
        frames = []
        while (frame := self.receive(until)) is not None:
            frames.append(frame)
        return frames

    def __enter__(self) -> CanLine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bus.shutdown()


class SdoClient:
    """Reads entries of one node after the other."""

    def __init__(self, line: CanLine, timeout_s: float = 0.5) -> None:
        self._line = line
        self._timeout_s = timeout_s

    def upload(self, node: int, index: int, subindex: int = 0) -> bytes:
        """The entry's bytes.

        Raises:
            SdoAbortError: The drive has no such entry.
            SdoTimeoutError: It did not answer, or not with the whole entry.
        """
        payload = self._ask(node, sdo.pack_head(sdo.UPLOAD, index, subindex), sdo.UPLOAD, index, subindex)
        command, _, _, data = sdo.unpack_head(payload)
        value = sdo.expedited(command, data)
        if value is not None:
            return value
        told = struct.unpack("<I", data)[0] if command & sdo.SIZE_TOLD else None
        longest = _LONGEST_BYTES if told is None else min(told, _LONGEST_BYTES)
        value, toggle, last = b"", 0, False
        while not last:
            if len(value) > longest:
                after = "" if told is None else f" after its {told} bytes"
                raise SdoTimeoutError(f"node {node}: object {index:#06x}:{subindex} does not end{after}")
            request = bytes([sdo.UPLOAD_SEGMENT | toggle]).ljust(8, b"\0")
            payload = self._ask(node, request, toggle, index, subindex)
            part, last = sdo.segment_part(payload)
            value += part
            toggle ^= sdo.TOGGLE
        if told is not None and len(value) < told:
            raise SdoTimeoutError(
                f"node {node}: object {index:#06x}:{subindex} ended after {len(value)} of {told} bytes"
            )
        return value[:told]

    def number(self, node: int, index: int, subindex: int = 0, signed: bool = False) -> int:
        """The entry as an integer of whatever length it has."""
        return int.from_bytes(self.upload(node, index, subindex), "little", signed=signed)

    def present(self, timeout_s: float, last_node: int = sdo.MAX_NODE) -> dict[int, int]:
        """Ask every node for its device type at once; node -> number of answers (two: a node id used twice)."""
        found: dict[int, int] = {}
        for first in range(1, last_node + 1, 16):  # a burst that no transmit queue overflows at
            for node in range(first, min(first + 16, last_node + 1)):
                self._line.send(CanFrame(sdo.REQUEST_ID + node, sdo.pack_head(sdo.UPLOAD, 0x1000, 0)))
            for frame in self._line.listen(timeout_s):
                node = frame.can_id - sdo.RESPONSE_ID
                if 1 <= node <= sdo.MAX_NODE and len(frame.data) == 8 and not frame.is_fd:
                    found[node] = found.get(node, 0) + 1
        return found

    def _ask(self, node: int, request: bytes, answer: int, index: int, subindex: int) -> bytes:
        """Send a request and wait for its own answer: a late one to another entry is none.

        Args:
            node: Whom to ask.
            request: Eight bytes.
            answer: Command of the answer, as :func:`sdo.answers` takes it.
            index: Of the entry.
            subindex: Of the entry.
        """
        self._line.send(CanFrame(sdo.REQUEST_ID + node, request))
        until = time.monotonic() + self._timeout_s
        while (frame := self._line.receive(until)) is not None:
            if frame.can_id != sdo.RESPONSE_ID + node or len(frame.data) != 8:
                continue
            if sdo.answers(frame.data, sdo.ABORT, index, subindex):
                raise SdoAbortError(node, index, subindex, struct.unpack("<I", frame.data[4:])[0])
            if sdo.answers(frame.data, answer, index, subindex):
                return frame.data
        raise SdoTimeoutError(f"node {node} did not answer an SDO within {self._timeout_s:g} s")
