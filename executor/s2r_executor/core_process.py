"""Starting, watching and ending the native core's process ``s2r-rt``."""

from __future__ import annotations

import logging
import signal
import subprocess
import time
from importlib import util
from pathlib import Path
from typing import IO, Any

from s2r_executor.config import ExecutorConfig
from s2r_executor.core import QUIT, Core
from s2r_executor.stalls import Patience
from s2r_protocol.arms import ArmDescription
from s2r_protocol.arms.bus_range import off_bus
from s2r_protocol.exits import ExitCode, NotReadyError, S2RError, UnreachableError, UsageError
from s2r_protocol.faults import ExecutorState
from s2r_protocol.machine.cpus import first_isolated

logger = logging.getLogger(__name__)

_START_TIMEOUT_S = 10.0
_END_S = 1.0  # for the last setpoints and the end of the process, once the drives are off
_SAY_AFTER_S = 2.0  # what an end takes that has nothing to wait for
_EXECUTABLE = "s2r-rt"


class CoreDiedError(S2RError, RuntimeError):
    """The core's process ended by itself; the drives stop by their own watchdogs."""

    exit_code = ExitCode.PROTECTION


class CoreEndedError(CoreDiedError):
    """It was told to end by somebody else than its front end and did so in order."""


class BusUnreachableError(UnreachableError):
    """The core could not open the bus."""


def native_executable() -> Path:
    """Path of ``s2r-rt``.

    Raises:
        NotReadyError: The native parts are not built; the text says how.
    """
    # Built parts lie together, in an editable install apart from the Python sources.
    module = util.find_spec("s2r_executor._native")
    if module is not None and module.origin is not None:
        executable = Path(module.origin).with_name(_EXECUTABLE)
        if executable.is_file():
            return executable
    raise NotReadyError(
        f"the executor's native parts (_native and {_EXECUTABLE}) are not built: "
        "run 'make build' (or reinstall sim2real2)"
    )


def told_exit(code: int) -> str:
    """A process's exit code in words; a negative one is the signal that ended it."""
    if code >= 0:
        return f"exit {code}"
    known = -code in signal.Signals._value2member_map_
    return f"killed by {signal.Signals(-code).name if known else f'signal {-code}'}"


def core_settings(config: ExecutorConfig, arm: ArmDescription) -> dict[str, Any]:
    """The native core's configuration; every key is checked again there."""
    core = config.core
    cpu = first_isolated() if core.cpu is None else core.cpu
    limits = arm.limits
    return {
        "dof": arm.dof,
        "tick_ns": config.tick_ns,
        "packing": config.packing,
        "bus": config.bus,
        "clock": config.clock,
        "pace": config.pace,
        **limits.as_dict(),
        "gate_margin": core.gate_margin,
        "path_tolerance_rad": core.path_tolerance_rad,
        "goal_tolerance_rad": core.goal_tolerance_rad,
        "goal_timeout_s": core.goal_timeout_s,
        "feedback_warn_ticks": core.feedback_warn_ticks,
        "feedback_stop_ticks": core.feedback_stop_ticks,
        "feedback_fault_ticks": core.feedback_fault_ticks,
        "front_end_timeout_s": config.effective_front_end_timeout_s,
        "answer_timeout_s": core.answer_timeout_s,
        "arming_timeout_s": core.arming_timeout_s,
        "quit_timeout_s": config.longest_stop_s + _END_S,
        "realtime_priority": core.realtime_priority,
        "cpu": -1 if cpu is None else cpu,
        "allow_not_realtime": config.allow_not_realtime or config.is_stand_in,
        "record_capacity": core.record_capacity,
        "following_rest_share": core.following_rest_share,
        "frozen_rad": core.frozen_rad,
        "collision_share": core.collision_share,
        "collision_ticks": core.collision_ticks,
        "temperature_warn_C": core.temperature_warn_C,
        "temperature_stop_C": core.temperature_stop_C,
        "warning_speed": core.warning_speed,
        "brake_feedback": core.brake_feedback,
        "brake_timeout_s": core.brake_timeout_s,
        "estop_discrepancy_s": core.estop_discrepancy_s,
    }


def _check_bus_range(arm: ArmDescription) -> None:
    """Refuse an arm that the core would refuse, all at once and in the arm's words.

    Raises:
        UsageError: Names every limit that the bus cannot carry.
    """
    problems = [f"{found.text}; {found.fix}" for found in off_bus(arm)]
    if problems:
        raise UsageError(
            f"{arm.directory}: the bus cannot carry this arm (see 's2r doctor --arm'):\n  "
            + "\n  ".join(problems)
        )


