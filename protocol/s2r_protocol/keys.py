"""The Zenoh key space: where each message of one arm lives.

Commands are queries under ``<cell>/<arm>/``; observations are ROS 2 topics under rmw_zenoh's keys
(:mod:`s2r_protocol.ros2.keys`).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from s2r_protocol.exits import UsageError

_CHUNK = re.compile(r"[A-Za-z0-9_\-.]+")


class KeyNameError(UsageError):
    """A cell or arm name that cannot be a part of a key."""


@dataclass(frozen=True)
class ArmKeys:
    """Keys of one arm in one cell.

    Raises:
        KeyNameError: A name holds characters Zenoh gives a meaning to (``/ * $ ? #``).
    """

    cell: str = "lab"
    arm: str = "xmate3pro"

    def __post_init__(self) -> None:
        for what, name in (("cell", self.cell), ("arm", self.arm)):
            if not _CHUNK.fullmatch(name):
                raise KeyNameError(f"{what} name {name!r} may only hold letters, digits, '_', '-' and '.'")

    @property
    def base(self) -> str:
        """Common prefix, also the namespace of this arm's ROS 2 topics."""
        return f"{self.cell}/{self.arm}"

    @property
    def hello(self) -> str:
        """Query: who are you, which model, which limits."""
        return f"{self.base}/hello"

    @property
    def lease(self) -> str:
        """Query: ask for or return the right to move the arm."""
        return f"{self.base}/lease"

    @property
    def plan(self) -> str:
        """Query: a plan in, a verdict out."""
        return f"{self.base}/plan"

    @property
    def control(self) -> str:
        """Query: arm, stop, pause, ..., a verdict out."""
        return f"{self.base}/ctl"

    @property
    def heartbeat(self) -> str:
        """Put every 10 ms by the lease holder."""
        return f"{self.base}/heartbeat"

    @property
    def recording(self) -> str:
        """Query: the MCAP bytes of one executed plan."""
        return f"{self.base}/recording"

    def capture(self, camera: str = "front") -> str:
        """Query to the camera process: one depth frame."""
        return f"{self.base}/camera/{camera}/capture"
