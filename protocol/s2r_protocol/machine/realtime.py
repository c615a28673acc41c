"""Can this machine keep a setpoint's deadline? Facts of the kernel, judged by a pure function.

The list follows the PREEMPT_RT project's advice (https://wiki.linuxfoundation.org/realtime) and libfranka's demand
for a real-time kernel; FIFO priority and locked memory are tried, not guessed from permissions.
"""

from __future__ import annotations

import ctypes
import enum
import mmap
import os
import platform
import re
from dataclasses import dataclass
from pathlib import Path

from s2r_protocol.machine import cpus, permission

PRIORITY = 80
MIN_TX_QUEUE = 64  # frames; SocketCAN's default of 10 holds one classical cycle of eight
_LOCK_BYTES = 32 * 1024 * 1024  # more than the core's rings and code


class Verdict(enum.IntEnum):
    """Worst finding wins."""

    RT_OK = 0
    DEGRADED = 1  # the arm may move at reduced speed
    REFUSED = 2  # the arm must not move


@dataclass(frozen=True)
class Check:
    """One fact, judged."""

    topic: str
    verdict: Verdict
    text: str
    fix: str = ""


@dataclass(frozen=True)
class RealtimeFacts:
    """What was read. ``None``: this kernel does not say.

    Attributes:
        fifo, memory_lock: Empty if obtained when tried, else the kernel's reason.
        preemption: "rt", "full", "lazy", "voluntary", "none" or "unknown".
        governors: Of all CPUs; empty without frequency scaling.
        cpus: Those that run, by number.
        isolated: Those of them that are kept free of other work.
        cpu: The one that the core is to run on alone; None: wherever the kernel puts it.
        cpu_refused: Empty if this process may run there, else the kernel's reason.
        rt_runtime_share: Of the time that real-time threads may use; 1 = all.
        hypervisor: Runs in a virtual machine.
        tx_queue: Of the CAN interface, in frames; None without one.
    """

    fifo: str
    memory_lock: str
    preemption: str
    governors: tuple[str, ...]
    cpus: tuple[int, ...]
    isolated: tuple[int, ...]
    rt_runtime_share: float | None
    hypervisor: bool
    tx_queue: int | None = None
    cpu: int | None = None
    cpu_refused: str = ""


def read_facts(
    interface: str | None = None,
    priority: int = PRIORITY,
    root: Path = Path("/"),
    cpu: int | None = None,
) -> RealtimeFacts:
    """Read this machine; nothing stays changed.

    Args:
        interface: CAN interface, or None.
        priority: Of the real-time thread.
        root: Where /proc and /sys are; tests pass their own.
        cpu: That the core is to run on; None: the first isolated one, if there is one.
    """
    folder = root / "sys/devices/system/cpu"
    governors = sorted(p.read_text().strip() for p in folder.glob("cpu[0-9]*/cpufreq/scaling_governor"))
    cpu = cpus.first_isolated(root) if cpu is None else cpu
    queue = _read(root / f"sys/class/net/{interface}/tx_queue_len") if interface else None
    runtime = _read(root / "proc/sys/kernel/sched_rt_runtime_us")
    period = _read(root / "proc/sys/kernel/sched_rt_period_us")
    share = None
    if runtime and period:
        share = 1.0 if int(runtime) < 0 else int(runtime) / int(period)
    return RealtimeFacts(
        fifo=_try_fifo(priority),
        memory_lock=_try_lock(),
        preemption=_preemption(root),
        governors=tuple(governors),
        cpus=cpus.online(root),
        isolated=cpus.isolated(root),
        rt_runtime_share=share,
        hypervisor="hypervisor" in (_read(root / "proc/cpuinfo") or ""),
        tx_queue=int(queue) if queue else None,
        cpu=cpu,
        cpu_refused="" if cpu is None else cpus.refusal(cpu),
    )


def judge(facts: RealtimeFacts, priority: int = PRIORITY, interface: str = "can0") -> list[Check]:
    """Every fact with its verdict, in a fixed order."""
    checks = [_judge_fifo(facts, priority), _judge_lock(facts), _judge_kernel(facts), _judge_governor(facts)]
    checks += [_judge_isolation(facts), _judge_throttling(facts), _judge_hypervisor(facts)]
    if facts.cpu_refused:
        checks.append(_judge_refused_cpu(facts))
    if facts.tx_queue is not None:
        checks.append(_judge_queue(facts.tx_queue, interface))
    return checks


def worst(checks: list[Check]) -> Verdict:
    """The verdict on the whole machine."""
    return max((check.verdict for check in checks), default=Verdict.RT_OK)


_LIMITS_FIX = (
    "sudo install -m 644 executor/deploy/limits-s2r.conf /etc/security/limits.d/s2r.conf, add yourself to group "
    "'realtime' and log in again; or run it as the systemd unit in executor/deploy"
)


def _judge_fifo(facts: RealtimeFacts, priority: int) -> Check:
    if priority == 0:
        text = "SCHED_FIFO is not asked for: core.realtime_priority is 0"
        return Check("FIFO priority", Verdict.REFUSED, text, f"set core.realtime_priority to {PRIORITY}")
    if facts.fifo:
        return Check("FIFO priority", Verdict.REFUSED, f"SCHED_FIFO {priority}: {facts.fifo}", _LIMITS_FIX)
    return Check("FIFO priority", Verdict.RT_OK, f"SCHED_FIFO {priority} is permitted")


