"""The wire: who transmits when, how long it takes, what gets lost.

Every frame occupies the bus for its worst-case bit time; when several wait, the lowest identifier wins. Frames that do
not fit before the end of the window wait for the next one, as on a real bus that is too full; a node whose transmit
queue is full gets no further frame into it.
"""

from __future__ import annotations

import re
from bisect import insort
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

from s2r_protocol.can.frames import CAN_EFF_FLAG, CAN_EFF_MASK, FD_BYTES
from s2r_protocol.can.identifiers import LARGEST
from s2r_protocol.can.timing import BitRate, frame_ns
from s2r_protocol.exits import UsageError

ACTIONS = ("drop", "corrupt", "delay", "enobufs")
# That may wait of one client, or of one frame of a drive: a node that babbles fills no memory.
QUEUE_FRAMES = 64


@dataclass(frozen=True)
class Injection:
    """A disturbance of the bus, timed by tick.

    Attributes:
        action: "drop" (transmitted, received by nobody), "corrupt" (one payload bit flips undetected by CAN), "delay"
            (one tick late), "enobufs" (the sender's queue is full: an error frame instead of a transmission).
        can_id: Frames it hits; None: all.
        first_tick, last_tick: Inclusive; ticks count from 0 at the stand-in's first period.
    """

    action: str
    can_id: int | None
    first_tick: int
    last_tick: int

    @classmethod
    def parse(cls, text: str) -> Injection:
        """Read ``action:identifier@first-last``, such as ``drop:0x181@100-103`` or ``corrupt:*@50``.

        Raises:
            UsageError: The text does not follow this form, or says what no frame can ever meet.
        """
        match = re.fullmatch(r"(\w+):(\*|0[xX][0-9a-fA-F]+|\d+)@(\d+)(?:-(\d+))?", text)
        if match is None or match[1] not in ACTIONS:
            raise UsageError(
                f"injection {text!r} is not of the form ACTION:ID@FIRST[-LAST] with ACTION one of {', '.join(ACTIONS)}"
            )
        can_id = None if match[2] == "*" else int(match[2], 0)
        if can_id is not None and can_id > LARGEST:
            raise UsageError(
                f"injection {text!r}: no frame has the identifier {can_id:#x}; they have 11 bits, 0x000 to "
                f"{LARGEST:#x}, and are listed in docs/protocol.md"
            )
        first = int(match[3])
        last = int(match[4]) if match[4] else first
        if last < first:
            raise UsageError(
                f"injection {text!r}: the last tick, {last}, is before the first, {first}; swap them"
            )
        return cls(match[1], can_id, first, last)

    def __str__(self) -> str:
        """As it is read."""
        who = "*" if self.can_id is None else f"{self.can_id:#05x}"
        last = "" if self.last_tick == self.first_tick else f"-{self.last_tick}"
        return f"{self.action}:{who}@{self.first_tick}{last}"


class Waiting(NamedTuple):
    """A frame that wants the bus: raw packet, identifier for arbitration, who sent it (None: a drive)."""

    ready_ns: int
    can_id: int
    packet: bytes
    sender: object
    lost: bool = False


_IDENTIFIER = attrgetter("can_id")


def _queue_of(frame: Waiting) -> object:
    return frame.can_id if frame.sender is None else frame.sender


