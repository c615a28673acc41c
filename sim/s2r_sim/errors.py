"""Errors of the stand-in that end a command with a sentence."""

from __future__ import annotations

from s2r_protocol.exits import NotReadyError, RefusedError, UsageError


class WorldFileError(UsageError):
    """A world file cannot be read, or says something impossible."""


class ShapelessError(RefusedError):
    """An object's part has no shape: nothing of it could be seen or touched."""


class TruthFileError(UsageError):
    """A truth log cannot be read."""


class RunFileError(UsageError):
    """A run's record does not fit the trial that it is to be of."""


class StandInError(NotReadyError):
    """The stand-in cannot start or go on on this machine."""


class UnstableError(StandInError):
    """A world cannot be simulated any further."""


class ResultsTakenError(NotReadyError):
    """Another process is at work on the same results."""


class WorkerLostError(NotReadyError):
    """Worker processes of a batch of jobs die again and again."""
