"""Python, installed packages, the native parts and the system libraries they need."""

from __future__ import annotations

import ctypes.util
import importlib.util
import platform
import sys
from importlib.metadata import PackageNotFoundError, requires, version

from s2r_protocol.machine.finding import Finding, Level

_MIN_PYTHON = (3, 11)
_MIN_GLIBC = (2, 28)  # what the wheels are built for (manylinux_2_28)
_MACHINES = ("x86_64", "aarch64")
_DISTRIBUTION = "sim2real2"
# One module per part that says whether that extra was meant to be installed.
_PARTS = {"": "zenoh", "sim": "mujoco", "host": "open3d"}


def check_software() -> list[Finding]:
    """Look at what is installed; nothing is imported but the native parts' location."""
    return [*_python(), *_platform(), *_packages(), *_native_parts(), *_system_libraries()]


def is_installed(module: str) -> bool:
    """Whether a module can be found, without importing it."""
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # a parent package is missing
        return False


def _python() -> list[Finding]:
    name = f"Python {platform.python_version()}"
    if sys.version_info < _MIN_PYTHON:
        return [Finding("python", Level.PROBLEM, name, "install Python 3.11 or newer")]
    return [Finding("python", Level.OK, f"{name} at {sys.executable}")]


def _platform() -> list[Finding]:
    machine, (library, libc) = platform.machine(), platform.libc_ver()
    if sys.platform != "linux" or machine not in _MACHINES:
        return [
            Finding(
                "platform", Level.PROBLEM, f"{sys.platform} on {machine}", "use Linux on x86_64 or aarch64"
            )
        ]
    if library != "glibc" or tuple(map(int, libc.split(".")[:2])) < _MIN_GLIBC:
        text = (
            f"C library {library or 'unknown'} {libc}: the wheels need glibc {'.'.join(map(str, _MIN_GLIBC))}"
        )
        return [Finding("platform", Level.PROBLEM, text, "use Debian 11, Ubuntu 20.04 or newer")]
    return [Finding("platform", Level.OK, f"Linux {platform.release()} on {machine}, glibc {libc}")]


def _packages() -> list[Finding]:
    from packaging.requirements import Requirement

    try:
        wanted = [Requirement(text) for text in requires(_DISTRIBUTION) or []]
    except PackageNotFoundError:
        return [
            Finding("packages", Level.PROBLEM, f"{_DISTRIBUTION} is not installed", "scripts/bootstrap base")
        ]
    return [_part(extra, module, wanted) for extra, module in _PARTS.items()]


def _part(extra: str, module: str, wanted: list) -> Finding:  # of packaging's Requirement
    topic = f"packages: {extra or 'base'}"
    install = f"pip install '{_DISTRIBUTION}{f'[{extra}]' if extra else ''}'"
    if extra and not is_installed(module):
        return Finding(topic, Level.NOTE, "not installed", install)  # the other parts are a choice
    mine = [r for r in wanted if r.marker is None or r.marker.evaluate({"extra": extra})]
    wrong = []
    for requirement in mine:
        try:
            found = version(requirement.name)
        except PackageNotFoundError:
            wrong.append(f"{requirement.name} is missing")
            continue
        if not requirement.specifier.contains(found, prereleases=True):
            wrong.append(f"{requirement.name} {found} does not meet {requirement.specifier}")
    if wrong:
        return Finding(topic, Level.PROBLEM, "; ".join(wrong), install)
    return Finding(topic, Level.OK, f"{len(mine)} in the wanted versions")


def _native_parts() -> list[Finding]:
    wanted = {"native core": "s2r_executor._native", "native planner": "s2r_host._native"}
    return [_native(topic, module) for topic, module in wanted.items()]


def _native(topic: str, module: str) -> Finding:
    spec = importlib.util.find_spec(module) if is_installed(module.split(".")[0]) else None
    if spec is None:
        return Finding(topic, Level.PROBLEM, f"{module} is not built", "make build")
    return Finding(topic, Level.OK, f"built: {spec.origin}")


def _system_libraries() -> list[Finding]:
    wanted = {"gomp": "libgomp1"}
    if is_installed("open3d"):
        wanted |= {"usb-1.0": "libusb-1.0-0", "GL": "libgl1", "EGL": "libegl1", "X11": "libx11-6"}
    missing = [package for library, package in wanted.items() if ctypes.util.find_library(library) is None]
    if missing:
        text = f"missing: {', '.join(missing)}"
        return [
            Finding("system libraries", Level.PROBLEM, text, f"sudo apt-get install -y {' '.join(missing)}")
        ]
    return [Finding("system libraries", Level.OK, f"{len(wanted)} found")]
