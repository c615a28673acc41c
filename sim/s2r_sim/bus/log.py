"""A log of the bus: every frame a client wanted to send and every frame the drives sent, in order."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from s2r_sim.bus.hub import Client

FRAME = np.dtype([("t_ns", "<i8"), ("sender", "<i4"), ("size", "<u4"), ("raw", "u1", 72)])
"""One frame: time, 0 for a drive or the client's number, packet size (16 or 72), the packet itself."""


class BusLog:
    """A tap of :class:`s2r_sim.bus.bus.Bus`."""

    def __init__(self) -> None:
        self._rows: list[tuple[int, int, bytes]] = []

    def __call__(self, t_ns: int, packet: bytes, sender: object) -> None:
        """Keep one frame."""
        self._rows.append((t_ns, sender.number if isinstance(sender, Client) else 0, packet))

    def __len__(self) -> int:
        return len(self._rows)

    def frames(self, first: int = 0) -> np.ndarray:
        """All frames from the ``first`` on as an array of :data:`FRAME`."""
        rows = self._rows[first:]
        out = np.zeros(len(rows), FRAME)
        out["t_ns"] = [t for t, _, _ in rows]
        out["sender"] = [s for _, s, _ in rows]
        out["size"] = [len(p) for _, _, p in rows]
        packed = b"".join(p.ljust(72, b"\0") for _, _, p in rows)
        out["raw"] = np.frombuffer(packed, np.uint8).reshape(-1, 72)
        return out

    def save(self, path: Path) -> None:
        """Write all frames as a numpy file."""
        np.save(path, self.frames())
