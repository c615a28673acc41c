"""What the recordings of a run say about physics that the belief leaves out, and the belief with it.

After every third target ``s2r gap`` reads all that the arm felt of the object's joint. What it names goes into the
object that the next plans are made with, in stock MuJoCo attributes: a spring as a spring, damping as damping, and all
that is friction or force of position as the dry friction that brakes the part where the next motion ends, one value
per direction.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from s2r_host.gap.config import GapConfig
from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import StepState
from s2r_host.gap.output.answer import make_answer, write_answer, write_outputs
from s2r_host.gap.output.report import write_report
from s2r_host.gap.pipeline import Analysis, analyse
from s2r_host.gap.simulation.replay import Twin
from s2r_host.object_names import JOINT
from s2r_host.planning.doubt import Z90
from s2r_host.run.belief import Belief
from s2r_host.run.feeling import felt_object
from s2r_host.run.object_file import with_numbers
from s2r_host.run.record import RunRecord
from s2r_host.run.session import Session
from s2r_protocol.exits import S2RError

EVERY = 3  # targets between two lessons: there and back once, and once more
# A slow motion: so fast is the part then, by shares of the usual speed between these. Rails and hinges that stick let
# go at twice that.
SLOW_M_S, SLOW_RAD_S, SLOWEST, SLOWLY = 0.01, 0.08, 0.1, 0.3
TELLING = ("nothing_missing", "parameter_off", "physics_missing")
BRAKING_M, BRAKING_RAD = 0.015, 0.08  # the stretch before a target in which a part that coasts comes to rest
SPEED_M_S, SPEED_RAD_S = 0.05, 0.25  # of a part on that stretch, about
SAMPLES = 9
LEAST_SHARE, HELD = 0.1, 1.05  # of the dry friction believed; of the gravity that a hinge was seen to hold
DOUBT_RANGE = (0.05, 0.5)  # share of the dry friction that stays in doubt, for an ensemble
STEP_S = 1e-3
TRANSMISSION = frozenset({"backlash", "joint_elasticity", "joint_play", "flexible_part", "contact_slip"})
DRIVE = frozenset({"actuator_delay", "bandwidth", "clock_skew", "encoder_offset", "encoder_eccentricity",
                   "effort_scale", "saturation", "session_friction", "thermal_drift"})  # fmt: skip
# The object's joint has no drive and no sensor: its recordings are made of the arm's. The mass of its part was learnt
# from the same recordings, so that a load beside it would only stand for what friction or a spring does.
NO_DRIVE = (*sorted(DRIVE), "motor_coupling", "payload", "armature")


@dataclass(frozen=True, eq=False)
class JointLaw:
    """The effort that the object's joint takes, as the gap tool has it.

    Attributes:
        model: The believed object with every stock attribute that was found.
        twin: The same with what has no stock form.
        planned: The object as plans know it.
    """

    model: mujoco.MjModel
    twin: Twin
    planned: mujoco.MjModel

    @property
    def damping(self) -> float:
        """Viscous friction [N·s/m or N·m·s/rad]."""
        return float(self.model.dof_damping[self._dof])

    @property
    def spring(self) -> tuple[float, float]:
        """Stiffness [N/m or N·m/rad] and the joint value where it is at rest."""
        joint = self.model.joint(JOINT)
        return float(self.model.jnt_stiffness[joint.id].ravel()[0]), float(
            self.model.qpos_spring[joint.qposadr[0]]
        )

    def resistance(self, s: float, ds: float) -> tuple[float, float]:
        """(effort taken by what the object file cannot hold, dry friction) at a joint value and speed [N or N·m].

        The file's own gravity is part of it already: only what a lean, tilt or weight that was found adds counts here.
        """
        state = StepState(0.0, np.array([s]), np.array([ds]), *(np.zeros(1) for _ in range(4)))
        taken = _bias(self.model, s) - _bias(self.planned, s)
        dry = float(self.model.dof_frictionloss[self._dof])
        for term in self.twin.live:
            runtime = catalogue()[term.effect].runtime(
                self.twin.ctx, max(term.joint, 0), term.shape, term.theta, STEP_S
            )
            if runtime is not None and term.effect not in TRANSMISSION | DRIVE:
                effort, level = runtime(state)
                taken, dry = taken + effort, dry + level
        return taken, dry

    def braking(self, target: float, positive: bool, slides: bool) -> float:
        """Mean dry friction that stands for all of this on the way to a target, in one direction [N or N·m]."""
        sign = 1.0 if positive else -1.0
        stretch, speed = (BRAKING_M, SPEED_M_S) if slides else (BRAKING_RAD, SPEED_RAD_S)
        values = []
        for s in np.linspace(target - sign * stretch, target, SAMPLES):
            taken, dry = self.resistance(float(s), sign * speed)
            values.append(dry + sign * taken)
        least = LEAST_SHARE * float(self.model.dof_frictionloss[self._dof])
        return max(float(np.mean(values)), least)

    def pull(self, s: float, slides: bool) -> tuple[float, float]:
        """(force of position on the part at rest, dry friction against it) [N or N·m].

        The file's own gravity counts here: less friction than was believed may no longer hold a lid against it. Not
        along a slide, where it is no more than the tilt that the look at its axis left.
        """
        speed = 0.02 * (SPEED_M_S if slides else SPEED_RAD_S)
        (up, dry_up), (down, dry_down) = self.resistance(s, speed), self.resistance(s, -speed)
        stiffness, rest = self.spring
        weight = 0.0 if slides else _bias(self.planned, s)
        return -0.5 * (up + down) - stiffness * (s - rest) - weight, 0.5 * (dry_up + dry_down + up - down)

    @property
    def _dof(self) -> int:
        return int(self.model.joint(JOINT).dofadr[0])


@dataclass(frozen=True, eq=False)
class PhysicsLesson:
    """What the recordings so far said.

    Attributes:
        after: Planned manipulations carried out by then.
        folder: The gap tool's answer, report and patched model.
        verdict: Its verdict; "refused" with the reason in ``notes`` when it could not read the recordings.
        effects, parameters_off: As in ``gap.json``.
        carried, not_carried: Names of what the next plans know, and of what has no form there.
        notes: Sentences for people.
        law: The joint as then known; None: as before.
        noise: Effort that it leaves unexplained, root mean square [N or N·m].
    """

    after: int
    folder: Path
    verdict: str
    effects: tuple[dict[str, Any], ...] = ()
    parameters_off: tuple[dict[str, Any], ...] = ()
    carried: tuple[str, ...] = ()
    not_carried: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    law: JointLaw | None = None
    noise: float = 0.0

    def as_json(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {
            "after_manipulations": self.after,
            "gap": str(self.folder),
            "verdict": self.verdict,
            "effects": list(self.effects),
            "parameters_off": list(self.parameters_off),
            "carried": list(self.carried),
            "not_carried": list(self.not_carried),
            "notes": list(self.notes),
        }


def after_target(session: Session, record: RunRecord, number: int) -> bool:
    """After every third target: what the gap tool says to all recordings so far is learnt.

    Also where the part was not moved for that target, from what there is; where it was not moved at all since the
    lesson before, there is nothing to learn.

    Args:
        session: Of the run.
        record: Gets the lesson.
        number: Of the target, from 1.

    Returns:
        Whether there is a new lesson.
    """
    done, before = len(record.attempts), record.lessons[-1].after if record.lessons else 0
    if number % EVERY or record.belief is None or done == before:
        return False
    folder = session.settings.out / f"physics-{done}"
    with session.journal.stage(f"physics after {done}") as stage:
        lesson = replace(_asked(session, record, folder), after=done)
        record.lessons.append(lesson)
        stage.note = _told(lesson)
    for note in lesson.notes:
        session.journal.say(note)
    return True


def pace(number: int, lessons: Sequence[PhysicsLesson], hurry: float = 0.0) -> float:
    """Share of the usual speed for a target's motions, until a lesson has told something.

    Motions of one speed go slowly only where they brake: what depends on the speed and what depends on the place are
    one thing in them. There and back are as fast as usual, once more is slow.

    Args:
        number: Of the target, from 1.
        lessons: So far.
        hurry: How many times too fast for a slow motion the part went so far; 0: not known.
    """
    if any(lesson.verdict in TELLING for lesson in lessons) or number % EVERY:
        return 1.0
    return float(np.clip(1.0 / hurry, SLOWEST, SLOWLY)) if hurry > 0.0 else SLOWLY


def _hurry(record: RunRecord) -> float:
    """Fastest that the part was felt to go, over what a slow motion is; 0 where nothing was felt."""
    if record.belief is None:
        return 0.0
    slow = SLOW_M_S if record.belief.template.slides else SLOW_RAD_S
    return max((float(np.abs(x.ds).max()) / slow for felt in record.felt.values() for x in felt), default=0.0)


def before_target(session: Session, record: RunRecord) -> None:
    """Set the pace, and let the believed object resist as the newest lesson says it does at the session's target."""
    session.pace = pace(len(record.goals), record.lessons, _hurry(record))
    law, belief, target = newest_law(record.lessons), record.belief, session.target
    if law is None or belief is None:
        return
    slides = belief.template.slides
    pull, dry = law.pull(target, slides)
    near = BRAKING_M if slides else BRAKING_RAD
    stayed = any(abs(done.measured.s - target) < near for done in record.attempts)
    if abs(pull) > dry and not stayed:
        session.journal.warn(
            f"let go at {record.show(target)}, the {session.settings.task.part} will move on by itself: it is pulled "
            f"with {pull:+.2f} against a dry friction of {dry:.2f}; it stays only where something holds it"
        )
    brake_at_target(session, record, record.goals[-1].s_before if record.goals else np.nan)


