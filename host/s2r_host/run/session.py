"""One arm, one camera, one recording: everything a stage needs to look and to move."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType

import numpy as np

from s2r_host.errors import CommandRefusedError, PeerUnreachableError, RecordingError
from s2r_host.link import CameraLink, Capture, ExecutorLink, ExecutorStatus, Verdict
from s2r_host.link_types import MOVING
from s2r_host.motion.arm_model import ArmModel
from s2r_host.recording import RunRecorder
from s2r_host.run.journal import Journal
from s2r_host.run.settings import RunSettings
from s2r_host.trajectory import Trajectory
from s2r_protocol.arms import load_arm
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
    """Open links of one run."""

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
    rest: str = "nothing was moved"  # what the executor has confirmed of the arm's rest, in a phrase

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

        However that ends, the arm is at rest then as far as the executor can be reached, which :attr:`rest` tells, and
        the recordings of what was sent are kept; where a disk has no room for them, too, the first error counts.

        Raises:
            CommandRefusedError, ArmStoppedError, PeerUnreachableError: As :meth:`move`, and what ``commands`` raises.
            RuntimeError: In a dry run, before anything is sent: whoever asked for a motion there has a bug.
        """
        if self.settings.dry_run:
            raise RuntimeError("a motion was asked for in a dry run; nothing was sent")
        sent: list[Sent] = []
        done: list[Executed] = []
        through = False
        self.rest = "that the arm is at rest was not confirmed: look at it"
        try:
            with self.link.leased():
                self.link.arm_drives()
                commands(sent)
            self.rest, through = "the arm is at rest", True
        except BaseException:
            self._ask_for_rest()
            raise
        finally:
            done.extend(self._fetch(entry, through) for entry in sent)
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

    def _ask_for_rest(self) -> None:
        """Whether the arm is at rest after a move that failed; silence is only warned about, the first error counts."""
        try:
            status = self.link.status()
        except PeerUnreachableError as error:
            self.journal.warn(f"{self.rest}; {error}")
            return
        told = f"{status.state.name}, {status.cause.name}"
        if status.state in MOVING and status.lease_holder not in ("", self.link.name):
            self.rest = (
                f"the arm moves for '{status.lease_holder}', another host, which holds the lease ({told})"
            )
            self.journal.warn(self.rest)
        elif status.state in MOVING:
            self.rest = f"the arm still moves ({told}): look at it"
            self.journal.warn(self.rest)
        else:
            self.rest = f"the arm is at rest ({told})"
            self.journal.say(self.rest)

    def _fetch(self, sent: Sent, through: bool) -> Executed:
        recording, motion = None, sent.motion
        try:
            recording = self.link.recording(sent.seq)
            self.recorder.add_recording(recording)
        except (CommandRefusedError, PeerUnreachableError, RecordingError) as error:
            recording = None  # half of one is none: what is felt would be learnt from half a motion
            self.journal.warn(f"no executor recording of '{motion.label}': {error}")
        except OSError as error:  # no room on the disk
            if through:
                raise
            self.journal.warn(f"the executor's recording of '{motion.label}' is not kept: {error}")
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
        """Close recording and links, each whatever becomes of the others."""
        with ExitStack() as last_first:
            last_first.callback(self.camera.close)
            last_first.callback(self.link.close)
            last_first.callback(self.recorder.close)

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except OSError as closing:  # no room on the disk: why the run ended before counts
            if error is None:
                raise
            self.journal.warn(f"the run's recording was not finished: {closing}")


def open_session(settings: RunSettings, journal: Journal) -> Session:
    """Connect to executor and camera and start the recording.

    Raises:
        PeerUnreachableError: Executor absent.
        ArmMismatchError: Wrong model or limits.
    """
    arm = load_arm(settings.arm)
    keys = ArmKeys(settings.cell, arm.name)
    with ExitStack() as opened:  # what is open already is closed where the next fails
        link = opened.enter_context(ExecutorLink(settings.executor, arm, keys, tls=settings.tls))
        settings.out.mkdir(parents=True, exist_ok=True)
        facts = {
            "seed": str(settings.seed),
            "target": "asked for" if settings.target is None else repr(settings.target),
            "software": link.identity.software,
        }
        recorder = opened.enter_context(
            RunRecorder(
                settings.out / "run.mcap",
                f"/{keys.base}",
                arm.joint_names,
                arm,
                facts,
                arm_stamp_ns=lambda: sample.stamp_ns if (sample := link.joints()) else None,
            )
        )
        camera = opened.enter_context(CameraLink(settings.camera, keys, tls=settings.tls))
        session = Session(
            settings=settings,
            journal=journal,
            arm=ArmModel(arm),
            link=link,
            camera=camera,
            recorder=recorder,
            rng=np.random.default_rng(settings.seed),
        )
        journal.on_stage = recorder.add_stage
        opened.pop_all()
    return session
