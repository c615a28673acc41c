"""Write ``s2r_executor/_native.pyi`` from the built module: ``python executor/native/make_stub.py [FILE]``.

Runs nanobind's stub generator, shortens its array annotations and formats the result with ruff.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from nanobind.stubgen import StubGen

from s2r_executor import _native

_DEFAULT = Path(__file__).parents[1] / "s2r_executor" / "_native.pyi"


def make_stub() -> str:
    """The text of the stub for the module as it is built now."""
    generator = StubGen(_native)
    generator.put(_native)
    text = generator.get()
    text = re.sub(r"Annotated\[(NDArray\[numpy\.float64\]), dict\([^)]*\([^)]*\)[^)]*\)\]", r"\1", text)
    text = re.sub(r"^([A-Z_]+): dict = .*$", r"\1: dict[str, int]", text, flags=re.MULTILINE)
    text = re.sub(r"^([A-Z_]+): (int|float) = .*$", r"\1: \2", text, flags=re.MULTILINE)
    text = text.replace("from typing import Annotated\n", "")
    for command in (["check", "--fix", "--quiet", "--exit-zero"], ["format", "--quiet"]):
        arguments = [sys.executable, "-m", "ruff", *command, "--stdin-filename", str(_DEFAULT), "-"]
        text = subprocess.run(arguments, input=text, capture_output=True, text=True, check=True).stdout
    return text


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else _DEFAULT
    target.write_text(make_stub(), encoding="utf-8")
