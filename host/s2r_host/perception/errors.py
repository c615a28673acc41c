"""Errors of perception: what cannot be used, and what is not answered on purpose."""

from __future__ import annotations

from s2r_protocol.exits import RefusedError, UsageError


class InputError(UsageError):
    """A file or option cannot be used as a depth view; the text says which and what would be accepted."""


class BadViewError(RefusedError):
    """A view was read but its content is no measurement (empty, not finite, wrong unit, no overlap)."""


class AbstainError(RefusedError):
    """Two usable views that do not determine one joint; the text says why and what to do next."""


class NothingMovedError(AbstainError):
    """Two views between which nothing moved."""
