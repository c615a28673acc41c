"""Exit codes of every ``s2r`` command, and the error type that carries one to the shell."""

from __future__ import annotations

import enum


class ExitCode(enum.IntEnum):
    """What a shell script may rely on."""

    OK = 0
    BUG = 1  # an unexpected exception: please report it
    USAGE = 2  # wrong option, unknown name, missing or unreadable file, a place that is taken
    NOT_READY = 3  # the machine lacks something; the message prints the fix
    REFUSED = 4  # a plan, model or recording was refused with a reason
    UNREACHABLE = 5  # no answer from a peer process
    PROTECTION = 6  # the arm was stopped by a protection
    DIFFERENCE = 7  # a comparison ran and found a difference
    INTERRUPTED = 130  # Ctrl-C


class S2RError(Exception):
    """Base of all errors that end a command with a sentence instead of a traceback.

    Packages derive their own base from this; ``exit_code`` is a class attribute there.
    """

    exit_code: ExitCode = ExitCode.BUG


class UsageError(S2RError, ValueError):
    """The command was called with something that cannot be used."""

    exit_code = ExitCode.USAGE


class NotReadyError(S2RError, RuntimeError):
    """The machine lacks something; the message prints the fix."""

    exit_code = ExitCode.NOT_READY


class RefusedError(S2RError, ValueError):
    """A plan, model or recording was looked at and refused."""

    exit_code = ExitCode.REFUSED


class UnreachableError(S2RError, ConnectionError):
    """A peer process did not answer."""

    exit_code = ExitCode.UNREACHABLE


class ProtectionStopError(S2RError, RuntimeError):
    """The executor stopped the arm on its own."""

    exit_code = ExitCode.PROTECTION
