"""The files of a recorder: a session file at the publishing rate and one file per plan at the tick rate."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from s2r_executor.mcap_file import McapFile
from s2r_executor.observations import EVENTS, JOINT_COMMANDS, JOINT_STATES, STATE, Encoder
from s2r_executor.recorder_wire import Batch, PlanIdentity
from s2r_protocol.arms import ArmDescription
from s2r_protocol.faults import ExecutorState

_TAIL_S = 0.2
_MOVING = np.array([ExecutorState.RUN, ExecutorState.PAUSED, ExecutorState.STOPPING, ExecutorState.STOP1])


@dataclass(frozen=True)
class FileSettings:
    """How files are cut: uncompressed chunk size, and spacing of joint states in the session file [s]."""

    chunk_bytes: int
    publish_period_s: float


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


class RecordingFiles:
    """Open files of one executor. Every method may raise OSError: what then happens is the caller's decision."""

    def __init__(
        self,
        directory: Path,
        arm: ArmDescription,
        namespace: str,
        encoder: Encoder,
        settings: FileSettings,
        facts: dict[str, str],
        completed: Callable[[PlanIdentity, Path | None], None],
    ) -> None:
        """Open the session file.

        Args:
            directory: For the files; made if missing.
            arm: Attached to every file.
            namespace: Of the topics.
            encoder: Packs the messages.
            settings: How files are cut.
            facts: Named values for every file: hashes, boot id, bus, clock.
            completed: Called with each finished plan file; without one for a plan that another overtook unplayed.
        """
        self._directory = directory
        self._arm = arm
        self._namespace = namespace
        self._encoder = encoder
        self._settings = settings
        self._facts = facts
        self._completed = completed
        tick_ns = encoder.timeline.tick_ns
        self._tail_ticks = max(1, round(_TAIL_S * 1e9 / tick_ns))
        self._stride = max(1, round(settings.publish_period_s * 1e9 / tick_ns))
        self._plans: dict[int, _PlanFile] = {}
        directory.mkdir(parents=True, exist_ok=True)
        stamp = time.strftime("%Y%m%d-%H%M%S", time.gmtime())
        self._session = _Track(self._new_file(_free_name(directory, f"session-{stamp}")))

    @property
    def session_path(self) -> Path:
        """The session file."""
        return self._session.file.path

    def open_plan(self, identity: PlanIdentity, wire: bytes) -> None:
        """Open the file of a plan that is announced; ``wire`` are the command's bytes as received.

        It begins with the plan's first tick, which also ends the file of the plan before: one that waits for its splice
        may begin much later, or never.
        """
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

    def discard(self, plan_id: int) -> PlanIdentity | None:
        """The announced plan never ran: its file goes. Returns whose it was."""
        plan = self._plans.pop(plan_id, None)
        if plan is None:
            return None
        plan.file.abandon()
        plan.file.path.unlink(missing_ok=True)
        return plan.identity

    def write(self, batch: Batch) -> None:
        """Add records and events to every open file."""
        if len(batch.records):
            self._write_records(self._session.file, batch.records[batch.records["tick"] % self._stride == 0])
            self._write_states(self._session, batch.records, batch.holder)
        next_begins = {i: _begin_of_a_later(plan.identity.plan_id, batch) for i, plan in self._plans.items()}
        for event in batch.events:  # before the records, whose end may close a plan's file
            stamp_ns, message = self._encoder.event(event)
            self._session.file.add(EVENTS, [stamp_ns], [message])
            for plan_id, plan in self._plans.items():
                end = next_begins[plan_id]
                if end is None or event["tick"] < batch.records["tick"][end]:
                    plan.file.add(EVENTS, [stamp_ns], [message])
        for plan_id, plan in list(self._plans.items()):
            self._write_plan(plan, batch, next_begins[plan_id])

    def flush(self) -> None:
        """Close the open chunks and hand everything to the kernel."""
        self._session.file.flush()
        for plan in self._plans.values():
            plan.file.flush()

    def finish(self) -> None:
        """Write all indexes and close."""
        for plan in list(self._plans.values()):
            self._end(plan)
        self._session.file.close()

    def abandon(self) -> None:
        """Close without an index after a failed write: what is on the disk stays and can be recovered."""
        for track in (self._session, *(plan.track for plan in self._plans.values())):
            track.file.abandon()
        self._plans.clear()

    def _new_file(self, path: Path) -> McapFile:
        file = McapFile(path, self._namespace, self._settings.chunk_bytes)
        file.describe("s2r", self._facts)
        file.attach(f"{self._arm.name}.urdf", "application/xml", self._arm.urdf.encode())
        file.attach(f"{self._arm.name}.xml", "application/xml", self._arm.mjcf.encode())
        file.attach("limits.yaml", "application/yaml", self._arm.limits_yaml.encode())
        if "config" in self._facts:
            file.attach("executor.json", "application/json", self._facts["config"].encode())
        return file

    def _write_plan(self, plan: _PlanFile, batch: Batch, next_begins: int | None) -> None:
        """Add a plan's records; ``next_begins`` is where in the batch a later one does, if so."""
        records = batch.records[:next_begins]
        if len(records) and not plan.started:
            own = records["plan_id"] == plan.identity.plan_id
            plan.started = bool(own.any())
            records = records[np.argmax(own) :]
        if len(records) and plan.started:
            self._write_motion(plan, records, batch.holder)
        if next_begins is not None and plan.identity.plan_id in self._plans:
            self._end(plan)

    def _write_motion(self, plan: _PlanFile, records: np.ndarray, holder: str) -> None:
        """Add records of a plan that has begun; its file ends a little after rest."""
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
        self._write_states(plan.track, records[:end], holder)
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

    def _end(self, plan: _PlanFile) -> None:
        """Finish a plan that began; one that did not never will."""
        if plan.started:
            self._finish(plan)
        else:
            self.discard(plan.identity.plan_id)
            self._completed(plan.identity, None)

    def _finish(self, plan: _PlanFile) -> None:
        plan.file.close()
        del self._plans[plan.identity.plan_id]
        self._completed(plan.identity, plan.file.path)


def _begin_of_a_later(plan_id: int, batch: Batch) -> int | None:
    """Index of the first record of a later plan; the core's numbers rise."""
    if not len(batch.records):
        return None
    later = np.nonzero(batch.records["plan_id"] > plan_id)[0]
    return int(later[0]) if len(later) else None


def _free_name(directory: Path, stem: str) -> Path:
    path = directory / f"{stem}.mcap"
    number = 2
    while path.exists():
        path = directory / f"{stem}-{number}.mcap"
        number += 1
    return path
