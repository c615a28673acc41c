"""The executor on a kernel CAN interface, inside user-mode-linux; see scripts/prove-socketcan."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TOOLS = ("linux.uml", "candump", "bash")


@pytest.mark.timeout(
    1800
)  # 80 s alone: the guest has one slow processor, and beside other tests it waits for its turn
def test_both_packings_hold_every_claim_on_a_kernel_can_bus(tmp_path):
    missing = [tool for tool in TOOLS if shutil.which(tool, path="/usr/bin:/bin:/usr/sbin:/sbin") is None]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)} (Debian packages user-mode-linux and can-utils)")
    out = tmp_path / "socketcan"
    done = subprocess.run(
        [str(ROOT / "scripts" / "prove-socketcan"), str(out)],
        cwd=ROOT, capture_output=True, text=True, timeout=1700, check=False,
    )  # fmt: skip
    console = out / "console.log"
    seen = console.read_text(errors="replace") if console.exists() else done.stderr
    if "the guest runs" not in seen:
        pytest.skip(f"user-mode-linux does not boot here: {(seen.strip().splitlines() or ['no output'])[-1]}")
    assert done.returncode == 0, done.stdout + done.stderr
    claims = json.loads((out / "socketcan.json").read_text())["claims"]
    assert {row["packing"] for row in claims} >= {"fd", "classic"}
    assert all(row["holds"] for row in claims)
