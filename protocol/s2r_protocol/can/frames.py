"""The Linux kernel's own CAN frame structs, as bytes and as a dataclass.

``struct can_frame`` (16 bytes) and ``struct canfd_frame`` (72 bytes) of ``linux/can.h``: the same bytes that a
SocketCAN raw socket reads and writes travel over the stand-in's local socket, one frame per packet.
"""

from __future__ import annotations

import socket
import struct
from dataclasses import dataclass

from s2r_protocol.exits import RefusedError, UnreachableError, UsageError

CAN_EFF_FLAG = 0x8000_0000  # 29-bit identifier
CAN_RTR_FLAG = 0x4000_0000  # remote request
CAN_ERR_FLAG = 0x2000_0000  # error message from the controller, never on the wire
CAN_SFF_MASK = 0x0000_07FF
CAN_EFF_MASK = 0x1FFF_FFFF
CANFD_BRS = 0x01  # data phase at the higher bit rate
CANFD_FDF = 0x04  # marks CAN FD; set by newer kernels

# linux/can/error.h: error class in the identifier, detail in data[1] (controller).
CAN_ERR_CRTL = 0x0000_0004
CAN_ERR_CRTL_TX_OVERFLOW = 0x02
CAN_ERR_BUSOFF = 0x0000_0040

CLASSIC = struct.Struct("<IBBBB8s")
FD = struct.Struct("<IBBBB64s")
CLASSIC_BYTES = CLASSIC.size  # 16
FD_BYTES = FD.size  # 72
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


class FrameRefusedError(RefusedError):
    """Bytes that are not a frame, or a frame whose length, counter or checksum is wrong."""


@dataclass(frozen=True)
class CanFrame:
    """One CAN or CAN FD frame.

    Attributes:
        can_id: Identifier without flag bits.
        data: Payload; at most 8 bytes, or one of :data:`FD_LENGTHS` for CAN FD.
        is_fd, brs: CAN FD frame, with bit-rate switch.
        extended: 29-bit identifier.
        is_error: Error message of the controller (``CAN_ERR_FLAG``); ``can_id`` then holds the error class.
    """

    can_id: int
    data: bytes = b""
    is_fd: bool = False
    brs: bool = False
    extended: bool = False
    is_error: bool = False

    def pack(self) -> bytes:
        """The kernel struct: 16 bytes, or 72 for CAN FD.

        Raises:
            FrameRefusedError: Identifier or length is outside what CAN allows.
        """
        mask = CAN_EFF_MASK if self.extended or self.is_error else CAN_SFF_MASK
        if self.can_id & ~mask:
            raise FrameRefusedError(f"CAN identifier {self.can_id:#x} exceeds {mask:#x}")
        flags = (CAN_EFF_FLAG if self.extended else 0) | (CAN_ERR_FLAG if self.is_error else 0)
        if self.is_fd:
            if len(self.data) not in FD_LENGTHS:
                raise FrameRefusedError(
                    f"CAN FD payload of {len(self.data)} bytes is none of the lengths CAN FD knows: {FD_LENGTHS}"
                )
            kind = CANFD_FDF | (CANFD_BRS if self.brs else 0)
            return FD.pack(self.can_id | flags, len(self.data), kind, 0, 0, self.data)
        if len(self.data) > 8:
            raise FrameRefusedError(f"classical CAN payload of {len(self.data)} bytes exceeds 8")
        return CLASSIC.pack(self.can_id | flags, len(self.data), 0, 0, 0, self.data)

    @classmethod
    def unpack(cls, packet: bytes) -> CanFrame:
        """Read one packet as it came from a raw CAN socket.

        Raises:
            FrameRefusedError: The packet is neither a ``can_frame`` nor a ``canfd_frame``, or its length field lies.
        """
        if len(packet) == FD_BYTES:
            raw_id, length, kind, _, _, data = FD.unpack(packet)
            is_fd, longest = True, 64
        elif len(packet) == CLASSIC_BYTES:
            raw_id, length, kind, _, _, data = CLASSIC.unpack(packet)
            is_fd, longest = False, 8
        else:
            raise FrameRefusedError(
                f"packet of {len(packet)} bytes is neither a can_frame ({CLASSIC_BYTES}) "
                f"nor a canfd_frame ({FD_BYTES})"
            )
        if length > longest:
            raise FrameRefusedError(
                f"frame {raw_id & CAN_EFF_MASK:#x} says {length} bytes, at most {longest}"
            )
        extended, is_error = bool(raw_id & CAN_EFF_FLAG), bool(raw_id & CAN_ERR_FLAG)
        return cls(
            can_id=raw_id & (CAN_EFF_MASK if extended or is_error else CAN_SFF_MASK),
            data=data[:length],
            is_fd=is_fd,
            brs=is_fd and bool(kind & CANFD_BRS),
            extended=extended,
            is_error=is_error,
        )


def unix_path(address: str) -> str:
    """The socket path in ``unix:PATH``.

    Raises:
        UsageError: The address names another kind of bus.
    """
    kind, _, path = address.partition(":")
    if kind != "unix" or not path:
        raise UsageError(f"bus address {address!r} is not of the form unix:PATH")
    return path


def connect_unix(address: str) -> socket.socket:
    """Join a stand-in bus as one more node; one packet is one frame.

    Raises:
        UnreachableError: Nobody listens there.
    """
    path = unix_path(address)
    node = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        node.connect(path)
    except OSError as error:
        node.close()
        raise UnreachableError(
            f"no stand-in bus at {path}: {error.strerror}; is 's2r sim-arm' running?"
        ) from error
    return node
