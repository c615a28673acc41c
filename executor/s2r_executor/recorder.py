"""The front end's face of the recorder: feeds the writing process, never waits for it.

Whatever happens to disk or writer never reaches the loop: the core drops records when its ring is full, the front
end drops batches when the queue to the writer is full, the writer drops what the disk does not take. All of it is
counted in :class:`RecordingLoss`.
"""

from __future__ import annotations

import logging
import os
import queue
import socket
import subprocess
import threading
import time
from collections import OrderedDict
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from s2r_executor.config import RecorderConfig
from s2r_executor.observations import Encoder
from s2r_executor.recorder_wire import Batch, Frame, PlanIdentity, batch_frame, receive, send
from s2r_executor.writer_settings import WriterSettings, command_line
from s2r_protocol.arms import ArmDescription
from s2r_protocol.faults import NOTHING_RECORDED

__all__ = ["PlanIdentity", "Recorder", "RecordingAnswer", "RecordingLoss"]

logger = logging.getLogger(__name__)

_QUEUE_BATCHES = 4096
_CLOSE_TIMEOUT_S = 20.0
_KILLED_WITHIN_S = 2.0
_RESTART_S = 1.0
_KEPT_ANSWERS = 4096
_RECOVER = "what was written can be mended with 's2r log recover'"


@dataclass(frozen=True)
class RecordingAnswer:
    """What to answer to a request; ``path`` is set once the file is complete."""

    complete: bool
    reason: str = ""
    path: Path | None = None


@dataclass(frozen=True)
class RecordingLoss:
    """Ticks that are in no file, and why; ``reason`` is empty while everything is written."""

    ticks: int
    reason: str


@dataclass
class _State:
    """What other threads may ask about, guarded by one lock."""

    # By plan number, oldest first.
    answers: OrderedDict[int, RecordingAnswer] = field(default_factory=OrderedDict)
    session_path: Path | None = None
    dropped_ticks: int = 0  # never reached the writer
    lost_ticks: int = 0  # reached it, but not the disk
    reason: str = ""

    def remember(self, seq: int, answer: RecordingAnswer) -> None:
        """The newest word on a plan's recording; those spoken of longest ago are forgotten."""
        self.answers[seq] = answer
        self.answers.move_to_end(seq)
        if len(self.answers) > _KEPT_ANSWERS:
            self.answers.popitem(last=False)


