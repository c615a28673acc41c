"""One arm, one camera, one recording: everything a stage needs to look and to move."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import TracebackType

import numpy as np

from s2r_host.errors import CommandRefusedError, PeerUnreachableError, RecordingError
from s2r_host.link import CameraLink, Capture, ExecutorLink, ExecutorStatus, Verdict
from s2r_host.motion.arm_model import ArmModel
from s2r_host.recording import RunRecorder
from s2r_host.run.journal import Journal
from s2r_host.run.settings import RunSettings
from s2r_host.trajectory import Trajectory
from s2r_protocol.arms import load_arm
from s2r_protocol.faults import Cause
from s2r_protocol.keys import ArmKeys

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Motion:
    """A timed motion.

    Attributes:
        trajectory: Itself.
        label: What it is called in recordings.
        free_from: Share of its time from which on it is to touch nothing: its joint torques are the arm's own then.
    """

    trajectory: Trajectory
    label: str
    free_from: float = 1.0


@dataclass(frozen=True, eq=False)
class Executed:
    """A motion that was carried out.

    Attributes:
        label: E.g. "push 1".
        trajectory: What was sent.
        seq: The executor's number of it.
        tick_start: Executor tick just before it was sent.
        begun_s, wall_s: When it was sent, since the run began, and how long it took on the wall clock.
        recording: The executor's MCAP, None when it has none.
        free_from: Share of its time from which on it touched nothing.
    """

    label: str
    trajectory: Trajectory
    seq: int
    tick_start: int
    begun_s: float
    wall_s: float
    recording: bytes | None
    free_from: float = 1.0


@dataclass
class Sent:
    """A motion under way."""

    motion: Motion
    seq: int
    tick_start: int
    begun_s: float
    wall_s: float = 0.0
    went_through: bool = False


@dataclass
class Session:
    """Open links of one run. Leaving it stops nothing: a stop is a decision, see :meth:`stop_now`."""

    settings: RunSettings
    journal: Journal
    arm: ArmModel
    link: ExecutorLink
    camera: CameraLink
    recorder: RunRecorder
    rng: np.random.Generator
    executed: list[Executed] = field(default_factory=list)
    target: float = (
        math.nan
    )  # joint value in force [m or rad], counted as the belief's; told before it is planned for
    pace: float = 1.0  # share of the usual speed at which plans move the part, which is to be felt at several

    def look(self, name: str) -> Capture:
        """Take a picture and keep it."""
        time.sleep(self.settings.settle_s)
        capture = self.camera.capture(self.settings.camera_name)
        self.recorder.add_capture(name, capture)
        return capture

    def status(self) -> ExecutorStatus:
        """The executor's state."""
        return self.link.status()

    def move(self, motions: Sequence[Motion]) -> list[Executed]:
        """Carry out motions one after the other, each through admission, and keep their recordings.

        The lease is held only meanwhile: computing between motions must not starve the heartbeat.

        Raises:
            CommandRefusedError: Lease or plan refused.
            ArmStoppedError: A motion was stopped.
            PeerUnreachableError: The executor fell silent.
        """
        return self.play(lambda sent: self._play_all(motions, sent))

    def play(self, commands: Callable[[list[Sent]], None]) -> list[Executed]:
        """Hold the lease with drives on while ``commands`` moves the arm; it notes what it sent, see :meth:`note_sent`.

        However that ends, the arm is at rest then, and the recordings of what was sent are kept.

        Raises:
            CommandRefusedError, ArmStoppedError, PeerUnreachableError: As :meth:`move`, and what ``commands`` raises.
        """
        sent: list[Sent] = []
        done: list[Executed] = []
        try:
            with self.link.leased():
                try:
                    self.link.arm_drives()
                    commands(sent)
                except BaseException:
                    self._rest_quietly()  # while the lease still holds: its end would stop the arm as "host lost"
                    raise
        finally:
            done.extend(self._fetch(entry) for entry in sent)
            self.executed.extend(done)
        return done

    def note_sent(self, motion: Motion, verdict: Verdict, tick: int) -> Sent:
        """Keep a plan that was admitted at some executor tick."""
        self.journal.verdict(motion.label, verdict.seq, verdict.duration_s)
        self.recorder.add_plan(motion.trajectory, motion.label, verdict.seq)
        return Sent(motion, verdict.seq, tick, self.journal.elapsed_s)

    def _play_all(self, motions: Sequence[Motion], sent: list[Sent]) -> None:
        for motion in motions:
            tick = self.status().tick
            verdict = self.link.send_plan(motion.trajectory, motion.label)
            under_way = self.note_sent(motion, verdict, tick)
            sent.append(under_way)
            try:
                self.link.wait_done(verdict)
                under_way.went_through = True
            finally:
                under_way.wall_s = self.journal.elapsed_s - under_way.begun_s

    def _rest_quietly(self) -> None:
        """Stop and wait for rest; what cannot be reached any more is only warned about, the first error counts."""
        try:
            self.stop_now()
        except (CommandRefusedError, PeerUnreachableError) as error:
            self.journal.warn(f"the stop was not confirmed: {error}")

    def stop_now(self) -> None:
        """Ask for a stop and wait until the arm is at rest."""
        self.link.stop()
        status = self.link.wait_at_rest()
        self.journal.say(f"arm is at rest: {status.state.name}, {Cause(status.cause).name}")

    def _fetch(self, sent: Sent) -> Executed:
        recording, motion = None, sent.motion
        try:
            recording = self.link.recording(sent.seq)
            self.recorder.add_recording(recording)
        except (CommandRefusedError, PeerUnreachableError, RecordingError) as error:
            self.journal.warn(f"no executor recording of '{motion.label}': {error}")
        return Executed(
            motion.label,
            motion.trajectory,
            sent.seq,
            sent.tick_start,
            sent.begun_s,
            sent.wall_s,
            recording,
            motion.free_from if sent.went_through else 1.0,
        )

    def close(self) -> None:
        """Close links and recording."""
        self.recorder.close()
        self.link.close()
        self.camera.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_session(settings: RunSettings, journal: Journal) -> Session:
    """Connect to executor and camera and start the recording.

    Raises:
        PeerUnreachableError: Executor absent.
        ArmMismatchError: Wrong model or limits.
    """
    arm = load_arm(settings.arm)
    keys = ArmKeys(settings.cell, arm.name)
    link = ExecutorLink(settings.executor, arm, keys, tls=settings.tls)
    settings.out.mkdir(parents=True, exist_ok=True)
    facts = {
        "seed": str(settings.seed),
        "target": "asked for" if settings.target is None else repr(settings.target),
        "software": link.identity.software,
    }
    recorder = RunRecorder(settings.out / "run.mcap", f"/{keys.base}", arm.joint_names, arm, facts)
    journal.on_stage = recorder.add_stage
    return Session(
        settings=settings,
        journal=journal,
        arm=ArmModel(arm),
        link=link,
        camera=CameraLink(settings.camera, keys, tls=settings.tls),
        recorder=recorder,
        rng=np.random.default_rng(settings.seed),
    )
