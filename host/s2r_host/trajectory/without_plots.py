"""toppra without the plotting library that it imports for drawings nobody asks for: a second of processor time.

Usage: ``from s2r_host.trajectory.without_plots import toppra``.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

_PLOTS = ("matplotlib", "matplotlib.pyplot")


class _Later(ModuleType):
    """Stands for a module, and imports it when something of it is asked for.

    ``importlib.util.LazyLoader`` does not do: it loads at the ``import`` statement of the next module already.
    """

    def __getattr__(self, name: str) -> Any:  # whatever the module has
        if name.startswith("__"):
            raise AttributeError(name)  # what the import system looks for
        return getattr(importlib.import_module(self.__name__), name)


@contextmanager
def _imported_later(names: tuple[str, ...]) -> Iterator[None]:
    """While this lasts, an import of a package and its modules gets what imports them at their first use."""
    if names[0] in sys.modules:
        yield
        return
    standing_in = {name: _Later(name) for name in names}
    for name, module in standing_in.items():
        package, _, last = name.rpartition(".")
        if package:
            setattr(standing_in[package], last, module)
    sys.modules.update(standing_in)
    try:
        yield
    finally:
        for name, module in standing_in.items():
            if sys.modules.get(name) is module:
                del sys.modules[name]


with _imported_later(_PLOTS):
    import toppra

__all__ = ["toppra"]
