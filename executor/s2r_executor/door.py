"""The checks between an envelope and its body: right process, right arm, right epoch, not seen before."""

from __future__ import annotations

import threading
import zlib
from collections import OrderedDict
from dataclasses import dataclass

from s2r_executor.plan import CommandRefusedError
from s2r_protocol.codec import Address
from s2r_protocol.faults import Refusal

_REMEMBERED_SENDERS = 256
_REMEMBERED_ANSWERS = 64


@dataclass(frozen=True)
class Identity:
    """What a command must be addressed to."""

    boot_id: int
    model_hash: bytes
    limit_hash: bytes


def check_addressee(address: Address, identity: Identity) -> None:
    """This executor process, with this arm model and these limits.

    Raises:
        CommandRefusedError: STALE for another process, MODEL for other hashes.
    """
    if address.boot_id != identity.boot_id:
        raise CommandRefusedError(
            Refusal.STALE,
            f"message is for executor process {address.boot_id:016x}, this is {identity.boot_id:016x}; say hello again",
            quantity="boot_id",
        )
    for what, theirs, ours in (
        ("model", address.model_hash, identity.model_hash),
        ("limits", address.limit_hash, identity.limit_hash),
    ):
        if theirs != ours:
            named = f"{what} hash {theirs.hex()[:12]}" if theirs else f"no {what} hash"
            raise CommandRefusedError(
                Refusal.MODEL,
                f"'{address.sender}' sent {named}, this arm's is {ours.hex()[:12]}; use the same arm "
                "description and release on both sides",
                quantity=f"{what}_hash",
            )


def check_epoch(address: Address, epoch: int) -> None:
    """The sender knows of the last stop.

    Raises:
        CommandRefusedError: STALE.
    """
    if address.epoch != epoch:
        raise CommandRefusedError(
            Refusal.STALE,
            f"message carries epoch {address.epoch}, the executor is at {epoch}: the arm stopped or was armed since; "
            "look at its state and ask again",
            quantity="epoch",
            value=address.epoch,
            limit=epoch,
        )


class SequenceBook:
    """Strictly rising sequence numbers per sender; a repeat of the same bytes gets the same answer again.

    Thread-safe.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last: OrderedDict[str, int] = OrderedDict()
        self._answers: OrderedDict[tuple[str, int], tuple[int, bytes]] = OrderedDict()

    def repeated(self, address: Address, wire: bytes) -> bytes | None:
        """The earlier answer if exactly these bytes came before, else None."""
        with self._lock:
            known = self._answers.get((address.sender, address.seq))
        return known[1] if known is not None and known[0] == zlib.crc32(wire) else None

    def admit(self, address: Address) -> None:
        """Accept a new number.

        Raises:
            CommandRefusedError: STALE; it is not above the sender's last one.
        """
        with self._lock:
            last = self._last.get(address.sender, 0)
            if address.seq > last:
                self._last[address.sender] = address.seq
                self._last.move_to_end(address.sender)
                if len(self._last) > _REMEMBERED_SENDERS:
                    self._last.popitem(last=False)
        if address.seq <= last:
            raise CommandRefusedError(
                Refusal.STALE,
                f"message {address.seq} of '{address.sender}' comes after its message {last}; go on from {last + 1}, "
                "or take a sender name of its own for every process",
                quantity="seq",
                value=address.seq,
                limit=last,
            )

    def remember(self, address: Address, wire: bytes, answer: bytes) -> None:
        """Keep an answer for repeats."""
        with self._lock:
            self._answers[(address.sender, address.seq)] = (zlib.crc32(wire), answer)
            if len(self._answers) > _REMEMBERED_ANSWERS:
                self._answers.popitem(last=False)
