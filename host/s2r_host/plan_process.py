"""Planning in a process of its own, so that ``s2r plan`` answers whatever the planner does.

A search ends itself when its time is up, but only between two of its steps: physics of a scene with thousands of
contacts, a mesh that takes minutes to compile or memory that runs out leave it no chance. So the planner runs in a
child process (``trajectory/plan_worker.py``) that tells what it does in lines of JSON. This side has the clock, ends
the child when it does not end itself, and leaves a ``plan.json`` with the reason in every case.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from s2r_host.errors import HostError
from s2r_protocol.exits import ExitCode, NotReadyError, RefusedError
from s2r_protocol.targets import JointType

GRACE_S = 4.0  # after the time limit, in which the search may end itself
_WRITING_S = 30.0  # for the files of a plan that has been found
_LOOK_S = 0.25
_PLANNER = (sys.executable, "-m", "s2r_host.trajectory.plan_worker")
WRITING = "writing the files"
PLAN_FILES = (
    "plan.csv",
    "plan.mcap",
    "knots.csv",
    "trace.csv",
    "strip.png",
    "model/scene.xml",
    "model/scene.mjb",
)


class PlanAnswerError(HostError):
    """The planner's refusal, or how it ended, in one sentence; ``exit_code`` is what the shell gets."""

    def __init__(self, text: str, exit_code: int) -> None:
        super().__init__(text)
        self.exit_code = ExitCode(exit_code)


class PlanTimeError(HostError, RefusedError):
    """The planner did not end within its time limit and was ended."""


class PlannerDiedError(HostError, NotReadyError):
    """The operating system ended the planner."""


@dataclass(frozen=True)
class PlanOrder:
    """The options of ``s2r plan``, as they are told to the process that plans."""

    scene: str
    joint: str
    target: float
    target_type: JointType | None
    arm: str
    tool: str | None
    q0: str | None
    out: str
    seed: int
    time_limit_s: float
    threads: int
    ensemble: tuple[str, ...]


def plan_in_process(
    order: PlanOrder, tell: Callable[[str], None], planner: tuple[str, ...] = _PLANNER
) -> dict[str, Any]:
    """What ``plan.json`` holds after a plan was found and written by the command ``planner``.

    Raises:
        S2RError: There is no plan; ``plan.json`` has the same sentence as ``reason``.
        KeyboardInterrupt: The user gave up; ``plan.json`` says so.
        RuntimeError: A bug in the planner, whose traceback is on standard error; ``plan.json`` says so.
    """
    out = Path(order.out)
    out.mkdir(parents=True, exist_ok=True)
    for name in ("plan.json", *PLAN_FILES):
        (out / name).unlink(missing_ok=True)  # of an earlier plan, which this one may not replace
    child = _Child(order, tell, planner)
    try:
        child.start()
        return child.answer()
    except KeyboardInterrupt:
        child.refused(f"interrupted after {child.elapsed_s:.1f} s, at: {child.doing}")
        raise
    except (HostError, RuntimeError) as error:
        if not (isinstance(error, PlanAnswerError) and (out / "plan.json").is_file()):
            child.refused(str(error))
        raise
    finally:
        child.end()


class _Child:
    """The process that plans, and what it said last."""

    def __init__(self, order: PlanOrder, tell: Callable[[str], None], planner: tuple[str, ...]) -> None:
        self._order, self._tell, self._planner = order, tell, planner
        self._started_s = time.perf_counter()
        self._deadline_s = math.inf  # until it has imported what it needs: that does not count
        self._control_steps, self._text = 0, b""
        self._process: subprocess.Popen[bytes] | None = None
        self._cpu_s = 0.0
        self.doing = "starting"

    def start(self) -> None:
        """Start the process and give it the order."""
        self._process = subprocess.Popen(
            self._planner,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # a Ctrl-C in the terminal is for this side
        )
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it has died already; its exit code says why
            self._process.stdin.write(json.dumps(asdict(self._order)).encode())
            self._process.stdin.close()

    @property
    def elapsed_s(self) -> float:
        """Time since the process was started [s]."""
        return time.perf_counter() - self._started_s

    def answer(self) -> dict[str, Any]:
        """Listen until the process has answered, has died, or the time is up."""
        assert self._process is not None
        assert self._process.stdout is not None
        with selectors.DefaultSelector() as listening:
            listening.register(self._process.stdout, selectors.EVENT_READ)
            while True:
                if time.perf_counter() > self._deadline_s:
                    raise PlanTimeError(
                        f"no plan within the time limit of {self._order.time_limit_s:g} s; given up at: {self.doing}"
                    )
                if not listening.select(_LOOK_S):
                    continue
                heard = os.read(self._process.stdout.fileno(), 1 << 16)
                if not heard:
                    raise self._died(self._process.wait())
                for line in self._lines(heard):
                    answer = self._take(json.loads(line))
                    if answer is not None:
                        return answer

    def _lines(self, heard: bytes) -> list[bytes]:
        *lines, self._text = (self._text + heard).split(b"\n")
        return lines

    def _take(self, said: dict[str, Any]) -> dict[str, Any] | None:
        """What follows from one line: the answer, or nothing yet."""
        if "answer" in said:
            return said["answer"]
        if "refused" in said:
            raise PlanAnswerError(said["refused"], said["exit_code"])
        if "bug" in said:
            raise RuntimeError(f"bug in the planner: {said['bug']}")
        self.doing, self._control_steps = said["doing"], said["control_steps"]
        self._tell(self.doing)
        if self.doing == WRITING:
            self._deadline_s = max(self._deadline_s, time.perf_counter() + _WRITING_S)
        elif self._deadline_s == math.inf:
            self._deadline_s = time.perf_counter() + self._order.time_limit_s + GRACE_S
        return None

    def _died(self, code: int) -> Exception:
        """Why a process that closed its end without an answer did so."""
        if code == -signal.SIGKILL:
            return PlannerDiedError(
                f"the operating system ended the planner at: {self.doing}; most likely memory ran out"
            )
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        return RuntimeError(f"bug in the planner: it ended with {how} at: {self.doing}")

    def refused(self, reason: str) -> None:
        """End the process, and leave a ``plan.json`` with the reason and nothing of half a plan."""
        cpu_s = self.end()
        out = Path(self._order.out)
        for name in PLAN_FILES:
            (out / name).unlink(missing_ok=True)
        answer = {
            **refusal(reason, self._order.seed, self._control_steps),
            "cpu_s": cpu_s,
            "wall_s": self.elapsed_s,
            "scene": self._order.scene,
            "joint": self._order.joint,
            "target": self._order.target,
            "arm": self._order.arm,
        }
        (out / "plan.json").write_text(json.dumps(answer, indent=1) + "\n")

    def end(self) -> float:
        """Make sure that the process is gone; the processor time it took [s]."""
        process = self._process
        if process is None:
            return 0.0
        if process.returncode is None:
            # Not Popen.kill: that takes leave of one that has just ended, and of its processor time.
            os.kill(process.pid, signal.SIGKILL)
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            self._cpu_s = usage.ru_utime + usage.ru_stime
        if process.stdout is not None:
            process.stdout.close()
        return self._cpu_s


def refusal(reason: str, seed: int, control_steps: int) -> dict[str, Any]:
    """``plan.json`` without a plan, as far as it says the same whoever refuses."""
    return {
        "success": False,
        "held": False,
        "final": None,
        "error": None,
        "control_steps": control_steps,
        "cpu_s": 0.0,
        "wall_s": 0.0,
        "seed": seed,
        "reason": reason,
    }
