"""What a running front end keeps in memory: its goal is 150 MB, and a careless import costs ten of them."""

from __future__ import annotations

import json
import subprocess
import sys

ALLOWED = {
    "numpy": "arrays",
    "zenoh": "the link",
    "google": "messages",
    "coal": "collision check",
    "pinocchio": "torque and collision check",
    "ruckig": "bridges of a splice",
    "pydantic": "configuration",
    "pydantic_core": "configuration",
    "annotated_types": "of pydantic",
    "typing_extensions": "of pydantic",
    "typing_inspection": "of pydantic",
    "yaml": "configuration",
    "click": "command line",
}


def test_the_front_end_loads_what_it_needs_and_nothing_else():
    """Neither python-can (commissioning only) nor mcap (the recording process), let alone anything of host or sim."""
    script = (
        "import json, sys; before = set(sys.modules); import s2r_executor.assembly, s2r_executor.cli;"
        "new = {m.partition('.')[0] for m in set(sys.modules) - before} - set(sys.stdlib_module_names);"
        "print(json.dumps(sorted(m for m in new if not m.startswith('_'))))"
    )
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    found = set(json.loads(said)) - {"s2r_executor", "s2r_protocol", "cython_runtime"}
    assert found <= set(ALLOWED), f"imported beyond what is needed: {sorted(found - set(ALLOWED))}"
    assert {"numpy", "pinocchio", "zenoh"} <= found
