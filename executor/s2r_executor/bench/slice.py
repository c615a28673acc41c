"""One slice: s2r-rt, its drives and the reference thread, for a few seconds under one load."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from s2r_executor.bench import load
from s2r_executor.bench.driver import DURATION_S, KNOTS, ForkedFrontEnd, smooth_request
from s2r_executor.bench.measure import lateness, ratios, stop_after_kill, unexplained, wakes_of
from s2r_executor.config import ExecutorConfig, load_config
from s2r_executor.core import Core, CoreSnapshot
from s2r_executor.core_process import CoreProcess, native_executable
from s2r_executor.status import describe_cause
from s2r_protocol.arms import ArmDescription, load_arm
from s2r_protocol.exits import NotReadyError
from s2r_protocol.faults import ExecutorState

CONDITIONS = {
    "alone": "drives on the other CPU, nothing else",
    "zenoh": "the front end receives 1000 Zenoh messages per second",
    "mujoco": "MuJoCo steps without pause on every other CPU",
    "hogs": "CPU, memory and disk hogs, 20 MB/s of camera traffic, on all CPUs",
    "killed": "the front end is killed (SIGKILL) in motion",
}
REFERENCE_PRIORITY = 90
_WARM_UP_S = 1.5
_READY_TIMEOUT_S = 60.0


@dataclass(frozen=True)
class SliceSettings:
    """How one slice is run."""

    condition: str
    seconds: int
    cpu: int  # of s2r-rt and the reference
    packing: str = "fd"


def run_slice(settings: SliceSettings) -> dict[str, object]:
    """Measure one slice.

    Raises:
        NotReadyError: This machine grants no real-time rights, or a part does not start.
    """
    arm = load_arm("xmate3pro")
    others = os.sched_getaffinity(0) - {settings.cpu}
    if not others:
        raise NotReadyError("the benchmark needs two CPUs: one for the loop, one for the rest")
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="s2r-bench-")))
        config = bench_config(folder, settings.packing, 0.1 if settings.condition == "killed" else 5.0)
        stack.enter_context(stand_in(config, others, folder))
        process = CoreProcess(config, arm)
        stack.callback(process.quit)
        os.sched_setaffinity(process.pid, {settings.cpu})
        if not process.core.snapshot().realtime:
            raise NotReadyError("s2r-rt got no real-time rights here; 's2r doctor' says how to grant them")
        endpoint = load.free_endpoint() if settings.condition == "zenoh" else None
        front_end = ForkedFrontEnd(process.core, config, arm, others, endpoint)
        stack.callback(front_end.kill)
        if endpoint is not None:
            stack.enter_context(load.publisher(endpoint, others))
        if settings.condition == "mujoco":
            stack.enter_context(load.simulation(others))
        if settings.condition == "hogs":
            stack.enter_context(load.hogs(os.sched_getaffinity(0), folder))
        _wait_moving(process, front_end)
        return _measure(settings, config, arm, process, front_end, folder)


def bench_config(folder: Path, packing: str, front_end_timeout_s: float = 0.1) -> ExecutorConfig:
    """Strict as on hardware where the loop is measured; patient where a shared machine's drives are late."""
    return load_config(
        overrides={
            "bus": f"unix:{folder}/bus.sock",
            "packing": packing,
            "clock": "real",
            "core.front_end_timeout_s": front_end_timeout_s,
            "core.feedback_stop_ticks": 900,
            "core.feedback_fault_ticks": 1000,
            "core.arming_timeout_s": 10.0,
            "core.path_tolerance_rad": 0.2,
            "profile": "default",  # the front end's silence counts after 0.1 s, not after the stand-in's half second
            "allow_not_realtime": True,
        }
    )


@contextmanager
def stand_in(config: ExecutorConfig, cpus: set[int], folder: Path) -> Iterator[int]:
    """``s2r sim-arm`` in a process of its own, on ``cpus``; yields its process id."""
    ready = folder / "ready"
    command = [sys.executable, "-m", "s2r_protocol", "sim-arm", "--seed", "1", "--clock", config.clock]
    command += ["--pace", str(config.pace)]
    command += ["--bus", config.bus, "--packing", config.packing, "--listen", load.free_endpoint()]
    with (folder / "sim-arm.log").open("w+") as log:
        process = subprocess.Popen([*command, "--ready-file", str(ready)], stdout=log, stderr=log)
        try:
            os.sched_setaffinity(process.pid, cpus)
            deadline = time.monotonic() + _READY_TIMEOUT_S
            while not ready.exists():
                if process.poll() is not None or time.monotonic() > deadline:
                    log.seek(0)
                    raise NotReadyError(
                        f"the stand-in did not start (pip install 'sim2real2[sim]'): {log.read()}"
                    )
                time.sleep(0.05)
            yield process.pid
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _wait_moving(process: CoreProcess, front_end: ForkedFrontEnd) -> None:
    deadline = time.monotonic() + _READY_TIMEOUT_S
    while process.core.snapshot().state != ExecutorState.RUN:
        process.check()
        front_end.check()
        if time.monotonic() > deadline:
            core = process.core.snapshot()
            why = describe_cause(core, load_arm("xmate3pro").joint_names)
            raise NotReadyError(
                f"the arm did not begin to move within {_READY_TIMEOUT_S:g} s: {ExecutorState(core.state).name}, {why}"
            )
        time.sleep(0.01)
    time.sleep(_WARM_UP_S)  # what is touched for the first time has been


