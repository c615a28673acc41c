"""What can go wrong on the host, each with the exit code a shell sees."""

from __future__ import annotations

from s2r_protocol.exits import (
    ExitCode,
    NotReadyError,
    ProtectionStopError,
    RefusedError,
    S2RError,
    UnreachableError,
)
from s2r_protocol.faults import Cause, Refusal


class HostError(S2RError):
    """Base of the host's own errors."""


class PeerUnreachableError(HostError, UnreachableError):
    """The executor or the camera did not answer."""


class DamagedAnswerError(PeerUnreachableError):
    """A peer's answer was looked at and cannot be used.

    Whoever can go on without an answer does as after silence; whoever cannot is told that it was refused.
    """

    exit_code = ExitCode.REFUSED


class ArmMismatchError(HostError, RefusedError):
    """Host and executor were started with different arm models or limits."""


class CommandRefusedError(HostError, RefusedError):
    """The executor looked at a command and refused it; ``code`` says why in one word."""

    def __init__(self, text: str, code: Refusal = Refusal.NONE) -> None:
        super().__init__(text)
        self.code = code


class ArmStoppedError(HostError, ProtectionStopError):
    """The executor ended a motion before its plan did; ``epoch`` is the one that this stop began, where it is known."""

    def __init__(self, text: str, cause: Cause = Cause.NONE, epoch: int | None = None) -> None:
        super().__init__(text)
        self.cause, self.epoch = cause, epoch


class EmptyCloudError(HostError, RefusedError):
    """A depth frame holds too few points where the object should be."""


class SceneError(HostError, RefusedError):
    """The observed scene does not show what the task needs, e.g. a front facing the robot."""


class NoMotionError(HostError, RefusedError):
    """No joint motion reaches the goal within limits and free of collisions."""


class TargetError(HostError, RefusedError):
    """The target cannot be reached with this object, arm and placement."""


class RecordingError(HostError, RefusedError):
    """A recording lacks what was asked of it."""


class MissingPartError(HostError, NotReadyError):
    """An optional package of the host is not installed."""