class CoreProcess:
    """Owns the shared memory and the child process.

    Attributes:
        core: Commands in, state and records out.
    """

    def __init__(self, config: ExecutorConfig, arm: ArmDescription, log: IO[str] | None = None) -> None:
        """Start the process and wait until it runs.

        Args:
            config: Of the executor.
            arm: What it moves.
            log: Where the core's text output goes; by default it is captured for error messages.

        Raises:
            NotReadyError: The native parts are missing.
            UsageError: The bus cannot carry the arm's limits, or the core refused its configuration.
            BusUnreachableError: It could not open the bus.
        """
        executable = native_executable()
        _check_bus_range(arm)
        from s2r_executor import _native  # built later than this file is read

        self._bus = config.bus
        self._stepped = config.clock == "lockstep"
        self._quit_within_s = config.longest_stop_s + _END_S
        try:
            shared = _native.Shared.create(core_settings(config, arm))
        except ValueError as error:
            raise UsageError(f"the real-time core refused its configuration: {error}") from error
        self.core: Core = shared
        # A session of its own: Ctrl-C in the terminal reaches only the front end, which then stops the arm on its path.
        self._process = subprocess.Popen(
            [str(executable), "--shm-fd", str(shared.fd)],
            pass_fds=(shared.fd,),
            stdin=subprocess.DEVNULL,
            stdout=log or subprocess.DEVNULL,
            stderr=log or subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            self._wait_alive()
        except BaseException:
            self.kill()
            raise

    @property
    def pid(self) -> int:
        """Process id of the core."""
        return self._process.pid

    def _wait_alive(self) -> None:
        deadline = time.monotonic() + _START_TIMEOUT_S
        while not self.core.snapshot().alive:
            self.core.beat()
            code = self._process.poll()
            if code is not None:
                raise self._ended(code, f"at start on bus {self._bus}")
            if time.monotonic() > deadline:
                raise CoreDiedError(f"the real-time core did not come up within {_START_TIMEOUT_S:g} s")
            time.sleep(0.005)

    def _ended(self, code: int, how: str) -> S2RError:
        """The error for an exit code of ``s2r-rt``: 2 usage, 3 machine not ready, 5 bus absent or closed."""
        said = self._said() or (
            "look for who did that; the kernel does when memory is short" if code < 0 else "it said nothing"
        )
        text = f"the real-time core ended {how} ({told_exit(code)}): {said}"
        if code == ExitCode.UNREACHABLE:
            return BusUnreachableError(
                f"{text}. Is the arm or its stand-in ('s2r sim-arm') running on {self._bus}? Executor and stand-in "
                "need the same --bus, --packing and --clock"
            )
        if code == ExitCode.NOT_READY:
            return NotReadyError(text)
        if code == ExitCode.USAGE:
            return UsageError(text)
        return CoreDiedError(text)

    def _said(self) -> str:
        if self._process.stderr is None:
            return ""
        return " ".join(self._process.stderr.read().split())

    def check(self) -> None:
        """Look after the process.

        Raises:
            CoreEndedError: A signal told it to end, and it has brought the arm to rest and switched the drives off.
            CoreDiedError: It ended by itself.
        """
        code = self._process.poll()
        if code == ExitCode.OK:
            raise CoreEndedError(
                f"the real-time core ended in order ({told_exit(code)}), but not for this executor: somebody sent it a "
                "signal. Start the executor again"
            )
        if code is not None:
            raise self._ended(code, "by itself; the drives stop by their own watchdogs")

    def quit(self, timeout_s: float | None = None) -> int:
        """Ask the core to stop on the path and end, and wait; kill it if it does not. Returns its exit code.

        Args:
            timeout_s: Time for that [s]; None: what the configuration allows a stop to take, and a second.
        """
        limit_s = self._quit_within_s if timeout_s is None else timeout_s
        if self._process.poll() is None:
            core = self.core.snapshot()
            self.core.command(QUIT, core.epoch)
            if core.state == ExecutorState.DISARMED:
                self._process.terminate()  # heard also while it waits for drives that never answer
            began_s, said = time.monotonic(), False
            patience = Patience(limit_s, self._stepped, core.tick, began_s)
            while self._process.poll() is None and not patience.ended(self.core.snapshot(), time.monotonic()):
                self.core.beat()
                time.sleep(0.005)
                if not said and time.monotonic() - began_s > _SAY_AFTER_S:
                    said = True
                    logger.info(
                        "waiting for the real-time core to bring the arm to rest (it is %s), at most %.0f s",
                        ExecutorState(self.core.snapshot().state).name,
                        limit_s,
                    )
        if self._process.poll() is None:
            logger.error("the real-time core did not end within %.1f s and is killed", limit_s)
            self.kill()
        return self._process.returncode

    def kill(self) -> None:
        """End the process at once; the drives stop by their own watchdogs."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