def brake_at_target(session: Session, record: RunRecord, rests_at: float) -> None:
    """Let the believed object resist as the newest lesson says it does at the session's target; nothing without one.

    What the arm feels of a manipulation is one friction for the whole way, which takes the place of that: before a
    correction it is to be said again.

    Args:
        session: Links and the target.
        record: Its belief is replaced.
        rests_at: Where the part is [m or rad]; not finite where no look has told.
    """
    lesson, belief, target = _telling(record.lessons), record.belief, session.target
    if lesson is None or lesson.law is None or belief is None:
        return
    law, slides = lesson.law, belief.template.slides
    done = len(record.attempts)
    folder, goal = session.settings.out / f"physics-{done}", len(record.goals)
    falling, growing = (
        braked(belief, law, target, folder / f"{name}-for-{goal}.xml", positive=positive, rests_at=rests_at)
        for positive, name in ((False, "falling"), (True, "growing"))
    )
    least = min(law.braking(target, positive, slides) for positive in (False, True))
    share = float(np.clip(Z90 * lesson.noise / max(least, 1e-9), *DOUBT_RANGE))
    record.belief = replace(belief, falling=falling, growing=growing, braking=(1.0 - share, 1.0 + share))


def newest_law(lessons: Sequence[PhysicsLesson]) -> JointLaw | None:
    """The joint as the newest lesson that told something has it."""
    lesson = _telling(lessons)
    return None if lesson is None else lesson.law