def _judge_lock(facts: RealtimeFacts) -> Check:
    if facts.memory_lock:
        text = f"locking {_LOCK_BYTES >> 20} MiB: {facts.memory_lock}"
        return Check("memory lock", Verdict.REFUSED, text, _LIMITS_FIX)
    return Check("memory lock", Verdict.RT_OK, f"{_LOCK_BYTES >> 20} MiB can be locked")


def _judge_kernel(facts: RealtimeFacts) -> Check:
    text = f"preemption model: {facts.preemption}"
    if facts.preemption == "rt":
        return Check("kernel", Verdict.RT_OK, text)
    fix = "sudo apt-get install linux-image-rt-amd64 and boot it (Ubuntu: pro enable realtime-kernel)"
    return Check("kernel", Verdict.DEGRADED, f"{text}, not PREEMPT_RT: latency has no bound", fix)


def _judge_governor(facts: RealtimeFacts) -> Check:
    others = sorted(set(facts.governors) - {"performance"})
    if others:
        text = f"CPU frequency governor: {', '.join(others)}"
        return Check("governor", Verdict.DEGRADED, text, "sudo cpupower frequency-set -g performance")
    return Check(
        "governor",
        Verdict.RT_OK,
        "performance" if facts.governors else "this kernel does not scale frequency",
    )


def _judge_isolation(facts: RealtimeFacts) -> Check:
    if len(facts.cpus) < 2:
        return Check("CPUs", Verdict.DEGRADED, "one CPU for everything", "give the machine a second CPU")
    if facts.cpu in facts.isolated:
        return Check("CPUs", Verdict.RT_OK, f"s2r-rt runs on CPU {facts.cpu}, which is isolated")
    if facts.isolated:
        text = f"core.cpu puts s2r-rt on CPU {facts.cpu}, which is not isolated"
        fix = f"leave core.cpu out: s2r-rt then runs on CPU {facts.isolated[0]}, which is"
        return Check("CPUs", Verdict.DEGRADED, text, fix)
    own = facts.cpus[-1] if facts.cpu is None else facts.cpu
    fix = f"boot with isolcpus={own} nohz_full={own} rcu_nocbs={own}: s2r-rt then runs there, and nothing else does"
    return Check("CPUs", Verdict.DEGRADED, f"none of {len(facts.cpus)} CPUs is isolated", fix)


def _judge_refused_cpu(facts: RealtimeFacts) -> Check:
    fix = "let core.cpu name a CPU that this process may use, or let the cpuset of its control group have that one"
    return Check("CPU of the core", Verdict.REFUSED, f"CPU {facts.cpu}: {facts.cpu_refused}", fix)


def _judge_throttling(facts: RealtimeFacts) -> Check:
    share = facts.rt_runtime_share
    if share is not None and share < 0.5:
        text = f"real-time threads may use {share:.0%} of the time"
        return Check("RT throttling", Verdict.DEGRADED, text, "sudo sysctl kernel.sched_rt_runtime_us=950000")
    return Check(
        "RT throttling",
        Verdict.RT_OK,
        "off" if share in (None, 1.0) else f"real-time threads get {share:.0%}",
    )


def _judge_hypervisor(facts: RealtimeFacts) -> Check:
    if facts.hypervisor:
        text = "a virtual machine: its host may take the CPU away for milliseconds"
        return Check("hypervisor", Verdict.DEGRADED, text, "run the executor on bare metal")
    return Check("hypervisor", Verdict.RT_OK, "bare metal")


def _judge_queue(queue: int, interface: str) -> Check:
    text = f"{interface}: txqueuelen {queue}"
    if queue < MIN_TX_QUEUE:
        fix = f"sudo ip link set {interface} txqueuelen {2 * MIN_TX_QUEUE}"
        return Check("transmit queue", Verdict.DEGRADED, f"{text}, a full queue loses setpoints", fix)
    return Check("transmit queue", Verdict.RT_OK, text)


def _try_fifo(priority: int) -> str:
    """Whether the priority is granted; empty if so, else why not."""
    wanted = os.sched_param(priority)
    return permission.refusal(lambda: os.sched_setscheduler(0, os.SCHED_FIFO, wanted))  # 0: this very thread


def _try_lock() -> str:
    """Lock and unlock a stretch of memory; empty if granted, else why not."""
    libc = ctypes.CDLL(None, use_errno=True)
    with mmap.mmap(-1, _LOCK_BYTES) as memory:
        buffer = (ctypes.c_char * _LOCK_BYTES).from_buffer(memory)
        where = ctypes.c_void_p(ctypes.addressof(buffer))
        failed = libc.mlock(where, ctypes.c_size_t(_LOCK_BYTES)) != 0
        reason = os.strerror(ctypes.get_errno()) if failed else ""
        if not failed:
            libc.munlock(where, ctypes.c_size_t(_LOCK_BYTES))
        del buffer
    return reason


def _preemption(root: Path) -> str:
    if _read(root / "sys/kernel/realtime") == "1":
        return "rt"
    dynamic = re.search(r"\((\w+)\)", _read(root / "sys/kernel/debug/sched/preempt") or "")
    if dynamic:
        return dynamic[1]
    version = _read(root / "proc/sys/kernel/version") or platform.version()
    if "PREEMPT_RT" in version:
        return "rt"
    if "PREEMPT_DYNAMIC" in version:
        return "unknown"  # chosen at boot; only debugfs tells
    return "full" if "PREEMPT" in version else "voluntary"


def _read(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None
