"""How long a frame occupies the wire, and how full a configuration makes the bus.

Bit counts after ISO 11898-1 with the worst stuffing and the 3-bit interframe space. On real hardware the wire is
the limit, not the processor: seven drives at 1 kHz with one 8-byte frame each way are impossible on classical CAN.
"""

from __future__ import annotations

from dataclasses import dataclass

from s2r_protocol.can import classic, fd
from s2r_protocol.exits import RefusedError

MAX_LOAD = 0.70


class BusOverloadError(RefusedError):
    """A configuration would fill the bus beyond what leaves room for retries and diagnostics."""


@dataclass(frozen=True)
class BitRate:
    """Bit rates [bit/s] of arbitration and data phase; classical frames use the first only."""

    nominal: int = 1_000_000
    data: int = 5_000_000


def classic_frame_ns(length: int, bit_rate: int = 1_000_000, stuffed: bool = True) -> int:
    """Time [ns] of a classical frame with an 11-bit identifier and ``length`` payload bytes."""
    bits = 47 + 8 * length + ((33 + 8 * length) // 4 if stuffed else 0)
    return round(bits * 1e9 / bit_rate)


def fd_frame_ns(length: int, rate: BitRate = BitRate(), stuffed: bool = True) -> int:
    """Time [ns] of a CAN FD frame with bit-rate switch, 11-bit identifier and ``length`` payload bytes.

    Nominal rate: SOF, identifier, RRS, IDE, FDF, res, BRS (17 bits); CRC delimiter, ACK, its delimiter, EOF, gap (13).
    Data rate: ESI, DLC, payload, stuff count, CRC-17 or CRC-21 with its fixed stuff bits.
    """
    dynamic = 5 + 8 * length
    fixed = 4 + 17 + 6 if length <= 16 else 4 + 21 + 7
    nominal_bits = 17 + 13 + (4 if stuffed else 0)
    data_bits = dynamic + fixed + (dynamic // 4 if stuffed else 0)
    return round(nominal_bits * 1e9 / rate.nominal + data_bits * 1e9 / rate.data)


def frame_ns(length: int, is_fd: bool, rate: BitRate = BitRate()) -> int:
    """Worst-case time [ns] of one frame."""
    return fd_frame_ns(length, rate) if is_fd else classic_frame_ns(length, rate.nominal)


def cycle_ns(packing: str, nodes: int, rate: BitRate = BitRate(), stuffed: bool = True) -> int:
    """Wire time [ns] of the cyclic frames of one tick: everything that travels every cycle.

    Raises:
        ValueError: Unknown packing.
    """
    if packing == "fd":
        return fd_frame_ns(fd.SET.size, rate, stuffed) + nodes * fd_frame_ns(fd.STAT.size, rate, stuffed)
    if packing == "classic":
        pdo = classic_frame_ns(8, rate.nominal, stuffed)
        return classic_frame_ns(1, rate.nominal, stuffed) + 2 * nodes * pdo
    raise ValueError(f"unknown packing {packing!r}; known are 'fd' and 'classic'")


def extra_load(packing: str, nodes: int, tick_ns: int, rate: BitRate = BitRate()) -> float:
    """Load of what does not travel every cycle (TPDO2, heartbeats), as a fraction."""
    if packing != "classic":
        return 0.0
    slow = classic_frame_ns(classic.TPDO2.size, rate.nominal) / (classic.TPDO2_EVERY * tick_ns)
    heartbeat = classic_frame_ns(1, rate.nominal) / classic.HEARTBEAT_NS
    return nodes * (slow + heartbeat)


def cyclic_load(packing: str, nodes: int, tick_ns: int, rate: BitRate = BitRate()) -> float:
    """Worst-case load of the cyclic frames, as a fraction of the bus."""
    return cycle_ns(packing, nodes, rate) / tick_ns


def check_load(packing: str, nodes: int, tick_ns: int, rate: BitRate = BitRate()) -> float:
    """Load of a whole configuration.

    Raises:
        BusOverloadError: It exceeds :data:`MAX_LOAD`.
    """
    load = cyclic_load(packing, nodes, tick_ns, rate) + extra_load(packing, nodes, tick_ns, rate)
    if load > MAX_LOAD:
        raise BusOverloadError(
            f"{packing} packing, {nodes} drives at {1e9 / tick_ns:.0f} Hz: worst-case bus load {100 * load:.1f} % "
            f"exceeds {100 * MAX_LOAD:.0f} %; lower the rate or split the drives over two buses"
        )
    return load