def braked(
    belief: Belief, law: JointLaw, target: float, path: Path, *, positive: bool, rests_at: float
) -> Path:
    """Write the object as it resists a motion that ends at a target.

    It stays where it was seen at rest, whatever is thought to pull it there.

    Args:
        belief: So far; its surfaces are taken.
        law: Of its joint.
        target: Joint value [m or rad].
        path: Where the file goes.
        positive: The motion lets the joint grow.
        rests_at: Where the part is before it [m or rad]; not finite where no look has told.
    """
    slides, source = belief.template.slides, belief.path(positive)
    model = mujoco.MjModel.from_xml_path(str(source))
    held = [law.braking(target, positive, slides)]
    if not slides:
        held.append(HELD * abs(_bias(model, target)))
    if np.isfinite(rests_at):
        stiffness, rest = law.spring
        held.append(HELD * abs(_bias(model, rests_at) + stiffness * (rests_at - rest)))
    return _with_law(source, law, max(held), path)


def _telling(lessons: Sequence[PhysicsLesson]) -> PhysicsLesson | None:
    return next((one for one in reversed(lessons) if one.law is not None), None)


def _asked(session: Session, record: RunRecord, folder: Path) -> PhysicsLesson:
    """The gap tool's answer to the recordings of the object's joint."""
    belief = record.belief
    assert belief is not None
    logs = sorted((session.settings.out / "object-log").glob("*.csv"))
    if not logs or belief.felt is None:
        return PhysicsLesson(0, folder, "insufficient", notes=("the arm has not felt the part yet",))
    try:
        analysis, answer = ask_gap(felt_object(belief, folder / "believed.xml"), logs, session.settings.seed)
        write_outputs(analysis, folder)
        write_report(analysis, answer, folder / "report.html")
        write_answer(answer, folder)
    except S2RError as error:
        return PhysicsLesson(0, folder, "refused", notes=(f"gap refused the recordings: {error}",))
    return _lesson(folder, analysis, answer, mujoco.MjModel.from_xml_path(str(belief.growing)))


