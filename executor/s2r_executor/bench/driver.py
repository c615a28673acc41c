"""The front end of a slice: a forked process that keeps the arm moving, and may be killed.

It shares the core's memory with the process that measures: the child beats and sends plans, the parent reads records.
"""

from __future__ import annotations

import os
import signal
import sys
import time
import traceback
from dataclasses import dataclass

import numpy as np

from s2r_executor.admission import Admission
from s2r_executor.config import ExecutorConfig
from s2r_executor.core import Core
from s2r_executor.plan import AdmittedPlan, PlanRequest
from s2r_executor.quintic import minimum_jerk
from s2r_protocol.arms import ArmDescription
from s2r_protocol.exits import NotReadyError
from s2r_protocol.faults import ExecutorState
from s2r_protocol.proto import s2r_pb2 as pb

_BEAT_S = 0.004
STEP_RAD = 0.4
DURATION_S = 3.0
KNOTS = 61


def smooth_request(
    arm: ArmDescription, q: np.ndarray, step: np.ndarray, duration_s: float, knots: int
) -> PlanRequest:
    """A minimum-jerk move by ``step`` [rad], shape (dof,), from ``q``."""
    t = np.linspace(0.0, duration_s, knots)
    s, ds, dds = minimum_jerk(t / duration_s)
    return PlanRequest(
        joint_names=arm.joint_names,
        t=t,
        q=q + s[:, None] * step,
        dq=ds[:, None] / duration_s * step,
        ddq=dds[:, None] / duration_s**2 * step,
        label="bench",
    )


@dataclass
class Mover:
    """Arms the drives and moves the first joint to and fro for ever."""

    core: Core
    arm: ArmDescription
    admission: Admission
    plan_id: int = 0
    asked_s: float = 0.0

    def step(self) -> None:
        """One round: beat, and whatever the state asks for."""
        self.core.beat()
        now = time.monotonic()
        core = self.core.snapshot()
        if now - self.asked_s < 0.2:  # let the last request act
            return
        if core.state == ExecutorState.DISARMED:
            self.core.command(pb.ARM, core.epoch)
        elif core.state in (ExecutorState.FAULT, ExecutorState.ESTOP):
            self.core.command(pb.RESET, core.epoch)
        elif core.state == ExecutorState.HOLD:
            self._send(core.epoch, np.asarray(core.q_ref))
        else:
            return
        self.asked_s = now

    def _send(self, epoch: int, q: np.ndarray) -> None:
        plan = self.admission.admit(smooth_request(self.arm, q, self.next_step(q), DURATION_S, KNOTS), q)
        self.plan_id += 1
        send(self.core, self.plan_id, epoch, plan)

    def next_step(self, q: np.ndarray) -> np.ndarray:
        """Away from home, or back."""
        step = np.zeros(self.arm.dof)
        step[0] = -STEP_RAD if q[0] > self.arm.q_home[0] + STEP_RAD / 2 else STEP_RAD
        return step


def send(
    core: Core, plan_id: int, epoch: int, plan: AdmittedPlan, parent_id: int = 0, splice_t: float = 0.0
) -> bool:
    """Hand an admitted plan to the core; with a parent it takes over from that one at its time ``splice_t``."""
    return core.submit_plan(
        plan_id,
        epoch,
        plan.t,
        plan.q,
        plan.dq,
        plan.ddq,
        plan.stop_duration,
        plan.path_tolerance,
        plan.goal_tolerance,
        parent_id=parent_id,
        splice_t=splice_t,
        tau_rest=plan.tau_rest,
        tau_move=plan.tau_move,
    )


class ForkedFrontEnd:
    """Owns the child."""

    def __init__(
        self,
        core: Core,
        config: ExecutorConfig,
        arm: ArmDescription,
        cpus: set[int],
        listen: str | None = None,
    ) -> None:
        """Fork. With ``listen`` the child also receives Zenoh messages there. No threads may run in this process."""
        admission = Admission(arm, config.admission, config.core)
        self.pid = os.fork()
        if self.pid == 0:
            code = 1
            try:
                os.sched_setaffinity(0, cpus)
                _run(Mover(core, arm, admission), listen)
                code = 0
            except Exception:  # noqa: BLE001 - the child must not run into the parent's code; the text is all it leaves
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(code)

    def check(self) -> None:
        """Raise if it died by itself.

        Raises:
            NotReadyError: Its text is on the terminal.
        """
        if self.pid and os.waitpid(self.pid, os.WNOHANG)[0]:
            self.pid = 0
            raise NotReadyError("the benchmark's front end died; its traceback is above")

    def kill(self) -> None:
        """End it as a crash would; harmless when it is gone."""
        if self.pid:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
            self.pid = 0


def _run(mover: Mover, listen: str | None) -> None:
    session = None
    if listen is not None:
        import zenoh

        from s2r_protocol.keys import ArmKeys
        from s2r_protocol.session import Role
        from s2r_protocol.session import listen as open_listening

        session = open_listening([listen], Role.EXECUTOR, ArmKeys())
        received = [0]

        def count(_: zenoh.Sample) -> None:
            received[0] += 1

        session.declare_subscriber("bench/load", count)
    parent = os.getppid()
    while os.getppid() == parent:
        mover.step()
        time.sleep(_BEAT_S)
