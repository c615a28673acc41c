"""What the recordings of a run say about physics that the belief leaves out, and the belief with it.

After every third target ``s2r gap`` reads all that the arm felt of the object's joint. What it names goes into the
object that the next plans are made with, in stock MuJoCo attributes: a spring as a spring, damping as damping, and all
that is friction or force of position as the dry friction that brakes the part where the next motion ends, one value
per direction. The lost motion between fingertip and part, which no effort shows, is read from where the same motions
left the part.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
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
from s2r_host.planning.doubt import Z90
from s2r_host.run.belief import JOINT, Belief
from s2r_host.run.contact import corrected
from s2r_host.run.feeling import felt_object
from s2r_host.run.manipulate import DoneManipulation
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
USUAL_M, USUAL_RAD = 0.0005, 0.01  # one standard deviation between motions of one kind
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
        state = StepState(0.0, np.array([s]), np.array([ds]), np.zeros(1), np.zeros(1), np.zeros(1))
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
        """(force of position on the part at rest, dry friction against it) [N or N·m]."""
        speed = 0.02 * (SPEED_M_S if slides else SPEED_RAD_S)
        (up, dry_up), (down, dry_down) = self.resistance(s, speed), self.resistance(s, -speed)
        stiffness, rest = self.spring
        return -0.5 * (up + down) - stiffness * (s - rest), 0.5 * (dry_up + dry_down + up - down)

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
        lost_motion: What the fingertip pushed on -> how much less far than foreseen the part went [m or rad].
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
    lost_motion: dict[str, float] = field(default_factory=dict)
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
            "lost_motion": self.lost_motion,
            "notes": list(self.notes),
        }


def after_target(session: Session, record: RunRecord, number: int) -> None:
    """After every third target: what the gap tool says to all recordings so far, and the lost motion, are learnt.

    Args:
        session: Of the run.
        record: Its belief gets what is learnt.
        number: Of the target, from 1.
    """
    if number % EVERY or record.belief is None:
        return
    done = len(record.attempts)
    folder = session.settings.out / f"physics-{done}"
    with session.journal.stage(f"physics after {done}") as stage:
        lesson = _asked(session, record, folder)
        belief, lost = _with_lost_motion(session, record, folder)
        lesson = replace(lesson, after=done, lost_motion=lost)
        record.lessons.append(lesson)
        record.belief = belief
        stage.note = _told(lesson, session)
    for note in lesson.notes:
        session.journal.say(note)


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
    lesson = next((one for one in reversed(record.lessons) if one.law is not None), None)
    if lesson is None or lesson.law is None or record.belief is None:
        return
    law = lesson.law
    belief, target = record.belief, session.target
    slides = belief.template.slides
    pull, dry = law.pull(target, slides)
    near = BRAKING_M if slides else BRAKING_RAD
    stayed = any(abs(done.measured.s - target) < near for done in record.attempts)
    if abs(pull) > dry and not stayed:
        session.journal.warn(
            f"let go at {record.show(target)}, the {session.settings.task.part} will move on by itself: it is pulled "
            f"with {pull:+.2f} against a dry friction of {dry:.2f}; it stays only where something holds it"
        )
    held = 0.0 if slides else HELD * abs(_bias(mujoco.MjModel.from_xml_path(str(belief.growing)), target))
    folder = session.settings.out / f"physics-{len(record.attempts)}"
    files = {
        positive: _with_law(
            belief.path(positive), law, max(law.braking(target, positive, slides), held),
            folder / f"{'growing' if positive else 'falling'}-for-{len(record.goals)}.xml",
        )
        for positive in (False, True)
    }  # fmt: skip
    least = min(law.braking(target, positive, slides) for positive in (False, True))
    share = float(np.clip(Z90 * lesson.noise / max(least, 1e-9), *DOUBT_RANGE))
    record.belief = replace(
        belief, falling=files[False], growing=files[True], braking=(1.0 - share, 1.0 + share)
    )


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


def _with_lost_motion(session: Session, record: RunRecord, folder: Path) -> tuple[Belief, dict[str, float]]:
    """The belief with the pushed surfaces where the manipulations since the last lesson say they are."""
    belief, settings = record.belief, session.settings
    assert belief is not None
    since = record.lessons[-1].after if record.lessons else 0
    ends = [goal.attempts[-1] for goal in record.goals if goal.attempts]
    found: dict[str, float] = {}
    if "touch" in settings.without:
        return belief, found
    ways: dict[bool, tuple[str, list[float]]] = {}
    for positive in (True, False):
        new = [one for one in ends if one.planned.number > since]
        done = [one for one in new if _tells(one, positive, settings.task.far_off, belief.template.slides)]
        if settings.attempts > 1:
            done = done[-1:]  # corrections between them have moved the surface since
        if done:
            geom, _ = Counter(one.planned.pushed_geom for one in done).most_common(1)[0]
            ways[positive] = geom, [_offset(one) for one in done if one.planned.pushed_geom == geom]
    usual = USUAL_M if belief.template.slides else USUAL_RAD
    shifts = believable([offsets for _, offsets in ways.values()], usual)
    for (positive, (geom, _)), offset in zip(ways.items(), shifts, strict=True):
        if offset:
            belief = corrected(belief, geom, offset, positive, folder)
            found[f"{geom}, {'growing' if positive else 'falling'}"] = -offset if positive else offset
    return belief, found


def _tells(done: DoneManipulation, positive: bool, far_off: float, slides: bool) -> bool:
    planned = done.planned
    if planned.corrected or planned.stopped or (done.s_target > done.s_initial) != positive:
        return False
    if (
        planned.pace < 1.0 and not slides
    ):  # levers coast, but not where they are moved slowly; slides never do
        return False
    return abs(done.measured.s - planned.foreseen) < far_off


def _offset(done: DoneManipulation) -> float:
    """Measured minus foreseen joint value [m or rad]."""
    return done.measured.s - done.planned.foreseen


def believable(ways: Sequence[Sequence[float]], usual: float) -> list[float]:
    """The mean offset of each way, less what chance alone would make of it.

    Motions that repeat badly teach little: a mean m of n with variance v each is taken as m (1 - v / (n m²)), nothing
    where that is negative (James and Stein's estimator, positive part). The variance is pooled over the ways.

    Args:
        ways: Offsets seen, per direction.
        usual: How well motions repeat on other objects, one standard deviation; counts as one observation.
    """
    squares = sum(float(np.sum((np.array(one) - np.mean(one)) ** 2)) for one in ways)
    variance = (squares + usual**2) / (sum(len(one) - 1 for one in ways) + 1)
    found = []
    for one in ways:
        mean = float(np.mean(one))
        found.append(mean * max(0.0, 1.0 - variance / (len(one) * mean**2)) if mean else 0.0)
    return found


def _with_law(source: Path, law: JointLaw, friction: float, path: Path) -> Path:
    """The object file with dry friction, damping and spring of the joint as found."""
    written = with_numbers(source, JOINT, 1.0, friction, law.damping, path)
    stiffness, rest = law.spring
    if stiffness > 0.0:
        tree = ET.parse(written)
        joint = tree.find(f".//joint[@name='{JOINT}']")
        assert joint is not None  # with_numbers found it
        joint.set("stiffness", f"{stiffness:.7g}")
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


def _told(lesson: PhysicsLesson, session: Session) -> str:
    said = lesson.verdict.replace("_", " ")
    names = [effect["name"] for effect in lesson.effects]
    names += [f"{entry['name']} {entry['from']:.3g} → {entry['to']:.3g}" for entry in lesson.parameters_off]
    show = session.settings.task.unit.show
    lost = [f"{show(value)} lost at {what}" for what, value in lesson.lost_motion.items()]
    return "; ".join([said + (f": {', '.join(names)}" if names else ""), *lost])
