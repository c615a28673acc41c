"""The committed stubs of the native modules say what these have."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("module", ["s2r_executor._native", "s2r_host._native"])
def test_committed_stub_is_that_of_the_built_module(module):
    pytest.importorskip(module, reason="the native parts are not built")
    spec = importlib.util.spec_from_file_location("make_stub", ROOT / "scripts/make_stub.py")
    make_stub = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make_stub)
    committed = make_stub.STUBS[module].read_text(encoding="utf-8")
    assert make_stub.make_stub(module) == committed, "run scripts/make_stub.py"
