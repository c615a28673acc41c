"""Figures of a long run with s2r-rt and the MuJoCo stand-in in lock-step: speed, missed setpoints, splices."""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from s2r_executor.bench.driver import send
from s2r_executor.bench.figures import SteppedArm
from s2r_executor.bench.slice import bench_config, stand_in
from s2r_executor.bridge_motion import PathState
from s2r_executor.config import ExecutorConfig
from s2r_executor.core import EventKind
from s2r_executor.plan import PlanRequest
from s2r_executor.quintic import sample, spline_through
from s2r_protocol.arms import ArmDescription, load_arm
from s2r_protocol.faults import ExecutorState

_TURN_S = 2.0  # of one move to or fro
_STEP_RAD = 0.15  # of every joint away from home: no collision anywhere
_COAST_S = 1.2  # of a replacement, to rest
_AHEAD_S = 0.2  # of the running plan's time: room for admission on a loaded machine
_MISS_RAD = 1e-3
_PACE = 2.0  # simulated over real seconds: leaves admission ten times what it takes


@dataclass
class _Count:
    """Of the core's cycle records: one per setpoint."""

    newest: int = -1
    records: int = 0
    gaps: int = 0
    stops: int = 0

    def take(self, arm: SteppedArm) -> None:
        """Read what has come since the last call; nothing is kept."""
        arm.read()
        for batch in arm.records:
            ticks = batch["tick"].astype(np.int64)
            if not len(ticks):
                continue
            steps = np.diff(ticks, prepend=self.newest if self.newest >= 0 else ticks[0] - 1)
            self.gaps += int((steps - 1).sum())
            self.newest, self.records = int(ticks[-1]), self.records + len(ticks)
        self.stops += sum(int((batch["kind"] == EventKind.STOP_BEGUN).sum()) for batch in arm.events)
        arm.records.clear()
        arm.events.clear()


def stepped_clock(ticks: int = 1_000_000) -> dict[str, float]:
    """Moves to and fro for so many ticks, as fast as core and stand-in can; on one CPU, since they take turns.

    Returns:
        Setpoints sent and missed, simulated over wall time, and the CPU time per tick of both processes [µs]; its sum
        bounds the speed of a machine that has nothing else to do.
    """
    arm = load_arm("xmate3pro")
    count = _Count()
    with tempfile.TemporaryDirectory(prefix="s2r-bench-") as name:
        config = _unpaced(Path(name))
        shared = {max(os.sched_getaffinity(0))}
        with stand_in(config, shared, Path(name)) as sim_pid:
            stepped = SteppedArm(config, arm)
            os.sched_setaffinity(stepped.process.pid, shared)
            try:
                stepped.hold()
                count.take(stepped)
                begin, count.records = time.monotonic(), 0
                pids = (stepped.process.pid, sim_pid)
                cpu = [_cpu_s(pid) for pid in pids]
                forth = True
                while count.records < ticks:
                    step = np.zeros(arm.dof)
                    step[0] = _STEP_RAD if forth else -_STEP_RAD
                    forth = not forth
                    stepped.start(step, _TURN_S)
                    while stepped.core.snapshot().state == ExecutorState.RUN and count.records < ticks:
                        stepped.core.beat()
                        stepped.process.check()
                        count.take(stepped)
                        time.sleep(0.002)
                    count.take(stepped)
                wall_s = time.monotonic() - begin
                used = [_cpu_s(pid) - before for pid, before in zip(pids, cpu, strict=True)]
                end = stepped.core.snapshot()
            finally:
                stepped.process.quit()
    simulated_s = count.records * config.tick_ns * 1e-9
    return {
        "ticks": float(count.records),
        "missed": float(end.missed + count.gaps),
        "stops": float(count.stops),
        "records_dropped": float(stepped.core.records_dropped),
        "over_real_time": simulated_s / wall_s,
        "core_cpu_us": 1e6 * used[0] / count.records,
        "stand_in_cpu_us": 1e6 * used[1] / count.records,
    }


def splices(count: int = 40, seed: int = 0) -> dict[str, float]:
    """Plans that replace a running one at a random moment, admitted as a host's are; how many take over.

    Every other one begins up to a milliradian beside the running plan, so that it needs a bridge.
    """
    arm = load_arm("xmate3pro")
    random = np.random.default_rng(seed)
    outcomes = {f"{kind}_{what}": 0.0 for kind in ("met", "bridged") for what in ("tried", "took_over")}
    with tempfile.TemporaryDirectory(prefix="s2r-bench-") as name:
        config = _unpaced(Path(name)).model_copy(update={"pace": _PACE})
        with stand_in(config, os.sched_getaffinity(0), Path(name)):
            stepped = SteppedArm(config, arm)
            try:
                for k in range(count):
                    kind = "bridged" if k % 2 else "met"
                    outcomes[f"{kind}_tried"] += 1
                    outcomes[f"{kind}_took_over"] += _splice(stepped, random, _MISS_RAD if k % 2 else 0.0)
            finally:
                stepped.process.quit()
    return outcomes


def _splice(stepped: SteppedArm, random: np.random.Generator, miss_rad: float) -> bool:
    """One replacement, at a random moment of a move; True if it takes over and ends at its own goal."""
    stepped.hold()
    goal = stepped.arm.q_home + random.uniform(-_STEP_RAD, _STEP_RAD, stepped.arm.dof)
    parent = stepped.start(goal - np.asarray(stepped.core.snapshot().q_ref), _TURN_S)
    moment = random.uniform(0.1, _TURN_S - 1.0)
    stepped.until(lambda: stepped.core.snapshot().plan_t > moment, "the motion")
    now = stepped.core.snapshot()
    splice_t = now.plan_t + _AHEAD_S
    at = sample(spline_through(parent.t, parent.q, parent.dq, parent.ddq), np.array([splice_t]))
    start = PathState(at.q[0], at.dq[0], at.ddq[0])
    beside = PathState(start.q + random.uniform(-miss_rad, miss_rad, stepped.arm.dof), start.dq, start.ddq)
    child = stepped.admission.admit_splice(_onward(stepped.arm, beside, splice_t), start)
    parent_id, stepped.plan_id = stepped.plan_id, stepped.plan_id + 1
    send(stepped.core, stepped.plan_id, now.epoch, child, parent_id, splice_t)
    stepped.until(lambda: stepped.core.snapshot().state == ExecutorState.HOLD, "the end of the motion")
    end = stepped.core.snapshot()
    return end.plan_id == stepped.plan_id and bool(np.abs(end.q_ref - child.q[-1]).max() < 1e-9)


def _onward(arm: ArmDescription, state: PathState, splice_t: float) -> PlanRequest:
    """From a moving state to rest where it would coast to."""
    zero = np.zeros(arm.dof)
    ends = spline_through(
        np.array([0.0, _COAST_S]),
        np.stack([state.q, state.q + state.dq * _COAST_S / 2]),
        np.stack([state.dq, zero]),
        np.stack([state.ddq, zero]),
    )
    at = sample(ends, np.linspace(0.0, _COAST_S, 25))
    return PlanRequest(arm.joint_names, at.t, at.q, at.dq, at.ddq, parent_seq=1, splice_t=splice_t)


def _unpaced(folder: Path) -> ExecutorConfig:
    return bench_config(folder, "fd").model_copy(
        update={"clock": "lockstep", "pace": 0.0, "profile": "stand-in"}
    )


def _cpu_s(pid: int) -> float:
    """Of all threads of a process."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return 1e-9 * sum(int((task / "schedstat").read_text().split()[0]) for task in tasks)
