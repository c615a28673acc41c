"""Errors of model construction."""

from __future__ import annotations

from s2r_protocol.exits import RefusedError


class ModelError(RefusedError):
    """The views do not show enough of the object to build a model of it."""
