"""Write the stubs of the native modules as they are built now: ``python scripts/make_stub.py``.

Runs nanobind's stub generator, shortens its array annotations and formats the result with ruff.
"""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

from nanobind.stubgen import StubGen

ROOT = Path(__file__).parents[1]
STUBS = {
    "s2r_executor._native": ROOT / "executor/s2r_executor/_native.pyi",
    "s2r_host._native": ROOT / "host/s2r_host/_native.pyi",
}


def make_stub(module: str) -> str:
    """The text of a module's stub, by its name."""
    built = importlib.import_module(module)
    generator = StubGen(built)
    generator.put(built)
    text = generator.get()
    text = re.sub(r"Annotated\[(NDArray\[numpy\.float64\]), dict\([^)]*\([^)]*\)[^)]*\)\]", r"\1", text)
    text = re.sub(r"^([A-Z_]+): dict = .*$", r"\1: dict[str, int]", text, flags=re.MULTILINE)
    text = re.sub(r"^([A-Z_]+): (int|float) = .*$", r"\1: \2", text, flags=re.MULTILINE)
    text = text.replace("from typing import Annotated\n", "")
    for command in (["check", "--fix", "--quiet", "--exit-zero"], ["format", "--quiet"]):
        arguments = [sys.executable, "-m", "ruff", *command, "--stdin-filename", str(STUBS[module]), "-"]
        text = subprocess.run(arguments, input=text, capture_output=True, text=True, check=True).stdout
    return text


if __name__ == "__main__":
    for name, path in STUBS.items():
        path.write_text(make_stub(name), encoding="utf-8")
