"""The environment of the tool that is examined: what draws the cases and knows the answers cannot be imported in it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Python runs a module of this name before any program; editable installs have put their finders in by then.
HOOK = "sitecustomize.py"
HOOK_TEXT = '''"""Keeps the concealment away from the tool that is examined."""

import sys


class KeptAway:
    """First of the finders: refuses the package that hides the answers."""

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "s2r_conceal":
            raise ModuleNotFoundError(f"{name} is kept away from the tool that is examined", name=name)
        return None


sys.meta_path.insert(0, KeptAway())
'''


@contextmanager
def without_concealment() -> Iterator[dict[str, str]]:
    """Environment variables for a tool and the processes that it starts; only while this lasts.

    They concern tools in Python: whatever else a tool is, it shares no code with this package.
    """
    with tempfile.TemporaryDirectory(prefix="s2r-kept-away-") as folder:
        (Path(folder) / HOOK).write_text(HOOK_TEXT, encoding="utf-8")
        before = os.environ.get("PYTHONPATH")
        yield {**os.environ, "PYTHONPATH": os.pathsep.join([folder, *([before] if before else [])])}
