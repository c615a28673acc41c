"""The first push: find the moving part's surface, pick a reachable proposal, carry it out, go home."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, tee

import numpy as np

from s2r_host.errors import ArmStoppedError, NoMotionError, SceneError
from s2r_host.motion.fingertip import CLOSED_GRIPPER, Fingertip, fingertip_of
from s2r_host.motion.front import find_front
from s2r_host.motion.lid import find_lid
from s2r_host.motion.lid_proposals import lid_proposals
from s2r_host.motion.obstacles import SHADOW_DEPTH_M
from s2r_host.motion.push import PushMotion, PushScene, lid_scene, piece_scene, plan_push, push_scene
from s2r_host.motion.push_proposals import PushProposal, push_proposals
from s2r_host.motion.scene import Scene
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.knob_outline import KnobOutline
from s2r_host.perception.network_pushes import shipped
from s2r_host.run.at import proposals_at, scene_at
from s2r_host.run.back_off import back_off, stopped_in
from s2r_host.run.guess import Guess, Tried
from s2r_host.run.lever_guesses import GuessSettings, lever_guesses
from s2r_host.run.observe import Observation
from s2r_host.run.session import Executed, Motion, Session
from s2r_host.run.settings import RunSettings
from s2r_host.run.task import FAUCET, LAPTOP
from s2r_host.run.travel import FREE, LEAVING, NEVER, timed

# How deep what hides behind a faucet may be: usually, and where no push at the likeliest piece has room. Levers and
# spouts are thin, and the executor stops the arm at what is there after all.
SHADOWS_M = (SHADOW_DEPTH_M, 0.02, 0.005)
PUSH = 1  # place of the push itself among the motions: approach, push, back, home


@dataclass(frozen=True, eq=False)
class Pushable:
    """What the first view offers to push.

    Attributes:
        positive: Unit vector along or about which the joint should grow, (3,); None where the view does not tell.
        scene: Obstacles, the part apart.
        proposals: Best first.
        fresh: They know what earlier pushes were about; otherwise those tried are left out.
    """

    positive: np.ndarray | None
    scene: PushScene
    proposals: Iterator[PushProposal]
    fresh: bool = False


@dataclass(frozen=True, eq=False)
class PlannedPush:
    """A push that may be carried out; ``positive`` as in :class:`Pushable`."""

    positive: np.ndarray | None
    motion: PushMotion
    motions: tuple[Motion, ...]


@dataclass(frozen=True, eq=False)
class DonePush:
    """A push that was carried out.

    Attributes:
        planned, executed: What was meant and what was sent.
        went_through: Nothing stopped it on the way.
        moved: Something moved, as far as the views tell that were taken before and after it.
        sure: That is told by colours; noise in depth looks like a little motion, too.
    """

    planned: PlannedPush
    executed: tuple[Executed, ...]
    went_through: bool
    moved: bool = True
    sure: bool = False

    @property
    def tried(self) -> Tried:
        """What it says about the object where it told no joint."""
        proposal = self.planned.motion.proposal
        gave_way = self.moved and (self.sure or self.went_through)
        return Tried(proposal.p_contact, proposal.direction, not self.went_through, gave_way, self.sure)


def prepare_push(
    session: Session,
    view: Observation,
    number: int = 1,
    skip: int = 0,
    earlier: Sequence[DonePush] = (),
    knobs: Sequence[KnobOutline] = (),
) -> PlannedPush:
    """Surface, proposals, motions and time laws.

    Args:
        session: Links.
        view: The newest look.
        number: Of the push, counts from 1.
        skip: So many of the best proposals are left out: they were tried, and told nothing.
        earlier: Pushes that told nothing.
        knobs: Knobs with spokes in view.

    Raises:
        SceneError: Nothing in view looks like the task's part.
        NoMotionError: No proposal is reachable.
        TrajectoryError: A motion cannot be timed.
    """
    settings = session.settings
    tip = fingertip_of(session.arm)
    offered = pushables(settings, view.scene, _without_arm(view), session.rng, earlier, knobs, tip)
    pushable, motion = _reachable(session, offered, skip)
    paths: list[tuple[np.ndarray, str, float, float]] = [
        (motion.approach, f"push {number}: approach", settings.travel_speed, FREE),
        (motion.push, f"push {number}", settings.push_speed, NEVER),
        (motion.retreat, f"push {number}: back", settings.push_speed, LEAVING),
        (motion.home, f"push {number}: home", settings.travel_speed, FREE),
    ]
    motions = tuple(timed(session, *path) for path in paths)
    return PlannedPush(pushable.positive, motion, motions)


def carry_out_push(session: Session, planned: PlannedPush) -> DonePush:
    """Approach, push, back, home.

    A push may meet something that does not give way: the spout instead of the lever. The executor then stops the arm;
    the stop is acknowledged and the arm goes back the way it came, away from the contact and all the way to where it
    began: what was met may stand where the way home was to lead.

    Raises:
        ArmStoppedError: Stopped for another cause, or elsewhere than on the way into contact.
    """
    begun, went_through = len(session.executed), True
    try:
        session.move(planned.motions)
    except ArmStoppedError as error:
        if not stopped_in(session, planned.motions[PUSH]):
            raise
        went_through = False
        back_off(session, error, planned.motion.push, f"{planned.motions[PUSH].label}: backing off")
        way = np.vstack([session.status().q_ref, planned.motion.approach[-2::-1]])
        label = planned.motions[-1].label
        session.move([timed(session, way, label, session.settings.travel_speed, FREE)])
    return DonePush(planned, tuple(session.executed[begun:]), went_through)


def _reachable(session: Session, pushables: Iterable[Pushable], skip: int) -> tuple[Pushable, PushMotion]:
    """The first of several things to push that the arm can push, and how.

    Raises:
        NoMotionError: The arm can push none of them; the text is about the first.
        SceneError: There are none.
    """
    first: NoMotionError | None = None
    for pushable in pushables:
        try:
            return pushable, plan_push(
                session.arm,
                pushable.scene,
                islice(pushable.proposals, 0 if pushable.fresh else skip, None),
                session.status().q_ref,
                session.arm.arm.q_home,
                session.rng,
            )
        except NoMotionError as error:
            first = first or error
    if first is not None:
        raise first
    raise SceneError(
        f"nothing in this view that looks like a {session.settings.task.part} gives way; turn the object so that its "
        f"{session.settings.task.part} is seen"
    )


def pushables(
    settings: RunSettings,
    scene: Scene,
    frame: DepthFrame,
    rng: np.random.Generator,
    earlier: Sequence[DonePush] = (),
    knobs: Sequence[KnobOutline] = (),
    tip: Fingertip = CLOSED_GRIPPER,
) -> Iterator[Pushable]:
    """What a view offers to push, the likeliest first.

    Args:
        settings: Kind of object, and geometry of the pushes on it.
        scene: The object's points.
        frame: The same view, the arm's pixels set to 0.
        rng: For the push network.
        earlier: Pushes that told nothing.
        knobs: Knobs with spokes in view.
        tip: What pushes.

    Raises:
        SceneError: Nothing in view looks like the task's part.
        BadViewError: No object in the view.
        InputError: The network's weights are missing.
    """
    if settings.task is FAUCET:
        found = shipped().affordance(frame, rng)
        geometry = GuessSettings(
            replace(settings.lever_push, tip=tip), replace(settings.network_push, tip=tip)
        )
        tried = [one.tried for one in earlier]
        for guess in lever_guesses(scene, found, geometry, tried, knobs):
            yield from _guessed(settings, scene, guess)
    elif settings.task is LAPTOP:
        lid = find_lid(scene)
        lid_push = replace(settings.lid_push, tip=tip)
        yield Pushable(lid.along, lid_scene(scene, lid, lid_push.hidden_m), lid_proposals(lid, lid_push))
    else:
        front = find_front(scene_at(scene, settings.at))
        proposals = proposals_at(push_proposals(front, replace(settings.push, tip=tip)), settings.at)
        yield Pushable(front.normal, push_scene(scene, front), proposals)


def _guessed(settings: RunSettings, scene: Scene, guess: Guess) -> Iterator[Pushable]:
    """What may be the lever, with less and less believed to stand behind it."""
    for shadow_m, proposals in zip(SHADOWS_M, tee(guess.proposals, len(SHADOWS_M)), strict=True):
        pushed = piece_scene(scene, guess.p, shadow_m)
        yield Pushable(None, pushed, proposals_at(proposals, settings.at), fresh=True)


def _without_arm(view: Observation) -> DepthFrame:
    """The depth frame of a look, the robot's own pixels set to 0."""
    return replace(view.capture.frame, depth_m=np.where(view.arm_mask, 0.0, view.capture.frame.depth_m))
