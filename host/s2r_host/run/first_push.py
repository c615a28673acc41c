"""The first push: find the moving part's surface, pick a reachable proposal, carry it out, go home."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from s2r_host.errors import ArmStoppedError, NoMotionError, SceneError
from s2r_host.motion.front import find_front
from s2r_host.motion.lever_proposals import lever_proposals
from s2r_host.motion.levers import LeverCandidate, find_levers
from s2r_host.motion.lid import find_lid
from s2r_host.motion.lid_proposals import lid_proposals
from s2r_host.motion.push import PushMotion, PushScene, lid_scene, piece_scene, plan_push, push_scene
from s2r_host.motion.push_proposals import PushProposal, push_proposals
from s2r_host.perception.affordance import Affordance
from s2r_host.run.back_off import back_off
from s2r_host.run.network_push import belief_in, judged, line_in, network_push
from s2r_host.run.observe import Observation
from s2r_host.run.session import Executed, Motion, Session
from s2r_host.run.settings import RunSettings
from s2r_host.run.task import DRAWER, FAUCET, LAPTOP
from s2r_host.run.travel import FREE, LEAVING, NEVER, timed

PUSH = 1  # place of the push itself among the motions: approach, push, back, home
SAME_PIECE_M = 0.04  # a push that began this near a piece was about it
SAME_WAY = 0.7  # cosine
UNMOVED = 1.0  # doubt about a piece that the push network believes to stand still
IN_VAIN = 0.6  # about one that was pushed and told nothing
MOST_PIECES = 2  # before the network's own pushes are tried


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
    """

    planned: PlannedPush
    executed: tuple[Executed, ...]
    went_through: bool
    moved: bool = True

    @property
    def gave_way(self) -> bool:
        """What was pushed is the part, though the views did not tell its joint."""
        return self.went_through and self.moved


def prepare_push(
    session: Session, view: Observation, number: int = 1, skip: int = 0, earlier: Sequence[DonePush] = ()
) -> PlannedPush:
    """Surface, proposals, motions and time laws.

    Args:
        session: Links.
        view: The newest look.
        number: Of the push, counts from 1.
        skip: So many of the best proposals are left out: they were tried, and told nothing.
        earlier: Pushes that told nothing.

    Raises:
        SceneError: Nothing in view looks like the task's part.
        NoMotionError: No proposal is reachable.
        TrajectoryError: A motion cannot be timed.
    """
    settings = session.settings
    pushable, motion = _reachable(session, _PUSHABLES[settings.task.name](session, view, earlier), skip)
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
    the stop is acknowledged and the arm goes back the way it came, away from the contact.

    Raises:
        ArmStoppedError: Stopped for another cause, or elsewhere than on the way into contact.
    """
    begun, went_through = len(session.executed), True
    try:
        session.move(planned.motions)
    except ArmStoppedError as error:
        went_through = False
        back_off(session, error, planned.motion.push, f"{planned.motions[PUSH].label}: backing off")
        session.move(planned.motions[-1:])
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


def _drawer(session: Session, view: Observation, _: Sequence[DonePush]) -> Iterator[Pushable]:
    front, settings = find_front(view.scene), session.settings
    yield Pushable(front.normal, push_scene(view.scene, front), push_proposals(front, settings.push))


def _laptop(session: Session, view: Observation, _: Sequence[DonePush]) -> Iterator[Pushable]:
    lid, settings = find_lid(view.scene), session.settings
    scene = lid_scene(view.scene, lid, settings.lid_push.hidden_m)
    yield Pushable(lid.along, scene, lid_proposals(lid, settings.lid_push))


def _faucet(session: Session, view: Observation, earlier: Sequence[DonePush]) -> Iterator[Pushable]:
    """What looks like a lever and is believed to move, then what the push network would push.

    A piece that did not give way is less likely a lever, or turns another way: it comes again without the direction
    in which it held out.
    """
    settings = session.settings
    found = judged(view, session.rng)
    try:
        levers = find_levers(view.scene)
    except SceneError as error:
        session.journal.warn(f"{error}; asking the push network")
        levers = []
    doubts = [
        lever.doubt
        + UNMOVED * (1.0 - belief_in(found, lever.p))
        + IN_VAIN * sum(_pushed(lever, one) for one in earlier if not one.gave_way)
        for lever in levers
    ]
    ranked = [levers[k] for k in np.argsort(doubts, kind="stable")]
    touched = [one.planned.motion.proposal.p_contact for one in earlier]
    for lever in ranked[:MOST_PIECES]:
        yield _lever(view, lever, found, settings, earlier, (0,))
    proposed = network_push(found, view, settings.network_push, touched)
    if proposed is not None:
        scene, proposals = proposed
        yield Pushable(None, scene, iter(proposals), fresh=True)
    for lever in ranked[:MOST_PIECES]:
        yield _lever(view, lever, found, settings, earlier, (1,))
    for lever in ranked[MOST_PIECES:]:
        yield _lever(view, lever, found, settings, earlier, (0, 1))


def _lever(
    view: Observation,
    lever: LeverCandidate,
    found: Affordance,
    settings: RunSettings,
    earlier: Sequence[DonePush],
    ways: Sequence[int],
) -> Pushable:
    held_out = [
        one.planned.motion.proposal.direction
        for one in earlier
        if not one.went_through and _pushed(lever, one)
    ]
    proposals = (
        proposal
        for proposal in lever_proposals([lever], settings.lever_push, line_in(found, lever.p), ways)
        if all(proposal.direction @ direction < SAME_WAY for direction in held_out)
    )
    return Pushable(None, piece_scene(view.scene, lever.p), proposals, fresh=True)


def _pushed(lever: LeverCandidate, push: DonePush) -> bool:
    """Whether a push was about this piece."""
    p = push.planned.motion.proposal.p_contact
    return bool(np.linalg.norm(lever.p - p, axis=1).min() < SAME_PIECE_M)


_PUSHABLES = {DRAWER.name: _drawer, LAPTOP.name: _laptop, FAUCET.name: _faucet}
