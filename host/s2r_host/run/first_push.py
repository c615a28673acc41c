"""The first push: find the moving part's surface, pick a reachable proposal, carry it out, go home."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from s2r_host.motion.front import find_front
from s2r_host.motion.lid import find_lid
from s2r_host.motion.lid_proposals import lid_proposals
from s2r_host.motion.push import PushMotion, PushScene, lid_scene, plan_push, push_scene
from s2r_host.motion.push_proposals import PushProposal, push_proposals
from s2r_host.run.observe import Observation
from s2r_host.run.session import Executed, Motion, Session
from s2r_host.run.settings import RunSettings
from s2r_host.run.task import DRAWER, LAPTOP
from s2r_host.run.travel import timed


@dataclass(frozen=True, eq=False)
class Pushable:
    """What the first view offers to push.

    Attributes:
        positive: Unit vector along or about which the joint should grow, (3,).
        scene: Obstacles, the part apart.
        proposals: Best first.
    """

    positive: np.ndarray
    scene: PushScene
    proposals: Iterator[PushProposal]


@dataclass(frozen=True, eq=False)
class PlannedPush:
    """A push that may be carried out; ``positive`` as in :class:`Pushable`."""

    positive: np.ndarray
    motion: PushMotion
    motions: tuple[Motion, ...]


@dataclass(frozen=True, eq=False)
class DonePush:
    """A push that was carried out."""

    planned: PlannedPush
    executed: tuple[Executed, ...]


def prepare_push(session: Session, view: Observation, number: int = 1, skip: int = 0) -> PlannedPush:
    """Surface, proposals, motions and time laws.

    Args:
        session: Links.
        view: The newest look.
        number: Of the push, counts from 1.
        skip: So many of the best proposals are left out: they were tried, and told nothing.

    Raises:
        SceneError: Nothing in view looks like the task's part.
        NoMotionError: No proposal is reachable.
        TrajectoryError: A motion cannot be timed.
    """
    settings = session.settings
    pushable = _PUSHABLES[settings.task.name](view, settings)
    motion = plan_push(
        session.arm,
        pushable.scene,
        islice(pushable.proposals, skip, None),
        session.status().q_ref,
        session.arm.arm.q_home,
        session.rng,
    )
    paths: list[tuple[np.ndarray, str, float]] = [
        (motion.approach, f"push {number}: approach", settings.travel_speed),
        (motion.push, f"push {number}", settings.push_speed),
        (motion.retreat, f"push {number}: back", settings.push_speed),
        (motion.home, f"push {number}: home", settings.travel_speed),
    ]
    motions = tuple(timed(session, path, label, speed) for path, label, speed in paths)
    return PlannedPush(pushable.positive, motion, motions)


def carry_out_push(session: Session, planned: PlannedPush) -> DonePush:
    """Approach, push, back, home."""
    return DonePush(planned, tuple(session.move(planned.motions)))


def _drawer(view: Observation, settings: RunSettings) -> Pushable:
    front = find_front(view.scene)
    return Pushable(front.normal, push_scene(view.scene, front), push_proposals(front, settings.push))


def _laptop(view: Observation, settings: RunSettings) -> Pushable:
    lid = find_lid(view.scene)
    scene = lid_scene(view.scene, lid, settings.lid_push.hidden_m)
    return Pushable(lid.along, scene, lid_proposals(lid, settings.lid_push))


_PUSHABLES = {DRAWER.name: _drawer, LAPTOP.name: _laptop}
