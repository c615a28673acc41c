"""Publishing one ROS 2 topic on a Zenoh session."""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING

from s2r_protocol.ros2.keys import Attachment

if TYPE_CHECKING:
    import zenoh


class Publisher:
    """One topic, with what rmw_zenoh wants beside each message."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        import zenoh

        # Dropping beats waiting: a slow listener must not hold up a state message behind the next one.
        self._publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
        self._gid = secrets.token_bytes(16)
        self._count = 0

    def put(self, message: bytes, stamp_ns: int) -> None:
        """Send one message; ``stamp_ns`` is its source time, nanoseconds since the Unix epoch."""
        self._count += 1
        self._publisher.put(message, attachment=Attachment(self._count, stamp_ns, self._gid).pack())
