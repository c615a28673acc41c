"""Errors of the concealment package; each ends its command with a sentence and a documented exit code."""

from __future__ import annotations

from s2r_protocol.exits import ExitCode, S2RError


class ConcealError(S2RError):
    """Base of everything this package raises on purpose."""

    exit_code = ExitCode.USAGE


class DrawError(ConcealError, ValueError):
    """A draw was asked for that cannot be made."""


class SealError(ConcealError, ValueError):
    """A sealed file, its key or a published hash do not belong together."""

    exit_code = ExitCode.REFUSED


class ToolFailedError(ConcealError, RuntimeError):
    """The tool that was run has given no verdict at all."""

    exit_code = ExitCode.REFUSED


class VerdictsMissingError(ConcealError, RuntimeError):
    """The answers stay shut: the verdicts are not complete or not hashed yet."""

    exit_code = ExitCode.NOT_READY
