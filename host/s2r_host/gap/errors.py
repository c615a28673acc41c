"""What ``s2r gap`` refuses, each with a sentence that names the file, the value and the next step."""

from __future__ import annotations

from s2r_host.errors import HostError
from s2r_protocol.exits import RefusedError, UsageError


class GapUsageError(HostError, UsageError):
    """The command line or the configuration file cannot be used."""


class GapRecordingError(HostError, RefusedError):
    """A recording was read and refused."""


class GapModelError(HostError, RefusedError):
    """A model was read and refused."""
