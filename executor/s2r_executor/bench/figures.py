"""Figures that need no clock of their own: admission time, memory, stop latency, splices, bus load. In lock-step."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from s2r_executor.admission import Admission
from s2r_executor.bench import load
from s2r_executor.bench.driver import send, smooth_request
from s2r_executor.bench.slice import bench_config, stand_in
from s2r_executor.config import ExecutorConfig, load_config
from s2r_executor.core import Core, EventKind
from s2r_executor.core_process import CoreProcess
from s2r_executor.plan import AdmittedPlan
from s2r_protocol.arms import ArmDescription, load_arm
from s2r_protocol.exits import NotReadyError
from s2r_protocol.faults import ExecutorState
from s2r_protocol.proto import s2r_pb2 as pb

_TIMEOUT_S = 120.0


def admission_time(repeats: int = 20, knots: int = 500) -> dict[str, float]:
    """Admitting a plan of 500 points, against the time of its 500 inverse dynamics alone [ms]."""
    import pinocchio

    arm = load_arm("xmate3pro")
    config = load_config()
    admission = Admission(arm, config.admission, config.core)
    step = np.array([0.5, 0.3, -0.3, -0.3, 0.4, 0.3, 0.5])[: arm.dof]
    plan = smooth_request(arm, arm.q_home, step, 10.0, knots)
    model = pinocchio.buildModelFromXML(arm.urdf)
    data = model.createData()

    def dynamics() -> None:
        for q, dq, ddq in zip(plan.q, plan.dq, plan.ddq, strict=True):
            pinocchio.rnea(model, data, q, dq, ddq)

    whole, whole_cpu = _times_ms(lambda: admission.admit(plan, arm.q_home), repeats)
    _, rnea_cpu = _times_ms(dynamics, repeats)
    return {
        "knots": float(knots),
        "p50_ms": float(np.median(whole)),
        "worst_ms": max(whole),
        "cpu_p50_ms": float(np.median(whole_cpu)),
        "cpu_worst_ms": max(whole_cpu),
        "over_rnea": float(np.median(whole_cpu) / np.median(rnea_cpu)),
    }


def _times_ms(act: Callable[[], object], repeats: int) -> tuple[list[float], list[float]]:
    """Wall and CPU time of every call but the first [ms]."""
    act()
    wall, cpu = [], []
    for _ in range(repeats):
        begin, begin_cpu = time.perf_counter(), time.process_time()
        act()
        wall.append(1e3 * (time.perf_counter() - begin))
        cpu.append(1e3 * (time.process_time() - begin_cpu))
    return wall, cpu


def memory() -> dict[str, float]:
    """Resident memory of every process of a running ``s2r executor`` [MiB], on an idle lock-step bus."""
    with tempfile.TemporaryDirectory(prefix="s2r-bench-") as name:
        folder = Path(name)
        config = bench_config(folder, "fd").model_copy(update={"clock": "lockstep"})
        ready = folder / "executor-ready"
        command = [
            sys.executable,
            "-m",
            "s2r_protocol",
            "executor",
            "--bus",
            config.bus,
            "--clock",
            "lockstep",
        ]
        command += ["--listen", load.free_endpoint(), "--record", str(folder / "recordings")]
        with stand_in(config, os.sched_getaffinity(0), folder):
            process = subprocess.Popen(
                [*command, "--ready-file", str(ready)],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
            try:
                deadline = time.monotonic() + _TIMEOUT_S
                while not ready.exists():
                    if process.poll() is not None or time.monotonic() > deadline:
                        said = process.communicate()[1] if process.poll() is not None else "it is not ready"
                        raise NotReadyError(f"the executor did not start: {said[-500:]}")
                    time.sleep(0.05)
                time.sleep(1.0)
                return _family(process.pid)
            finally:
                process.terminate()
                process.communicate()


def _family(pid: int) -> dict[str, float]:
    """Resident memory of a process and its children, by role [MiB]."""
    found = {"front_end_MiB": _resident_mib(pid)}
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    for child in children:
        name = Path(f"/proc/{child}/comm").read_text().strip()
        key = "s2r_rt_MiB" if name == "s2r-rt" else "recorder_MiB"
        found[key] = found.get(key, 0.0) + _resident_mib(int(child))
    return found


def _resident_mib(pid: int) -> float:
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return float(line.split()[1]) / 1024
    return 0.0


class SteppedArm:
    """s2r-rt and the stand-in in lock-step, as fast as they can; a small front end around them."""

    def __init__(self, config: ExecutorConfig, arm: ArmDescription) -> None:
        self.arm = arm
        self.config = config
        self.process = CoreProcess(config, arm)
        self.core: Core = self.process.core
        self.admission = Admission(arm, config.admission, config.core)
        self.plan_id = 0
        self.events: list[np.ndarray] = []
        self.records: list[np.ndarray] = []

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Beat and read until something holds.

        Raises:
            NotReadyError: It does not within two minutes.
        """
        deadline = time.monotonic() + _TIMEOUT_S
        while not condition():
            self.core.beat()
            self.process.check()
            self.read()
            if time.monotonic() > deadline:
                state = ExecutorState(self.core.snapshot().state).name
                raise NotReadyError(f"{what} did not happen within {_TIMEOUT_S:g} s; the core is in {state}")
            time.sleep(0.0005)

    def read(self) -> None:
        """Take what the core has written."""
        self.records.append(self.core.records(65_536))
        self.events.append(self.core.events())

    def hold(self) -> None:
        """Arm if needed and wait for HOLD."""
        if self.core.snapshot().state == ExecutorState.BOOT:
            self.until(lambda: self.core.snapshot().state != ExecutorState.BOOT, "booting")
        if self.core.snapshot().state == ExecutorState.DISARMED:
            self.until(lambda: max(self.core.snapshot().feedback_age) == 0, "the first answers")
            self.core.command(pb.ARM, self.core.snapshot().epoch)
        self.until(lambda: self.core.snapshot().state == ExecutorState.HOLD, "holding")

    def start(self, step: np.ndarray, duration_s: float) -> AdmittedPlan:
        """Admit and start a move."""
        self.hold()
        core = self.core.snapshot()
        q = np.asarray(core.q_ref)
        plan = self.admission.admit(smooth_request(self.arm, q, step, duration_s, 61), q)
        self.plan_id += 1
        send(self.core, self.plan_id, core.epoch, plan)
        self.until(lambda: self.core.snapshot().plan_id == self.plan_id, "the plan's start")
        return plan


