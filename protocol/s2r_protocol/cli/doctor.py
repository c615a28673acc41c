"""``s2r doctor``: is this machine ready, and is this arm description complete?"""

from __future__ import annotations

import ctypes.util
import importlib.util
import json
import os
import resource
import shutil
import socket
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from s2r_protocol.arms import ArmDescription, load_arm
from s2r_protocol.exits import ExitCode

_MIN_PYTHON = (3, 11)
_MIN_FREE_GIB = 1.0
_RT_PRIORITY = 80
_PORTS = {7447: "executor", 7448: "camera"}
_MODULES = {
    "base": ("zenoh", "google.protobuf", "pinocchio", "coal", "can", "mcap", "ruckig", "yaml", "pydantic"),
    "sim": ("mujoco", "cv2"),
    "host": ("mujoco", "open3d", "coacd", "pink", "toppra", "scipy", "matplotlib", "trimesh"),
}


@dataclass(frozen=True)
class Finding:
    """One line of the doctor's answer. ``level`` is ok, note (works, but less well) or problem."""

    topic: str
    level: str
    text: str
    fix: str = ""


def check_machine() -> list[Finding]:
    """Look at this machine; nothing is changed."""
    checks: tuple[Callable[[], list[Finding]], ...] = (
        _python,
        _modules,
        _native_core,
        _system_libraries,
        _realtime,
        _ports,
        _disk,
    )
    return [finding for check in checks for finding in check()]


def _python() -> list[Finding]:
    version = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info < _MIN_PYTHON:
        return [Finding("python", "problem", f"Python {version}", "install Python 3.11 or newer")]
    return [Finding("python", "ok", f"Python {version}")]


def _modules() -> list[Finding]:
    findings = []
    for part, modules in _MODULES.items():
        missing = [m for m in modules if not _is_installed(m)]
        if not missing:
            findings.append(Finding(f"packages: {part}", "ok", f"{len(modules)} found"))
            continue
        # The base must be there; the other parts are a choice.
        level = "problem" if part == "base" else "note"
        extra = "" if part == "base" else f"[{part}]"
        findings.append(
            Finding(
                f"packages: {part}",
                level,
                f"missing: {', '.join(missing)}",
                f"pip install 'sim2real2{extra}'",
            )
        )
    return findings


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # a parent package is missing
        return False


def _native_core() -> list[Finding]:
    spec = importlib.util.find_spec("s2r_executor._native")
    if spec is None:
        return [Finding("native core", "problem", "s2r_executor._native is not built", "make build")]
    return [Finding("native core", "ok", "built")]


def _system_libraries() -> list[Finding]:
    wanted = {"gomp": "libgomp1"}
    if _is_installed("open3d"):
        wanted |= {"usb-1.0": "libusb-1.0-0", "GL": "libgl1", "EGL": "libegl1", "X11": "libx11-6"}
    missing = [package for library, package in wanted.items() if ctypes.util.find_library(library) is None]
    if missing:
        text = f"missing: {', '.join(missing)}"
        return [Finding("system libraries", "problem", text, f"sudo apt-get install -y {' '.join(missing)}")]
    return [Finding("system libraries", "ok", f"{len(wanted)} found")]


def _realtime() -> list[Finding]:
    allowed = os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_RTPRIO)[1] >= _RT_PRIORITY
    if allowed:
        return [Finding("real-time rights", "ok", f"SCHED_FIFO {_RT_PRIORITY} is permitted")]
    return [
        Finding(
            "real-time rights",
            "note",
            "SCHED_FIFO is not permitted: good for the stand-in, refused on a hardware bus",
            f"add '@realtime - rtprio {_RT_PRIORITY}' and '@realtime - memlock unlimited' "
            "to /etc/security/limits.d/s2r.conf and join group realtime",
        )
    ]


def _ports() -> list[Finding]:
    findings = []
    for port, owner in _PORTS.items():
        with socket.socket() as probe:
            busy = probe.connect_ex(("127.0.0.1", port)) == 0
        if busy:
            text = f"127.0.0.1:{port} is taken, perhaps by a running {owner}"
            findings.append(Finding(f"port {port}", "note", text, "choose another with --listen"))
        else:
            findings.append(Finding(f"port {port}", "ok", f"free for the {owner}"))
    return findings


def _disk() -> list[Finding]:
    free_gib = shutil.disk_usage(Path.cwd()).free / 2**30
    if free_gib < _MIN_FREE_GIB:
        return [
            Finding("disk", "problem", f"{free_gib:.1f} GiB free here", "free at least 1 GiB for recordings")
        ]
    return [Finding("disk", "ok", f"{free_gib:.0f} GiB free here")]


def check_arm(arm: ArmDescription) -> list[Finding]:
    """Look closer at an arm whose description is complete."""
    findings = [
        Finding(
            "description", "ok", f"{arm.source.vendor}: {arm.dof} joints, {len(arm.source.shapes)} shapes"
        ),
        Finding("model hash", "ok", arm.model_hash.hex()),
        Finding("limit hash", "ok", arm.limit_hash.hex()),
    ]
    bare = [link.name for link in arm.source.links if not arm.source.shapes_of(link.name)]
    if bare:
        text = f"no collision shape on: {', '.join(bare)}"
        findings.append(
            Finding("shapes", "problem", text, "add at least one capsule, cylinder or box per link")
        )
    for link in sorted({arm.source.tool.parent} - {s.link for s in arm.source.shapes}):
        findings.append(
            Finding("tool", "problem", f"tool link '{link}' has no shape", "describe the fingertip")
        )
    if not any(s.name.startswith("finger_") for s in arm.source.shapes):
        text = "no shape is named finger_*: nothing may touch the object"
        findings.append(Finding("fingertip", "problem", text, "name the fingertip's shapes finger_left, …"))
    return findings


def _print_table(findings: list[Finding]) -> None:
    from rich.console import Console
    from rich.table import Table

    colours = {"ok": "green", "note": "yellow", "problem": "red"}
    table = Table(box=None, pad_edge=False)
    for column in ("", "topic", "finding", "what to do"):
        table.add_column(column, overflow="fold")
    for f in findings:
        table.add_row(f"[{colours[f.level]}]{f.level}[/]", f.topic, f.text, f.fix)
    Console().print(table)


@click.command()
@click.option("--arm", metavar="NAME|DIR", help="Check an arm description instead of this machine.")
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def doctor(arm: str | None, as_json: bool) -> int:
    """Check this machine, or an arm description of yours; every problem comes with its fix."""
    findings = check_machine() if arm is None else check_arm(load_arm(arm))
    if as_json:
        click.echo(json.dumps([asdict(f) for f in findings], indent=2))
    else:
        _print_table(findings)
    broken = any(f.level == "problem" for f in findings)
    if not broken:
        return int(ExitCode.OK)
    return int(ExitCode.NOT_READY if arm is None else ExitCode.USAGE)
