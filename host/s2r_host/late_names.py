"""Public names of a package that are fetched from its modules when they are first asked for.

Whoever wants an error class of `s2r_host.perception` does not wait for OpenCV and SciPy, which its estimator loads.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module


def late_names(package: str, **modules: tuple[str, ...]) -> Callable[[str], object]:
    """What a package has as its ``__getattr__`` (PEP 562).

    Args:
        package: Its ``__name__``.
        modules: Of each module the names that are the package's, too.
    """
    home = {name: module for module, names in modules.items() for name in names}

    def fetched(name: str) -> object:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{home[name]}"), name)

    return fetched