class Wire:
    """Arbitration and bit time of one bus segment. Times are simulated nanoseconds."""

    def __init__(self, tick_ns: int, rate: BitRate, injections: Sequence[Injection] = ()) -> None:
        self.tick_ns = tick_ns
        self._rate = rate
        self._injections = list(injections)
        self.disturbed: Counter[Injection] = Counter()  # frames that each rule has hit
        self._waiting: list[Waiting] = []  # by identifier, those of one identifier as they came
        self._queued: Counter[object] = Counter()  # how many of them are of whom
        self._duration_ns: dict[tuple[bool, int], int] = {}
        self._busy_ns = 0
        self.free_ns = 0
        self.loads: deque[float] = deque(maxlen=100)  # of the last ticks
        self.refused: list[Waiting] = []  # transmit queue full; the hub tells the sender

    @property
    def load(self) -> float:
        """Share of the last hundred ticks during which the bus was busy."""
        return sum(self.loads) / len(self.loads) if self.loads else 0.0

    @property
    def waits(self) -> bool:
        """Whether a frame waits for the bus."""
        return bool(self._waiting)

    def offer(self, packet: bytes, sender: object, now_ns: int, tick: int) -> None:
        """A node wants to transmit a packed frame."""
        can_id = int.from_bytes(packet[:4], "little") & (CAN_EFF_FLAG | CAN_EFF_MASK)
        frame = Waiting(now_ns, can_id, packet, sender)
        if self._injections:
            frame = self._disturb(frame, tick)
        if frame is None:
            return
        if self._queued[_queue_of(frame)] >= QUEUE_FRAMES:
            self.refused.append(frame)
            return
        self._queued[_queue_of(frame)] += 1
        insort(self._waiting, frame, key=_IDENTIFIER)

    def pass_all(self, packets: Sequence[bytes], ready_ns: int, end_ns: int) -> list[int] | None:
        """Carry frames that are ready at once, given by rising identifier, when nothing else wants or disturbs the bus.

        Returns:
            When each transmission ends; None, and nothing has happened, when they have to be offered one by one.
        """
        if self._waiting or self._injections:
            return None
        start = free_ns = max(self.free_ns, ready_ns)
        ends = []
        for packet in packets:
            free_ns += self._duration(packet)
            ends.append(free_ns)
        if free_ns > end_ns:
            return None
        self.free_ns = free_ns
        self._busy_ns += free_ns - start
        return ends

    def next(self, end_ns: int) -> Waiting | None:
        """The next frame whose transmission ends by ``end_ns``, lost ones passed over."""
        while self._waiting:
            index, start = self._arbitrate()
            frame = self._waiting[index]
            duration = self._duration(frame.packet)
            if start + duration > end_ns:
                return None
            del self._waiting[index]
            self._leave_queue(frame)
            self.free_ns = start + duration
            self._busy_ns += duration
            if not frame.lost:
                return frame
        return None

    def _leave_queue(self, frame: Waiting) -> None:
        queue = _queue_of(frame)
        self._queued[queue] -= 1
        if not self._queued[queue]:
            del self._queued[queue]  # clients come and go

    def _arbitrate(self) -> tuple[int, int]:
        """Which frame transmits next, and when: the lowest identifier of those that are ready once the bus is free."""
        for index, frame in enumerate(self._waiting):
            if frame.ready_ns <= self.free_ns:
                return index, self.free_ns
        start = min(frame.ready_ns for frame in self._waiting)
        return next(i for i, frame in enumerate(self._waiting) if frame.ready_ns <= start), start

    def close_tick(self, end_ns: int) -> None:
        """The window is over: account for its load."""
        self.free_ns = max(self.free_ns, end_ns)
        self.loads.append(self._busy_ns / self.tick_ns)
        self._busy_ns = 0

    def _duration(self, packet: bytes) -> int:
        key = (len(packet) == FD_BYTES, packet[4])
        if key not in self._duration_ns:
            self._duration_ns[key] = frame_ns(key[1], key[0], self._rate)
        return self._duration_ns[key]

    def _disturb(self, frame: Waiting, tick: int) -> Waiting | None:
        for rule in self._injections:
            if not rule.first_tick <= tick <= rule.last_tick or rule.can_id not in (None, frame.can_id):
                continue
            self.disturbed[rule] += 1
            if rule.action == "drop":
                return frame._replace(lost=True)
            if rule.action == "corrupt":
                position = 8 + tick % max(frame.packet[4], 1)
                damaged = bytearray(frame.packet)
                damaged[position] ^= 1 << (tick % 8)
                return frame._replace(packet=bytes(damaged))
            if rule.action == "delay":
                return frame._replace(ready_ns=frame.ready_ns + self.tick_ns)
            self.refused.append(frame)
            return None
        return frame