class Recorder:
    """Feeds a writing process; without a directory it only answers that there are no recordings."""

    def __init__(
        self,
        directory: Path | None,
        arm: ArmDescription,
        namespace: str,
        encoder: Encoder,
        config: RecorderConfig,
        facts: dict[str, str],
        publish_period_s: float = 0.01,
    ) -> None:
        """Start the writing process.

        Args:
            directory: For the files; made if missing. None = record nothing.
            arm: Attached to every file.
            namespace: Of the topics.
            encoder: Tells tick and clock; the writer packs messages with one like it.
            config: Chunk size, and the most a crash may cost [s].
            facts: Named values for every file: hashes, boot id, bus, clock.
            publish_period_s: Spacing of joint states in the session file.
        """
        self._lock = threading.Lock()
        self._state = _State()
        self._queue: queue.Queue[Frame | None] = queue.Queue(_QUEUE_BATCHES)
        self._given_up = threading.Event()  # the writer was killed at the end: no other one is started
        self._thread: threading.Thread | None = None
        self._process: subprocess.Popen[bytes] | None = None
        if directory is None:
            return
        timeline = encoder.timeline
        self._settings = WriterSettings(
            directory=str(directory.absolute()),
            arm=str(arm.directory),
            namespace=namespace,
            offset_ns=timeline.offset_ns,
            tick_ns=timeline.tick_ns,
            stepped=timeline.stepped,
            chunk_bytes=config.chunk_bytes,
            flush_period_s=config.flush_period_s,
            publish_period_s=publish_period_s,
            facts=facts,
        )
        self._connection = self._start_writer()
        self._thread = threading.Thread(target=self._send_all, name="s2r-recorder", daemon=True)
        self._thread.start()

    @property
    def session_path(self) -> Path | None:
        """The newest session file; None before the writer has opened it."""
        with self._lock:
            return self._state.session_path

    @property
    def writer_pid(self) -> int | None:
        """Process id of the writer, None without one."""
        return self._process.pid if self._process is not None else None

    @property
    def loss(self) -> RecordingLoss:
        """What is in no file so far."""
        with self._lock:
            return RecordingLoss(self._state.dropped_ticks + self._state.lost_ticks, self._state.reason)

    # -- called by the front end ----------------------------------------------------------------------

    def open_plan(self, identity: PlanIdentity, wire: bytes) -> None:
        """Announce a plan before it is sent to the core; ``wire`` are the bytes as received."""
        if self._thread is None:
            return
        with self._lock:
            self._state.remember(identity.seq, RecordingAnswer(False))
        self._put(Frame({"kind": "plan", "identity": asdict(identity)}, wire))

    def drop_plan(self, plan_id: int, reason: str) -> None:
        """The announced plan never ran."""
        logger.info("no recording of plan id %d: %s", plan_id, reason)
        self._put(Frame({"kind": "drop", "plan_id": plan_id}))

    def feed(self, records: np.ndarray, events: np.ndarray, holder: str) -> None:
        """Queue records and events; never blocks."""
        if self._thread is not None:
            self._put(batch_frame(Batch(records, events, holder)))

    def answer(self, plan_seq: int) -> RecordingAnswer:
        """Whether and where there is a recording of the newest plan with this number."""
        if self._thread is None:
            return RecordingAnswer(False, NOTHING_RECORDED)
        with self._lock:
            known = self._state.answers.get(plan_seq)
        never = f"no plan {plan_seq} is among the last {_KEPT_ANSWERS} since the executor started"
        return known or RecordingAnswer(False, never)

    def close(self) -> None:
        """Finish all files and end the writer; one that hangs is killed first."""
        if self._thread is None:
            return
        if not self._finish(time.monotonic() + _CLOSE_TIMEOUT_S):
            logger.error("recorder did not finish within %.0f s and is ended; %s", _CLOSE_TIMEOUT_S, _RECOVER)
            self._end_writer()
        self._listener.join(_KILLED_WITHIN_S)
        self._connection.close()
        self._thread = None

    def _finish(self, until_s: float) -> bool:
        """Let the writer take everything and end; False if it has not by then (monotonic clock)."""
        assert self._thread is not None
        assert self._process is not None
        try:
            self._queue.put(None, timeout=_left(until_s))
            self._thread.join(_left(until_s))
            self._process.wait(_left(until_s))
        except (queue.Full, subprocess.TimeoutExpired):
            return False
        return True

    def _end_writer(self) -> None:
        """Kill the writer: a send that waits for it ends as well, and the rest of the queue is dropped."""
        assert self._thread is not None
        assert self._process is not None
        self._given_up.set()
        self._process.kill()
        try:
            self._connection.shutdown(socket.SHUT_RDWR)  # a process in a disk's hands outlives its kill
        except OSError:
            logger.debug("the connection to the recorder had ended")
        try:
            self._queue.put(None, timeout=_KILLED_WITHIN_S)
            self._thread.join(_KILLED_WITHIN_S)
            self._process.wait(_KILLED_WITHIN_S)
        except (queue.Full, subprocess.TimeoutExpired):
            logger.error("the recorder's process hangs in the kernel and is left behind; is the disk gone?")

    def _put(self, frame: Frame) -> None:
        if self._thread is None:
            return
        try:
            self._queue.put_nowait(frame)
        except queue.Full:
            self._drop(frame, "the writer cannot keep up")

    def _drop(self, frame: Frame, reason: str) -> None:
        with self._lock:
            first = not self._state.reason
            self._state.dropped_ticks += int(frame.head.get("ticks", 0))
            self._state.reason = reason
        if first:
            logger.error("recordings have a hole: %s; motion goes on", reason)

    # -- the writer -------------------------------------------------------------------------------------

    def _start_writer(self) -> socket.socket:
        ours, theirs = socket.socketpair()
        with theirs:
            descriptor = theirs.fileno()
            os.set_inheritable(descriptor, True)
            self._process = subprocess.Popen(
                command_line(self._settings, descriptor), pass_fds=(descriptor,), stdin=subprocess.DEVNULL
            )
        self._listener = threading.Thread(
            target=self._listen, args=(ours,), name="s2r-recorder-answers", daemon=True
        )
        self._listener.start()
        return ours

    def _send_all(self) -> None:
        broken_at_s: float | None = None
        while (frame := self._queue.get()) is not None:
            waited = broken_at_s is not None and time.monotonic() - broken_at_s > _RESTART_S
            if waited and not self._given_up.is_set():
                broken_at_s = None if self._restarted() else time.monotonic()
            if broken_at_s is None:
                try:
                    send(self._connection, frame)
                    continue
                except OSError:
                    broken_at_s = time.monotonic()
                    self._writer_died()
            self._drop(frame, "the writing process died and is started again")
        try:
            self._connection.shutdown(socket.SHUT_WR)
        except OSError:
            logger.warning("the recorder's process had ended before the end; %s", _RECOVER)

    def _restarted(self) -> bool:
        try:
            self._connection = self._start_writer()
        except OSError as error:  # what took the last one, such as a lack of memory, may last
            logger.error("the recorder's process cannot be started yet: %s", error)
            return False
        return True

    def _writer_died(self) -> None:
        assert self._process is not None
        code = self._process.wait()
        self._connection.close()
        logger.error("the recorder's process ended with %d; motion goes on, %s", code, _RECOVER)
        with self._lock:
            for seq, known in self._state.answers.items():
                if not known.complete:
                    reason = f"the recorder's process died; {_RECOVER}"
                    self._state.answers[seq] = RecordingAnswer(False, reason)

    def _listen(self, connection: socket.socket) -> None:
        try:
            while (frame := receive(connection)) is not None:
                self._note(frame.head)
        except OSError:  # the sending side has noticed as well, and acts
            logger.debug("the recorder's answers ended")

    def _note(self, said: dict) -> None:
        with self._lock:
            state = self._state
            match said["kind"]:
                case "answer":
                    path = Path(said["path"]) if said.get("path") else None
                    known = RecordingAnswer(path is not None, said.get("reason", ""), path)
                    state.remember(int(said["seq"]), known)
                case "session":
                    state.session_path, state.reason = Path(said["path"]), ""
                case "health":
                    state.lost_ticks = int(said["lost_ticks"])
                case "failed":
                    state.lost_ticks, state.reason = int(said["lost_ticks"]), said["reason"]
                    for seq, answer in state.answers.items():
                        if not answer.complete:
                            state.answers[seq] = RecordingAnswer(False, f"not recorded: {said['reason']}")
        if said["kind"] == "failed":
            logger.error("recording failed: %s; motion goes on without it", said["reason"])


def _left(until_s: float) -> float:
    """Time left on the monotonic clock [s]."""
    return max(0.0, until_s - time.monotonic())
