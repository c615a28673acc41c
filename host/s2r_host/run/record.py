"""Everything a run produced, filled stage by stage."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from s2r_host.link import ExecutorIdentity
from s2r_host.perception.estimate import JointEstimate
from s2r_host.proprioception.object_log import Touch
from s2r_host.run.belief import Belief
from s2r_host.run.first_push import DonePush, PlannedPush
from s2r_host.run.journal import Journal
from s2r_host.run.manipulate import DoneManipulation
from s2r_host.run.observe import Observation
from s2r_host.run.settings import RunSettings
from s2r_protocol.exits import ExitCode

if TYPE_CHECKING:
    from s2r_host.run.lost_motion import LostMotion
    from s2r_host.run.physics import PhysicsLesson


@dataclass(frozen=True, eq=False)
class Goal:
    """One target.

    Attributes:
        target: [m or rad], from the state as found.
        attempts: The planned manipulations towards it, in order; none where the part was there already.
        s_before: Where the part was before, as far as it was looked at [m or rad].
        refused: Why no manipulation could be planned and the run went on without it; empty otherwise.
    """

    target: float
    attempts: list[DoneManipulation] = field(default_factory=list)
    s_before: float = math.nan
    refused: str = ""

    @property
    def last(self) -> DoneManipulation:
        """The newest of the manipulations."""
        return self.attempts[-1]

    @property
    def delta_r(self) -> float:
        """δ over the whole way, corrections included."""
        return self.last.delta / (self.target - self.attempts[0].s_initial)


@dataclass
class RunRecord:
    """Filled stage by stage; whatever is there when a run ends goes into ``run.json`` and the report.

    Attributes:
        settings, journal: Of the run.
        arguments: Command line.
        identity: Of the executor.
        arm_name, model_hash, limit_hash: Of the host's arm.
        views: All looks, in order.
        planned_push, push: The first push.
        belief: After the last correction.
        felt: What the arm felt of the part, by the label of the motion.
        lessons: What the recordings said about physics left out, in order.
        lost_motion: What was learnt about where motions leave the part, in order.
        told_by_push, push_seen_from: The joint as the pushes told it, and the name of the view before its motion.
        zero_view, told_view: Names of the two views that told the joint; its values count from the first of them.
        origin_view, found_view: Names of the view with the state from which targets count, and of the newest one before
            the first planned manipulation.
        origin: Joint value from which targets count [m or rad].
        s_first: Joint value in the first view [m or rad]; None where the part is not seen there, or none is believed.
        target_told: What was answered where the first target was asked for, counted as ``--target`` [m or rad].
        s_found: Joint value measured just before the first planned manipulation [m or rad].
        goals: What was aimed at so far, with the manipulations carried out for it.
        world_commitment: Of the stand-in's sealed world, if it says one.
        ended: Whether it has; :attr:`code` and :attr:`reason` tell how, and nothing before.
        code, reason: How the run ended.
    """

    settings: RunSettings
    journal: Journal
    arguments: tuple[str, ...] = ()
    identity: ExecutorIdentity | None = None
    arm_name: str = ""
    model_hash: bytes = b""
    limit_hash: bytes = b""
    views: list[Observation] = field(default_factory=list)
    planned_push: PlannedPush | None = None
    push: DonePush | None = None
    belief: Belief | None = None
    felt: dict[str, list[Touch]] = field(default_factory=dict)
    lessons: list[PhysicsLesson] = field(default_factory=list)
    lost_motion: list[LostMotion] = field(default_factory=list)
    told_by_push: JointEstimate | None = None
    push_seen_from: str = "A"
    zero_view: str = "A"
    told_view: str = "B"
    origin_view: str = "A"
    found_view: str = "A"
    origin: float = 0.0
    s_first: float | None = None
    target_told: float | None = None
    s_found: float | None = None
    goals: list[Goal] = field(default_factory=list)
    world_commitment: str | None = None
    ended: bool = False
    code: ExitCode = ExitCode.BUG
    reason: str = "the run did not end"

    @property
    def attempts(self) -> list[DoneManipulation]:
        """All planned manipulations carried out, in order."""
        return [done for goal in self.goals for done in goal.attempts]

    def show(self, s: float, digits: int = 2) -> str:
        """A joint value of the belief for people: counted as the command line's targets are, with its unit."""
        return self.settings.task.unit.show(s - self.origin, digits)

    def add_view(self, view: Observation) -> Observation:
        """Keep a look, and hand it back."""
        self.views.append(view)
        self.world_commitment = self.world_commitment or view.capture.world_commitment or None
        return view

    def view(self, name: str) -> Observation:
        """The look of that name."""
        return next(view for view in self.views if view.name == name)
