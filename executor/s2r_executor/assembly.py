"""Puts one executor together: core process, recorder, front end, bridge and the watch loop."""

from __future__ import annotations

import logging
import threading
import time
from contextlib import ExitStack
from types import TracebackType

from s2r_executor.bridge import Bridge, software_name
from s2r_executor.commission_record import check_record
from s2r_executor.config import ExecutorConfig
from s2r_executor.core_process import CoreProcess, told_exit
from s2r_executor.front_end import FrontEnd
from s2r_executor.observations import Encoder, Timeline
from s2r_executor.one_master import OneMaster
from s2r_executor.preflight import after_start, run_preflight
from s2r_executor.recorder import Recorder
from s2r_executor.status import describe_silence, silent_joints
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import NotReadyError
from s2r_protocol.faults import ExecutorState
from s2r_protocol.keys import ArmKeys
from s2r_protocol.session.open import endpoint_for

logger = logging.getLogger(__name__)

_WATCH_PERIOD_S = 0.004
_SILENCE_S = 2.0  # drives that are switched on answer within milliseconds


class Executor:
    """A running executor; a context manager that leaves nothing behind."""

    def __init__(self, config: ExecutorConfig) -> None:
        """Start everything.

        Raises:
            NotReadyError: Native parts missing, address in use, a bus that has a master already, or a machine that must
                not drive this bus.
            UnreachableError: The bus cannot be opened.
        """
        self.config = config
        self.arm = load_arm(config.arm)
        self._ended = threading.Event()
        self._failure: BaseException | None = None
        self._watched_s = self._started_s = time.monotonic()
        self._heard = False
        for endpoint in config.listen:  # refused before anything is started
            endpoint_for(endpoint, config.tls is not None, "listen on")
        self.preflight = run_preflight(config)
        if config.commissioned is not None:
            check_record(config.commissioned, config, self.arm)
        elif not config.is_stand_in:
            logger.warning(
                "no 'commissioned' record is named: nobody has checked how these drives are set up"
            )
        with ExitStack() as undo:
            self._master = OneMaster(config.bus)
            undo.callback(self._master.close)
            self.process = CoreProcess(config, self.arm)
            undo.callback(self.process.kill)
            self.preflight = after_start(self.preflight, config, self.process.core.snapshot().realtime)
            self._assemble()
            undo.pop_all()

    def _assemble(self) -> None:
        config, arm = self.config, self.arm
        stepped = config.clock == "lockstep"
        offset_ns = time.time_ns() - (0 if stepped else time.monotonic_ns())
        encoder = Encoder(arm, Timeline(offset_ns, config.tick_ns, stepped))
        namespace = f"/{ArmKeys(config.cell, arm.name).base}"
        core = self.process.core
        # Beats must not pause while models are loaded below.
        self._watcher = threading.Thread(target=self._watch, name="s2r-watch", daemon=True)
        self.front_end: FrontEnd | None = None
        self.bridge: Bridge | None = None
        self._watcher.start()
        with ExitStack() as undo:  # nothing stays when an address is taken
            undo.callback(self._end_watch)
            self.recorder = Recorder(
                config.record,
                arm,
                namespace,
                encoder,
                config.recorder,
                {
                    "arm": arm.name,
                    "cell": config.cell,
                    "model_hash": arm.model_hash.hex(),
                    "limit_hash": arm.limit_hash.hex(),
                    "software": software_name(),
                    "bus": config.bus.partition(":")[0],
                    "packing": config.packing,
                    "clock": config.clock,
                    "tick_ns": str(config.tick_ns),
                },
                config.publish_period_s,
            )
            undo.callback(self.recorder.close)
            front_end = FrontEnd(arm, config, core, self.recorder, speed_cap=self.preflight.speed_cap)
            self.bridge = Bridge(front_end, encoder, config)
            self.front_end = front_end
            undo.pop_all()

    def _watch(self) -> None:
        """Beats, host watch, records. Its death is the front end's death: the core then stops the arm by itself."""
        while not self._ended.wait(_WATCH_PERIOD_S):
            self._watched_s = time.monotonic()
            front_end, bridge = self.front_end, self.bridge
            if front_end is None:
                self.process.core.beat()
                continue
            try:
                events = front_end.step()
                if bridge is not None and len(events):
                    bridge.publish_events(events)
            except Exception as error:
                logger.exception("the watch loop failed; the core stops the arm")
                self._failure = error
                return

    def _timing(self) -> str:
        """What holds the clock, and what this machine is good for: a cap on the speed holds in lock-step, too."""
        if self.config.clock == "lockstep":
            return f"time kept by the drives' answers, {self.preflight.line}"
        core = self.process.core.snapshot()
        lacks = "no FIFO priority, no memory lock or not the CPU that was asked for"
        on_cpu = f" on CPU {core.cpu}" if core.cpu >= 0 else ""
        if core.realtime:
            return f"real-time{on_cpu}, {self.preflight.line}"
        return f"not real-time{on_cpu} ({lacks}; see 's2r doctor'), {self.preflight.line}"

    def summary(self) -> str:
        """One line: arm, hashes, bus, state, real-time or not."""
        arm, config = self.arm, self.config
        core = self.process.core.snapshot()
        return (
            f"s2r executor ready: {config.cell}/{arm.name} model {arm.model_hash.hex()[:8]} "
            f"limits {arm.limit_hash.hex()[:8]}, bus {config.bus} ({config.packing}, {config.clock}, "
            f"load {core.bus_load_computed:.0%}), listening on {', '.join(config.listen)}, "
            f"{ExecutorState(core.state).name}, {self._timing()}"
        )

    def check(self) -> None:
        """Look after the parts; say once if the drives are silent.

        Raises:
            CoreEndedError: The core ended in order because a signal told it to.
            CoreDiedError: The core ended by itself.
            NotReadyError: The watch loop or the publishing thread failed.
        """
        self.process.check()
        if self.bridge is not None:
            self.bridge.check()
        if not self._heard:
            self._listen_for_drives()
        if self._failure is not None:
            raise NotReadyError(
                f"the executor's watch loop failed: {self._failure}; restart it"
            ) from self._failure

    def _listen_for_drives(self) -> None:
        silent = silent_joints(self.process.core.snapshot(), self.arm.joint_names)
        if silent and time.monotonic() - self._started_s < _SILENCE_S:
            return
        self._heard = True
        if silent:
            bus, packing = self.config.bus, self.config.packing
            logger.warning("%s (%s, with packing '%s')", describe_silence(silent), bus, packing)

    @property
    def watch_age_s(self) -> float:
        """Time since the watch loop last went round [s]."""
        return time.monotonic() - self._watched_s

    def status_line(self) -> str:
        """State and why the arm does not move, for the service manager."""
        if self.front_end is None:
            return "starting"
        status = self.front_end.status()
        return f"{status.state.name}: {status.why_not_moving}"

    def shut_down(self) -> bool:
        """Stop on the path and switch the drives off; False if the arm did not come to rest in time."""
        return self.front_end.shut_down() if self.front_end is not None else True

    def _end_watch(self) -> None:
        self._ended.set()
        self._watcher.join()

    def close(self) -> None:
        """Leave the network, end the core, finish the recordings."""
        if self.bridge is not None:
            self.bridge.close()
        code = self.process.quit()
        self._end_watch()
        if self.front_end is not None and self._failure is None:
            self.front_end.step()  # the last records and events
            self.front_end.close()
        self.recorder.close()
        self.front_end = self.bridge = None  # the shared memory must be free before the interpreter goes
        self._master.close()
        logger.info("real-time core ended (%s)", told_exit(code))

    def __enter__(self) -> Executor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
