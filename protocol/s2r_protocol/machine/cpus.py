"""CPUs by number: those that run, and those that the kernel keeps free of everything nobody put there."""

from __future__ import annotations

import os
from pathlib import Path

from s2r_protocol.machine import permission

_FOLDER = "sys/devices/system/cpu"


def numbers(text: str) -> tuple[int, ...]:
    """A list as the kernel writes it, ``0-2,5``, in numbers."""
    found: list[int] = []
    for part in filter(None, text.strip().split(",")):
        first, _, last = part.partition("-")
        found.extend(range(int(first), int(last or first) + 1))
    return tuple(found)


def online(root: Path = Path("/")) -> tuple[int, ...]:
    """CPUs that run, whether this process may use them or not; from the process where the kernel does not say."""
    return _listed(root / _FOLDER / "online") or tuple(sorted(os.sched_getaffinity(0)))


def isolated(root: Path = Path("/")) -> tuple[int, ...]:
    """Those of them that were set apart at boot (``isolcpus``)."""
    return tuple(cpu for cpu in _listed(root / _FOLDER / "isolated") if cpu in online(root))


def first_isolated(root: Path = Path("/")) -> int | None:
    """Where the real-time core runs unless the configuration names another; None: nowhere in particular."""
    return next(iter(isolated(root)), None)


def refusal(cpu: int) -> str:
    """Whether this process may run on that CPU alone; empty if so, else the kernel's reason."""
    return permission.refusal(lambda: os.sched_setaffinity(0, {cpu}))  # 0: this very thread


def _listed(path: Path) -> tuple[int, ...]:
    try:
        return numbers(path.read_text(encoding="ascii"))
    except OSError:
        return ()
