"""Which frames there are in each packing: what the identifiers on an arm's bus stand for."""

from __future__ import annotations

from dataclasses import dataclass

from s2r_protocol.can import classic, fd, sdo

LARGEST = 0x7FF  # 11 bits; neither packing has extended frames


@dataclass(frozen=True)
class Frame:
    """One kind of frame.

    Attributes:
        name: E.g. "SET".
        base: Its identifier; of node n it is ``base`` + n where there is one ``per_drive``, nodes counting from 1.
        per_drive: Whether every drive has its own.
        sender: "executor" or "drive".
    """

    name: str
    base: int
    per_drive: bool
    sender: str

    def of(self, drives: int) -> range:
        """The identifiers of this kind on a bus with so many drives."""
        first = self.base + self.per_drive
        return range(first, first + (drives if self.per_drive else 1))


_SDO = (
    Frame("SDO response", sdo.RESPONSE_ID, True, "drive"),
    Frame("SDO request", sdo.REQUEST_ID, True, "executor"),
)
FRAMES = {
    "fd": (Frame("SET", fd.SET_ID, False, "executor"), Frame("STAT", fd.STAT_ID, True, "drive"), *_SDO),
    "classic": (
        Frame("NMT", classic.NMT_ID, False, "executor"),
        Frame("SYNC", classic.SYNC_ID, False, "executor"),
        Frame("EMCY", classic.EMCY_ID, True, "drive"),
        Frame("TPDO1", classic.TPDO1_ID, True, "drive"),
        Frame("RPDO1", classic.RPDO1_ID, True, "executor"),
        Frame("TPDO2", classic.TPDO2_ID, True, "drive"),
        Frame("heartbeat", classic.HEARTBEAT_ID, True, "drive"),
        *_SDO,
    ),
}
"""By packing."""


def is_used(can_id: int, packing: str, drives: int) -> bool:
    """Whether executor or drives ever send a frame under this identifier."""
    return any(can_id in frame.of(drives) for frame in FRAMES[packing])
