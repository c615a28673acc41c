"""Times and durations of ROS messages in one number."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def nanoseconds(time: Mapping[str, Any]) -> int:
    """A ``builtin_interfaces`` time or duration, ``sec`` and ``nanosec``, as nanoseconds."""
    return int(time["sec"]) * 1_000_000_000 + int(time["nanosec"])
