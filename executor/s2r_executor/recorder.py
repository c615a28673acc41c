"""The recorder: a session file at the publishing rate and one file per plan at the tick rate.

Whatever happens here never reaches the loop: the core drops records when its ring is full, the front end drops
batches when this thread's queue is full, and both count what they dropped.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from s2r_executor.config import RecorderConfig
from s2r_executor.mcap_file import McapFile
from s2r_executor.observations import EVENTS, JOINT_COMMANDS, JOINT_STATES, STATE, Encoder
from s2r_protocol.arms import ArmDescription
from s2r_protocol.faults import ExecutorState

logger = logging.getLogger(__name__)

_QUEUE_BATCHES = 4096
_TAIL_S = 0.2
_MOVING = np.array([ExecutorState.RUN, ExecutorState.PAUSED, ExecutorState.STOPPING, ExecutorState.STOP1])


@dataclass(frozen=True)
class PlanIdentity:
    """Which plan a recording is of: the core's number, the host's number, epoch, sender and label."""

    plan_id: int
    seq: int
    epoch: int
    sender: str
    label: str


@dataclass(frozen=True)
class RecordingAnswer:
    """What to answer to a request; ``path`` is set once the file is complete."""

    complete: bool
    reason: str = ""
    path: Path | None = None


@dataclass
class _Track:
    """A file and what its state messages need to know."""

    file: McapFile
    plan_seq: int = 0
    epoch: int = 0
    last_state: int = -1


@dataclass
class _PlanFile:
    identity: PlanIdentity
    track: _Track
    started: bool = False
    rest_ticks: int = 0

    @property
    def file(self) -> McapFile:
        return self.track.file


@dataclass(frozen=True)
class _Batch:
    records: np.ndarray
    events: np.ndarray
    holder: str


@dataclass
class _State:
    """What other threads may ask about, guarded by one lock."""

    answers: dict[int, RecordingAnswer] = field(default_factory=dict)
    batches_dropped: int = 0


class Recorder:
    """Writes recordings in its own thread; without a directory it only answers that there are none."""

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
        """Open the session file and start the thread.

        Args:
            directory: For the files; made if missing. None = record nothing.
            arm: Attached to every file.
            namespace: Of the topics.
            encoder: Packs the messages.
            config: Chunk sizes.
            facts: Named values for every file: hashes, boot id, bus, clock.
            publish_period_s: Spacing of joint states in the session file.
        """
        self._directory = directory
        self._arm = arm
        self._namespace = namespace
        self._encoder = encoder
        self._config = config
        self._facts = facts
        self._tail_ticks = max(1, round(_TAIL_S * 1e9 / encoder.timeline.tick_ns))
        self._stride = max(1, round(publish_period_s * 1e9 / encoder.timeline.tick_ns))
        self._queue: queue.Queue[_Batch | tuple[PlanIdentity, bytes] | int | None] = queue.Queue(
            _QUEUE_BATCHES
        )
        self._lock = threading.Lock()
        self._state = _State()
        self._plans: dict[int, _PlanFile] = {}
        self._session: _Track | None = None
        self._thread: threading.Thread | None = None
        if directory is not None:
            directory.mkdir(parents=True, exist_ok=True)
            stamp = time.strftime("%Y%m%d-%H%M%S", time.gmtime())
            self._session = _Track(self._new_file(_free_name(directory, f"session-{stamp}")))
            self._thread = threading.Thread(target=self._run, name="s2r-recorder", daemon=True)
            self._thread.start()

    @property
    def session_path(self) -> Path | None:
        """The session file."""
        return self._session.file.path if self._session else None

    @property
    def batches_dropped(self) -> int:
        """Batches lost because the disk was too slow."""
        with self._lock:
            return self._state.batches_dropped

    # -- called by the front end ----------------------------------------------------------------------

    def open_plan(self, identity: PlanIdentity, wire: bytes) -> None:
        """Announce a plan before it is sent to the core; ``wire`` are the bytes as received."""
        if self._thread is None:
            return
        with self._lock:
            self._state.answers[identity.seq] = RecordingAnswer(False)
        self._put((identity, wire))

    def drop_plan(self, plan_id: int, reason: str) -> None:
        """The announced plan never ran."""
        logger.info("no recording of plan id %d: %s", plan_id, reason)
        self._put(plan_id)

    def feed(self, records: np.ndarray, events: np.ndarray, holder: str) -> None:
        """Queue records and events; never blocks."""
        self._put(_Batch(records, events, holder))

    def answer(self, plan_seq: int) -> RecordingAnswer:
        """Whether and where there is a recording of the newest plan with this number."""
        if self._thread is None:
            return RecordingAnswer(False, "the executor records nothing; start it with --record DIR")
        with self._lock:
            known = self._state.answers.get(plan_seq)
        return known or RecordingAnswer(False, f"no plan {plan_seq} ran since the executor started")

    def close(self) -> None:
        """Finish all files and end the thread."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()
            self._thread = None

    def _put(self, item: _Batch | tuple[PlanIdentity, bytes] | int) -> None:
        if self._thread is None:
            return
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            with self._lock:
                self._state.batches_dropped += 1
                first = self._state.batches_dropped == 1
            if first:
                logger.error("recorder cannot keep up: dropping batches; is the disk full or stalled?")

    # -- the recorder's thread --------------------------------------------------------------------------

    def _run(self) -> None:
        last_flush_s = time.monotonic()
        while True:
            try:
                item = self._queue.get(timeout=self._config.flush_period_s)
            except queue.Empty:
                item = _Batch(np.empty(0), np.empty(0), "")
            try:
                if item is None:
                    self._finish_all()
                    return
                self._handle(item)
                if time.monotonic() - last_flush_s > self._config.flush_period_s:
                    last_flush_s = time.monotonic()
                    self._flush()
            except Exception:  # a full disk, above all: a recorder that fails must not stop an arm
                logger.exception("recording failed; motion goes on without it")
                self._give_up()
                return

    def _handle(self, item: _Batch | tuple[PlanIdentity, bytes] | int) -> None:
        if isinstance(item, int):
            self._discard(item)
        elif isinstance(item, tuple):
            self._open(*item)
        else:
            self._write(item)

    def _new_file(self, path: Path) -> McapFile:
        file = McapFile(path, self._namespace, self._config.chunk_bytes)
        file.describe("s2r", self._facts)
        file.attach(f"{self._arm.name}.urdf", "application/xml", self._arm.urdf.encode())
        file.attach("limits.yaml", "application/yaml", self._arm.limits_yaml.encode())
        return file

    def _open(self, identity: PlanIdentity, wire: bytes) -> None:
        assert self._directory is not None
        for other in list(self._plans.values()):
            self._finish(other)  # a new plan is about to begin: the old one's tail ends here
        file = self._new_file(_free_name(self._directory, f"plan-{identity.epoch}-{identity.seq}"))
        file.describe(
            "s2r.plan",
            {
                "seq": str(identity.seq),
                "epoch": str(identity.epoch),
                "plan_id": str(identity.plan_id),
                "sender": identity.sender,
                "label": identity.label,
            },
        )
        file.attach("plan.s2r", "application/octet-stream", wire)
        self._plans[identity.plan_id] = _PlanFile(identity, _Track(file, identity.seq, identity.epoch))

    def _discard(self, plan_id: int) -> None:
        plan = self._plans.pop(plan_id, None)
        if plan is None:
            return
        plan.file.close()
        plan.file.path.unlink()
        with self._lock:
            self._state.answers.pop(plan.identity.seq, None)

    def _write(self, batch: _Batch) -> None:
        assert self._session is not None
        if len(batch.records):
            self._write_records(self._session.file, batch.records[batch.records["tick"] % self._stride == 0])
            self._write_states(self._session, batch.records, batch.holder)
        for event in batch.events:  # before the records, whose end may close a plan's file
            stamp_ns, message = self._encoder.event(event)
            for file in (self._session.file, *(p.file for p in self._plans.values())):
                file.add(EVENTS, [stamp_ns], [message])
        for plan in list(self._plans.values()):
            self._write_plan(plan, batch)

    def _write_plan(self, plan: _PlanFile, batch: _Batch) -> None:
        records = batch.records
        if not len(records):
            return
        if not plan.started:
            begin = np.nonzero(records["plan_id"] == plan.identity.plan_id)[0]
            if not len(begin):
                return
            plan.started = True
            records = records[begin[0] :]
        still = ~np.isin(records["state"], _MOVING)
        # Rest counts from the last moving tick on; the recording ends a little after it.
        moving = np.nonzero(~still)[0]
        if len(moving):
            after = len(records) - 1 - moving[-1]
            end = min(len(records), moving[-1] + 1 + self._tail_ticks)
            plan.rest_ticks = after
        else:
            end = min(len(records), max(0, self._tail_ticks - plan.rest_ticks))
            plan.rest_ticks += len(records)
        self._write_records(plan.file, records[:end])
        self._write_states(plan.track, records[:end], batch.holder)
        if plan.rest_ticks >= self._tail_ticks:
            self._finish(plan)

    def _write_records(self, file: McapFile, records: np.ndarray) -> None:
        if not len(records):
            return
        stamps = self._encoder.timeline.of(records["tick"], records["stamp_ns"])
        listed = stamps.tolist()
        file.add(JOINT_STATES, listed, self._encoder.joint_states(records, stamps))
        file.add(JOINT_COMMANDS, listed, self._encoder.joint_commands(records, stamps))

    def _write_states(self, track: _Track, records: np.ndarray, holder: str) -> None:
        """At the publishing rate and at every change of state."""
        if not len(records):
            return
        states = records["state"].astype(int)
        changed = np.concatenate([[track.last_state], states[:-1]]) != states
        stamps = self._encoder.timeline.of(records["tick"], records["stamp_ns"])
        for i in np.nonzero(changed | (records["tick"] % self._stride == 0))[0]:
            stamp = int(stamps[i])
            message = self._encoder.recorded_state(records[i], stamp, track.plan_seq, track.epoch, holder)
            track.file.add(STATE, [stamp], [message])
        track.last_state = int(states[-1])

    def _finish(self, plan: _PlanFile) -> None:
        plan.file.close()
        del self._plans[plan.identity.plan_id]
        with self._lock:
            self._state.answers[plan.identity.seq] = RecordingAnswer(True, path=plan.file.path)

    def _flush(self) -> None:
        assert self._session is not None
        self._session.file.flush()
        for plan in self._plans.values():
            plan.file.flush()

    def _finish_all(self) -> None:
        for plan in list(self._plans.values()):
            self._finish(plan)
        if self._session is not None:
            self._session.file.close()

    def _give_up(self) -> None:
        reason = "the recorder failed: see the executor's log"
        with self._lock:
            for seq, known in self._state.answers.items():
                if not known.complete:
                    self._state.answers[seq] = RecordingAnswer(False, reason)


def _free_name(directory: Path, stem: str) -> Path:
    path = directory / f"{stem}.mcap"
    number = 2
    while path.exists():
        path = directory / f"{stem}-{number}.mcap"
        number += 1
    return path
