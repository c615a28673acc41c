"""A SocketCAN interface: is it there, up, fast enough and of the right kind?"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

from s2r_protocol.machine.finding import Finding, Level

_ARPHRD_CAN = "280"
_IFF_UP = 0x1
_FD_MTU = 72
_BITRATE = 1_000_000
_DATA_BITRATE = 5_000_000


def list_interfaces(root: Path = Path("/")) -> list[str]:
    """Names of this machine's CAN interfaces."""
    found = []
    for path in (root / "sys/class/net").glob("*"):
        try:
            kind = (path / "type").read_text().strip()
        except OSError:  # gone meanwhile
            continue
        if kind == _ARPHRD_CAN:
            found.append(path.name)
    return sorted(found)


def check_interface(name: str, packing: str = "fd", root: Path = Path("/")) -> list[Finding]:
    """Look at one interface; with ``ip`` also at its bit rates and error state."""
    topic = f"CAN {name}"
    folder = root / "sys/class/net" / name
    up = _up_command(name, packing)
    if name not in list_interfaces(root):
        others = ", ".join(list_interfaces(root)) or "none"
        text = f"no such CAN interface; this machine has: {others}"
        fix = "plug the adapter in and load its driver (dmesg | grep -i can), or correct --bus"
        return [Finding(topic, Level.PROBLEM, text, fix)]
    if not int((folder / "flags").read_text(), 16) & _IFF_UP:
        return [Finding(topic, Level.PROBLEM, "the interface is down", up)]
    mtu = int((folder / "mtu").read_text())
    if packing == "fd" and mtu < _FD_MTU:
        text = f"mtu {mtu}: no CAN FD, the FD packing needs {_FD_MTU}"
        return [Finding(topic, Level.PROBLEM, text, f"sudo ip link set {name} down; {up}")]
    return _details(topic, name, packing, mtu, _ask_ip(name) if root == Path("/") else {})


def _up_command(name: str, packing: str) -> str:
    fd = f" dbitrate {_DATA_BITRATE} fd on" if packing == "fd" else ""
    return f"sudo ip link set {name} up txqueuelen 128 type can bitrate {_BITRATE}{fd} restart-ms 0"


def _ask_ip(name: str) -> dict[str, Any]:
    """What the driver says: bit rates and state. Empty when ``ip`` is not installed."""
    if shutil.which("ip") is None:
        return {}
    asked = subprocess.run(
        ["ip", "-details", "-json", "link", "show", "dev", name], capture_output=True, text=True, check=False
    )
    if asked.returncode != 0:
        return {}
    return json.loads(asked.stdout)[0].get("linkinfo", {})


def _details(topic: str, name: str, packing: str, mtu: int, link: dict[str, Any]) -> list[Finding]:
    data = link.get("info_data", {})
    wrong = []
    wanted = [("bitrate", data.get("bittiming", {}), _BITRATE)]
    if packing == "fd":
        wanted.append(("data bitrate", data.get("data_bittiming", {}), _DATA_BITRATE))
    for what, timing, rate in wanted:
        if timing and timing.get("bitrate") != rate:
            wrong.append(f"{what} {timing.get('bitrate')}, expected {rate}")
    state = data.get("state", "")
    if state and state != "ERROR-ACTIVE":
        wrong.append(f"controller is {state}: check wiring, termination (60 ohm) and bit rates")
    if data.get("restart_ms"):
        wrong.append("restart-ms is set: a bus that was off must come back by hand")
    if wrong:
        return [
            Finding(
                topic,
                Level.PROBLEM,
                "; ".join(wrong),
                f"sudo ip link set {name} down; {_up_command(name, packing)}",
            )
        ]
    kind = link.get("info_kind", "can")
    return [Finding(topic, Level.OK, f"{kind}, up, mtu {mtu}{f', {state}' if state else ''}")]
