"""One line of an answer about this machine."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Level(enum.StrEnum):
    """How bad it is."""

    OK = "ok"
    NOTE = "note"  # works, but less well
    PROBLEM = "problem"


@dataclass(frozen=True)
class Finding:
    """What was looked at, what was found, and what to do unless it is in order."""

    topic: str
    level: Level
    text: str
    fix: str = ""
