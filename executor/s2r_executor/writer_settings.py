"""How the front end starts the process that writes recordings. Apart from it, so that the front end loads no writer."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class WriterSettings:
    """Everything the writer has to know; passed as JSON on its command line."""

    directory: str
    arm: str
    namespace: str
    offset_ns: int
    tick_ns: int
    stepped: bool
    chunk_bytes: int
    flush_period_s: float
    publish_period_s: float
    facts: dict[str, str]


def command_line(settings: WriterSettings, descriptor: int) -> list[str]:
    """How the front end starts the writer with one end of a socket pair inherited as ``descriptor``."""
    return [
        sys.executable,
        "-m",
        "s2r_executor.recorder_process",
        str(descriptor),
        json.dumps(asdict(settings)),
    ]