def ask_gap(believed: Path, logs: Sequence[Path], seed: int) -> tuple[Analysis, dict[str, Any]]:
    """What the gap tool says to recordings of the object's joint.

    Args:
        believed: The object (MJCF).
        logs: Recordings of its joint.
        seed: Of the run.

    Raises:
        S2RError: They were refused.
    """
    config = GapConfig(NO_DRIVE, simulate=False, baselines=False, next_experiment=False)
    analysis = analyse(believed, list(logs), [], [], config, lambda _text: None)
    return analysis, make_answer(analysis, seed)


def _lesson(
    folder: Path, analysis: Analysis, answer: dict[str, Any], planned: mujoco.MjModel
) -> PhysicsLesson:
    names = [effect["name"] for effect in answer["effects"]]
    not_carried = tuple(name for name in names if name in TRANSMISSION | DRIVE)
    told = answer["verdict"] in ("physics_missing", "parameter_off") and analysis.twin is not None
    return PhysicsLesson(
        after=0,
        folder=folder,
        verdict=answer["verdict"],
        effects=tuple(answer["effects"]),
        parameters_off=tuple(answer["parameters_off"]),
        carried=tuple(name for name in names if name not in not_carried),
        not_carried=not_carried,
        notes=tuple(note for note in answer["notes"] if note.startswith("cannot tell")),
        law=JointLaw(analysis.twin.model, analysis.twin, planned)
        if told and analysis.twin is not None
        else None,
        noise=float(answer["floor"].get("tau_rmse") or 0.0),
    )


def _with_law(source: Path, law: JointLaw, friction: float, path: Path) -> Path:
    """The object file with dry friction, damping and spring of the joint as found."""
    written = with_numbers(source, JOINT, 1.0, friction, law.damping, path)
    stiffness, rest = law.spring
    tree = ET.parse(written)
    joint = tree.find(f".//joint[@name='{JOINT}']")
    assert joint is not None  # with_numbers found it
    joint.set("stiffness", f"{stiffness:.7g}")  # zero, too: the source may have an earlier lesson's spring
    joint.set("springref", f"{rest:.7g}")
    tree.write(written, encoding="unicode")
    return written


def _bias(model: mujoco.MjModel, s: float) -> float:
    """Effort that holds the joint against gravity at a value [N or N·m]."""
    data = mujoco.MjData(model)
    joint = model.joint(JOINT)
    data.qpos[joint.qposadr[0]] = s
    mujoco.mj_forward(model, data)
    return float(data.qfrc_bias[joint.dofadr[0]])


def _told(lesson: PhysicsLesson) -> str:
    said = lesson.verdict.replace("_", " ")
    names = [effect["name"] for effect in lesson.effects]
    names += [f"{entry['name']} {entry['from']:.3g} → {entry['to']:.3g}" for entry in lesson.parameters_off]
    return said + (f": {', '.join(names)}" if names else "")
