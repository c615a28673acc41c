"""A whole run on one concealed object, and the recordings of its joint that the gap tool gets.

The host's own code runs in one process against the stand-in's plant and camera as in ``fast_trials.py``: perception, a
first push, three planned manipulations at the paces of ``--learn-physics``. What the arm recorded and the host believed
is kept, so that the way from joint torques to recordings can be changed without another run.
"""

from __future__ import annotations

import pickle
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from fast_trials import DirectCamera, DirectLink, Discard, samples_in
from rich.console import Console

import s2r_host.run.feeling
import s2r_host.run.pipeline
from s2r_host.motion.arm_model import ArmModel
from s2r_host.object_names import JOINT
from s2r_host.proprioception.object_log import Touch
from s2r_host.proprioception.object_numbers import learn_numbers
from s2r_host.run.belief import Belief
from s2r_host.run.feeling import Feeling, felt_object
from s2r_host.run.journal import Journal
from s2r_host.run.session import Executed, Session
from s2r_host.run.settings import RunSettings
from s2r_host.run.task import TASKS
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import ExitCode
from s2r_sim.missing.cases import LEARNING
from s2r_sim.paper.trials import Trial
from s2r_sim.plant import Plant
from s2r_sim.sealed import host_seed

ARM = "xmate3pro"
KEPT = "run.pickle"


@dataclass(frozen=True, eq=False)
class Push:
    """A motion that pushed the part, as the host knew of it.

    Attributes:
        belief: With which it was felt.
        executed: How many motions had been carried out by then.
        pushed: Which of them it was.
        s_from, s_to: Joint value before and after, as measured by the camera [m or rad].
        forgotten: What was felt before counts no more: the joint had been told anew.
    """

    belief: Belief
    executed: int
    pushed: int
    s_from: float
    s_to: float
    forgotten: bool


@dataclass(frozen=True, eq=False)
class Run:
    """What the host knows of a run.

    Attributes:
        executed: All motions; their recordings are pickled samples.
        pushes: Those that were felt, in order.
        reason: How it ended.
    """

    executed: tuple[Executed, ...]
    pushes: tuple[Push, ...]
    reason: str


@dataclass
class WatchedFeeling(Feeling):
    """Keeps what it was asked."""

    pushes: list[Push] = field(default_factory=list)
    forgets: bool = False

    def feel(
        self, belief: Belief, executed: Sequence[Executed], pushed: Executed, s_from: float, s_to: float
    ) -> list[Touch]:
        """As the parent."""
        index = next(i for i, one in enumerate(executed) if one is pushed)
        self.pushes.append(Push(_unseen(belief), len(executed), index, s_from, s_to, self.forgets))
        self.forgets = False
        return super().feel(belief, executed, pushed, s_from, s_to)

    def forget_part(self) -> None:
        """As the parent."""
        self.forgets = True
        super().forget_part()


def _unseen(belief: Belief) -> Belief:
    """Without what the camera saw: 90 MB of points that no recording of the joint needs."""
    estimate = replace(belief.estimate, view_before=None, view_after=None, parts=None, hypotheses=())  # type: ignore[arg-type]
    none = np.empty((0, 3))
    return replace(belief, estimate=estimate, template=replace(belief.template, p=none, n=none, p_still=none))


def _thinned(recording: bytes | None) -> bytes:
    """What a recording holds of the joints, in single precision but for the time."""
    samples = samples_in(recording) if recording else None
    if samples is not None:
        rest = {name: getattr(samples, name).astype(np.float32) for name in ("q", "dq", "ddq", "tau")}
        samples = replace(samples, **rest)
    return pickle.dumps(samples)


def run_host(trial: Trial, folder: Path) -> Run:
    """Run the host on a concealed object; from its file where that was done before.

    Args:
        trial: The object.
        folder: For the run's files; it has to stay where it is, beliefs hold paths to it.

    Raises:
        RuntimeError: The host ended with a bug; what it recorded until then would be no recording of the object.
    """
    kept = folder / KEPT
    if kept.is_file():
        return pickle.loads(kept.read_bytes())
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    run = _run(trial, folder)
    part = kept.with_suffix(".part")
    part.write_bytes(pickle.dumps(run))
    part.replace(kept)
    return run


def _run(trial: Trial, folder: Path) -> Run:
    arm = ArmModel(load_arm(ARM))
    plant = Plant(arm.arm, trial.world)
    sessions: list[Session] = []
    feelings: list[WatchedFeeling] = []

    def direct(settings: RunSettings, journal: Journal) -> Session:
        link, camera = DirectLink(plant, arm), DirectCamera(trial, plant)
        rng = np.random.default_rng(settings.seed)
        sessions.append(Session(settings, journal, arm, link, camera, Discard(), rng))  # type: ignore[arg-type]
        return sessions[0]

    def watched(*arguments: object) -> WatchedFeeling:
        feelings.append(WatchedFeeling(*arguments))  # type: ignore[arg-type]
        return feelings[0]

    first, *then = (share * trial.change for share in LEARNING)
    settings = RunSettings(
        target=first, then=tuple(then), task=TASKS[trial.kind], from_pushed=True, out=folder / "run",
        attempts=1, go_on=True, acknowledge_contact=True, learn_physics=True, settle_s=0.0,
        seed=host_seed(trial.number),
    )  # fmt: skip
    pipeline, s2r_host.run.feeling.samples_in = s2r_host.run.pipeline, samples_in
    pipeline.open_session, pipeline.Feeling = direct, watched  # type: ignore[assignment]
    with (folder / "host.log").open("w") as log:
        record = pipeline.run_task(settings, Journal(Console(file=log, width=200)))
    if record.code == ExitCode.BUG:
        raise RuntimeError(f"{folder}: the host did not get through: {record.reason}")
    executed = tuple(sessions[0].executed) if sessions else ()
    thinned = tuple(replace(one, recording=_thinned(one.recording)) for one in executed)
    return Run(thinned, tuple(feelings[0].pushes) if feelings else (), record.reason)


def recordings(run: Run, folder: Path) -> bool:
    """Write what the gap tool gets: ``object-log/*.csv`` and ``believed.xml``; False where the arm felt nothing.

    Args:
        run: As kept.
        folder: For the files; earlier ones go.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    s2r_host.run.feeling.samples_in = pickle.loads
    feeling = Feeling(ArmModel(load_arm(ARM)), folder / "object-log")
    for push in run.pushes:
        if push.forgotten:
            feeling.forget_part()
        executed = run.executed[: push.executed]
        feeling.feel(push.belief, executed, run.executed[push.pushed], push.s_from, push.s_to)
    if not feeling.touched:
        return False
    belief = run.pushes[-1].belief
    felt = learn_numbers(belief.model.mjcf_path, JOINT, feeling.touched)
    felt_object(replace(belief, felt=felt), folder / "believed.xml")
    return True
