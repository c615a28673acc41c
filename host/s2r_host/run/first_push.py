"""The first push: find the front, pick a reachable proposal, carry it out, go home."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.motion.front import Front, find_front
from s2r_host.motion.push import PushMotion, plan_push, push_scene
from s2r_host.motion.push_proposals import push_proposals
from s2r_host.run.observe import Observation
from s2r_host.run.session import Executed, Motion, Session
from s2r_host.run.travel import timed


@dataclass(frozen=True, eq=False)
class PlannedPush:
    """A push that may be carried out."""

    front: Front
    motion: PushMotion
    motions: tuple[Motion, ...]


@dataclass(frozen=True, eq=False)
class DonePush:
    """A push that was carried out."""

    planned: PlannedPush
    executed: tuple[Executed, ...]


def prepare_push(session: Session, view: Observation) -> PlannedPush:
    """Front, proposals, motions and time laws.

    Raises:
        SceneError: No front in view.
        NoMotionError: No proposal is reachable.
        TrajectoryError: A motion cannot be timed.
    """
    settings = session.settings
    front = find_front(view.scene)
    q_home = session.arm.arm.q_home
    motion = plan_push(
        session.arm,
        push_scene(view.scene, front),
        push_proposals(front, settings.push),
        session.status().q_ref,
        q_home,
        session.rng,
    )
    paths: list[tuple[np.ndarray, str, float]] = [
        (motion.approach, "push 1: approach", settings.travel_speed),
        (motion.push, "push 1", settings.push_speed),
        (motion.retreat, "push 1: back", settings.push_speed),
        (motion.home, "push 1: home", settings.travel_speed),
    ]
    return PlannedPush(
        front, motion, tuple(timed(session, path, label, speed) for path, label, speed in paths)
    )


def carry_out_push(session: Session, planned: PlannedPush) -> DonePush:
    """Approach, push, back, home."""
    return DonePush(planned, tuple(session.move(planned.motions)))
