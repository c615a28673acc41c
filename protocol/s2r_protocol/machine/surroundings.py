"""Clock, ports, disk, shared memory and graphics of this machine."""

from __future__ import annotations

import ctypes
import os
import shutil
import socket
from pathlib import Path

from s2r_protocol.machine.finding import Finding, Level

_MIN_FREE_GIB = 1.0
_MIN_SHARED_MIB = 64
_PORTS = {7447: "executor", 7448: "camera"}
_TIME_ERROR = 5  # adjtimex(2): the clock is not synchronised


def check_surroundings() -> list[Finding]:
    """Look around; nothing is changed."""
    return [*_clock(), *_ports(), *_disk(), *_shared_memory(), *_gpu()]


def _clock() -> list[Finding]:
    # struct timex is 208 bytes on 64-bit Linux; modes = 0 only reads.
    answer = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(512))
    if answer == _TIME_ERROR:
        text = (
            "the wall clock is not synchronised: log stamps and certificates are off, motion is not affected"
        )
        return [Finding("clock", Level.NOTE, text, "sudo apt-get install -y chrony")]
    return [Finding("clock", Level.OK, "synchronised")]


def _ports() -> list[Finding]:
    findings = []
    for port, owner in _PORTS.items():
        with socket.socket() as probe:
            probe.settimeout(1.0)
            busy = probe.connect_ex(("127.0.0.1", port)) == 0
        if busy:
            text = f"127.0.0.1:{port} is taken, perhaps by a running {owner}"
            fix = f"'ss -ltnp sport = :{port}' names the process; stop it or choose another address with --listen"
            findings.append(Finding(f"port {port}", Level.NOTE, text, fix))
        else:
            findings.append(Finding(f"port {port}", Level.OK, f"free for the {owner}"))
    return findings


def _disk() -> list[Finding]:
    free_gib = shutil.disk_usage(Path.cwd()).free / 2**30
    if free_gib < _MIN_FREE_GIB:
        text = f"{free_gib:.1f} GiB free in {Path.cwd()}"
        return [Finding("disk", Level.PROBLEM, text, "free at least 1 GiB for recordings")]
    if not os.access(Path.cwd(), os.W_OK):
        return [
            Finding("disk", Level.PROBLEM, f"{Path.cwd()} cannot be written to", "work in a folder of yours")
        ]
    return [Finding("disk", Level.OK, f"{free_gib:.0f} GiB free here")]


def _shared_memory(where: Path = Path("/dev/shm")) -> list[Finding]:
    try:
        free_mib = shutil.disk_usage(where).free / 2**20
    except OSError as error:
        text = f"{where}: {error.strerror}; large frames then take the slow way"
        return [Finding("shared memory", Level.NOTE, text, f"sudo mount -t tmpfs tmpfs {where}")]
    if free_mib < _MIN_SHARED_MIB:
        text = f"{free_mib:.0f} MiB free in {where}; large frames then take the slow way"
        return [Finding("shared memory", Level.NOTE, text, f"sudo mount -o remount,size=1G {where}")]
    return [Finding("shared memory", Level.OK, f"{free_mib:.0f} MiB free in {where}")]


def _gpu(devices: Path = Path("/dev")) -> list[Finding]:
    nvidia = sorted(devices.glob("nvidia[0-9]*"))
    if not nvidia:
        return [
            Finding("GPU", Level.OK, "none found, none needed: only training networks is faster with one")
        ]
    if not all(os.access(device, os.R_OK | os.W_OK) for device in nvidia):
        text = f"{', '.join(d.name for d in nvidia)} cannot be opened"
        return [
            Finding("GPU", Level.NOTE, text, "add yourself to group 'video', or go without: nothing needs it")
        ]
    return [Finding("GPU", Level.OK, f"{len(nvidia)} NVIDIA device(s)")]
