"""Where and how to push what may be a lever: across its line near its tip, a small angle either way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from s2r_host.motion.levers import LeverCandidate
from s2r_host.motion.push_proposals import TIP_DEPTH_M, TIP_WIDTH_M, PushProposal

DOWN = np.array([0.0, 0.0, -1.0])
SIDEWAYS = 0.7  # cosine between finger and push, below which it pushes with its side


@dataclass(frozen=True)
class LeverPushSettings:
    """Geometry of the first push on a lever [m, rad].

    Attributes:
        turn_rad: How far the lever is to be turned.
        depth_m: Least and most the fingertip goes for that.
        standoff_m: Free way before the touch.
        places: Along the lever, 0 at its root, 1 at its tip.
        below_m: How far the fingertip reaches past the lever's line when it pushes with its side.
        leans: Share of "down" in the finger's axis; the rest points along the push, or from outside to the body.
        upright: Levers whose line rises more than this (sine) are pushed in the plane they lean in.
        root_m: A lever's axis is believed to be about this far inside of its visible root.
    """

    turn_rad: float = 0.4
    depth_m: tuple[float, float] = (0.03, 0.06)
    standoff_m: float = 0.035
    places: tuple[float, ...] = (0.9, 0.7, 0.5)
    below_m: float = 0.012
    leans: tuple[float, ...] = (1.0, 0.75, 0.5, 0.25)
    upright: float = 0.65
    root_m: float = 0.04


def lever_proposals(
    levers: Sequence[LeverCandidate], settings: LeverPushSettings | None = None
) -> Iterator[PushProposal]:
    """Proposals, best first: all ways to push the likeliest candidate, then the next one."""
    settings = settings or LeverPushSettings()
    for lever in levers:
        for place in settings.places:
            for lean in settings.leans:
                for direction in _across(lever, settings):
                    for level in (direction, -lever.outward):
                        z = lean * DOWN + (1.0 - lean) * level
                        yield from _pushes(lever, place, z / np.linalg.norm(z), direction, settings)
                        if lean == 1.0:
                            break


def _across(lever: LeverCandidate, settings: LeverPushSettings) -> list[np.ndarray]:
    """Level unit vectors in which the piece might give way, (3,) each."""
    d = lever.direction
    flat = np.array([d[0], d[1], 0.0])
    if np.linalg.norm(flat) < 0.1:
        flat = np.array([1.0, 0.0, 0.0])
    flat /= np.linalg.norm(flat)
    square = np.array([-flat[1], flat[0], 0.0])
    return [flat, -flat] if d[2] > settings.upright else [square, -square]


def _pushes(
    lever: LeverCandidate, place: float, z: np.ndarray, direction: np.ndarray, settings: LeverPushSettings
) -> Iterator[PushProposal]:
    """The finger points along ``z``, both ways round and across."""
    length = float(np.linalg.norm(lever.p_tip - lever.p_root))
    radius = settings.root_m + place * length
    depth = float(np.clip(settings.turn_rad * radius, *settings.depth_m))
    point = lever.p_root + place * (lever.p_tip - lever.p_root) - 0.5 * lever.width_m * direction
    if abs(z @ direction) < SIDEWAYS:
        point = point + settings.below_m * z
    for R in _rolls(z, direction):
        ahead = abs(R[:, 0] @ direction) * TIP_WIDTH_M / 2 + abs(R[:, 1] @ direction) * TIP_DEPTH_M / 2
        p_contact = point - ahead * direction
        X = np.eye(4)
        X[:3, :3] = R
        X[:3, 3] = p_contact - settings.standoff_m * direction
        yield PushProposal(X, p_contact, p_contact + depth * direction, direction)


def _rolls(z: np.ndarray, direction: np.ndarray) -> Iterator[np.ndarray]:
    """The finger's wide side across the push, either way round, then along it."""
    x = np.cross(direction, DOWN)
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    for a, b in ((x, y), (-x, -y), (y, -x), (-y, x)):
        yield np.column_stack([a, b, z])