def _measure(
    settings: SliceSettings,
    config: ExecutorConfig,
    arm: ArmDescription,
    process: CoreProcess,
    front_end: ForkedFrontEnd,
    folder: Path,
) -> dict[str, object]:
    core, period_ns = process.core, config.tick_ns
    _drain(core)
    out = folder / "reference.bin"
    newest = core.snapshot()
    phase = (
        newest.stamp_ns + period_ns // 2
    ) % period_ns  # half a period after s2r-rt, give or take its lateness
    arguments = [period_ns, phase, settings.seconds, REFERENCE_PRIORITY, settings.cpu, out]
    reference = subprocess.Popen([str(native_executable().with_name("s2r-reference")), *map(str, arguments)])
    before = _usage(process.pid)
    parts, killed_ns = [], 0
    kill_at = time.monotonic() + settings.seconds / 2
    while reference.poll() is None:
        time.sleep(0.05)
        parts.append(core.records(65_536))
        due = settings.condition == "killed" and not killed_ns and time.monotonic() > kill_at
        if due and _in_full_motion(core.snapshot()):
            front_end.kill()
            killed_ns = time.monotonic_ns()
    after = _usage(process.pid)
    parts.append(core.records(65_536))
    if reference.returncode != 0:
        raise NotReadyError(
            f"the reference thread ended with {reference.returncode}: no FIFO priority on CPU {settings.cpu}?"
        )
    records = np.concatenate(parts)
    samples = np.fromfile(out, np.int64).reshape(-1, 2)
    result = _figures(records, samples, period_ns)
    result |= _cost(before, after, len(records), period_ns)
    result["condition"], result["settings"] = settings.condition, asdict(settings)
    result["bus_load_computed"] = core.snapshot().bus_load_computed
    if settings.condition == "killed":
        result["stop"] = _stop(records, killed_ns, arm, config)
    return result


def _in_full_motion(core: CoreSnapshot) -> bool:
    """Far from both ends of the plan."""
    return core.state == ExecutorState.RUN and 0.8 < core.plan_t < DURATION_S - 1.5


def _drain(core: Core) -> None:
    while len(core.records(65_536)):
        pass


def _figures(records: np.ndarray, samples: np.ndarray, period_ns: int) -> dict[str, object]:
    deadline, woke = wakes_of(records, period_ns)
    inside = (deadline >= samples[0, 0]) & (woke <= samples[-1, 1])
    loop = lateness(deadline[inside], woke[inside], period_ns)
    reference = lateness(samples[:, 0], samples[:, 1], period_ns)
    lonely = unexplained(deadline[inside], woke[inside], samples[:, 0], samples[:, 1], period_ns)
    return {
        "loop": asdict(loop),
        "reference": asdict(reference),
        "ratio": ratios(loop, reference),
        "unexplained": lonely,
    }


def _usage(pid: int) -> dict[str, float]:
    """CPU time [ns] of all threads, page faults and involuntary switches of a process."""
    cpu_ns = sum(
        int((task / "schedstat").read_text().split()[0]) for task in Path(f"/proc/{pid}/task").iterdir()
    )
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return {
        "cpu_ns": float(cpu_ns),
        "minor_faults": float(fields[7]),
        "major_faults": float(fields[9]),
        "resident_kib": float(status["VmRSS"].split()[0]),
        "data_kib": float(status["VmData"].split()[0]),
        "switches": float(status["nonvoluntary_ctxt_switches"]),
    }


def _cost(before: dict[str, float], after: dict[str, float], ticks: int, period_ns: int) -> dict[str, object]:
    cpu_ns = (after["cpu_ns"] - before["cpu_ns"]) / max(ticks, 1)
    return {
        "cpu_per_tick_us": cpu_ns * 1e-3,
        "cpu_share": cpu_ns / period_ns,
        "page_faults": after["minor_faults"]
        + after["major_faults"]
        - before["minor_faults"]
        - before["major_faults"],
        "heap_growth_kib": after["data_kib"] - before["data_kib"],
        "resident_MiB": after["resident_kib"] / 1024,
    }


def _stop(
    records: np.ndarray, killed_ns: int, arm: ArmDescription, config: ExecutorConfig
) -> dict[str, float] | None:
    """The stop after the kill against the ramp that admission had found; None if the kill was never possible."""
    if not killed_ns:
        return None
    from s2r_executor.admission import Admission

    after = records[records["stamp_ns"] >= killed_ns]
    running = records[(records["stamp_ns"] < killed_ns) & (records["state"] == ExecutorState.RUN)]
    # The plan is symmetric in direction: admit its like from the same end of the swing.
    q = arm.q_home.copy()
    step = np.zeros(arm.dof)
    step[0] = np.sign(running["dq_ref"][-1, 0]) * 0.4
    q[0] = running["q_ref"][-1, 0]
    admission = Admission(arm, config.admission, config.core)
    q[0] = arm.q_home[0] if step[0] > 0 else arm.q_home[0] + 0.4
    plan = admission.admit(smooth_request(arm, q, step, DURATION_S, KNOTS), q)
    stop = stop_after_kill(
        after, ExecutorState.STOPPING, plan.t, plan.stop_duration, arm.limits.dddq_max, config.tick_ns * 1e-9
    )
    if stop is None:
        return None
    begun_ns = int(after["stamp_ns"][np.flatnonzero(after["state"] == ExecutorState.STOPPING)[0]])
    return {
        "noticed_ms": (begun_ns - killed_ns) * 1e-6,
        "planned_s": stop.planned_s,
        "taken_s": stop.taken_s,
        "ratio": stop.ratio,
        "jerk_share": stop.jerk_share,
    }
