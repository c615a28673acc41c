"""The catalogue: one file per effect. Adding an effect means adding one file that defines ``EFFECT``."""

from __future__ import annotations

import functools
import importlib
import pkgutil

from s2r_host.gap.effects.base import Effect


@functools.cache
def catalogue() -> dict[str, Effect]:
    """Every effect of this folder by name, in file order."""
    found: dict[str, Effect] = {}
    for entry in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{entry.name}")
        effect = getattr(module, "EFFECT", None)
        if effect is not None:
            found[effect.name] = effect
    return found