def stop_latency(stops: int = 50, seed: int = 0) -> dict[str, float]:
    """Ticks between a stop request in the ring and the first tick of the stop, at random moments of a motion."""
    arm = load_arm("xmate3pro")
    random = np.random.default_rng(seed)
    latencies = []
    with tempfile.TemporaryDirectory(prefix="s2r-bench-") as name:
        config = _stepped(Path(name))
        with stand_in(config, os.sched_getaffinity(0), Path(name)):
            stepped = SteppedArm(config, arm)
            try:
                for k in range(stops):
                    step = np.zeros(arm.dof)
                    step[0] = 0.3 if k % 2 == 0 else -0.3
                    stepped.start(step, 2.0)
                    moment = random.uniform(0.3, 1.2)
                    stepped.until(lambda moment=moment: stepped.core.snapshot().plan_t > moment, "the motion")
                    stepped.read()
                    stepped.events.clear()
                    asked = stepped.core.snapshot().tick
                    stepped.core.command(pb.STOP, stepped.core.snapshot().epoch)
                    latencies.append(_begun(stepped) - asked)
                    stepped.hold()
            finally:
                stepped.process.quit()
    return {
        "stops": float(stops),
        "p50_ticks": float(np.median(latencies)),
        "worst_ticks": float(max(latencies)),
    }


def _begun(stepped: SteppedArm) -> int:
    """Tick at which the stop began, from the core's event."""

    def found() -> list[int]:
        return [
            int(event["tick"])
            for batch in stepped.events
            for event in batch
            if event["kind"] == EventKind.STOP_BEGUN
        ]

    stepped.until(lambda: bool(found()), "the stop")
    return found()[0]


def _stepped(folder: Path) -> ExecutorConfig:
    return load_config(
        overrides={
            "bus": f"unix:{folder}/bus.sock",
            "clock": "lockstep",
            "pace": 1.0,
            "core.answer_timeout_s": 30.0,
        }
    )


def bus_load() -> dict[str, dict[str, float]]:
    """Computed worst case of both packings, and what the frames on the stand-in's bus add up to, in lock-step."""
    from s2r_executor import _native
    from s2r_executor.sdo_client import CanLine
    from s2r_protocol.can.timing import BitRate, frame_ns

    arm = load_arm("xmate3pro")
    result = {}
    for packing in ("fd", "classic"):
        with tempfile.TemporaryDirectory(prefix="s2r-bench-") as name:
            config = _stepped(Path(name)).model_copy(update={"packing": packing})
            with stand_in(config, os.sched_getaffinity(0), Path(name)), CanLine(config.bus) as line:
                stepped = SteppedArm(config, arm)
                try:
                    stepped.hold()
                    line.listen(0.2)
                    first, busy_ns = stepped.core.snapshot().tick, 0
                    until = time.monotonic() + 2.0
                    while (frame := line.receive(until)) is not None:
                        busy_ns += frame_ns(len(frame.data), frame.is_fd, BitRate())
                        stepped.core.beat()
                    ticks = stepped.core.snapshot().tick - first
                finally:
                    stepped.process.quit()
        result[packing] = {
            "computed": _native.bus_load(packing, arm.dof, config.tick_ns),
            "measured": busy_ns / max(ticks * config.tick_ns, 1),
        }
    return result
