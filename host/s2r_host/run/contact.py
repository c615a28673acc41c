"""What touching the part teaches: where the surface that was pushed really is.

A camera sees a lever or a handle from one side only, and a hand-eye error of millimetres is degrees at a short lever.
Where the fingertip was when it last moved the part is known to a fraction of a millimetre, and the surface was there.
Pushes of one direction touch one side of the part, those of the other direction the other: both are learnt apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.nearest import Nearest, nearest_to_tip
from s2r_host.motion.object_shapes import part_obstacles
from s2r_host.object_names import JOINT
from s2r_host.run.belief import SIDES, Belief
from s2r_host.run.object_file import with_face, with_part_moved

SEARCH_STEPS = 24
TOUCH_M = 2e-5


def corrected(belief: Belief, geom: str, offset: float, positive: bool, folder: Path) -> Belief:
    """Move the surface that was pushed to where the outcome says it is.

    With the tip at the same place the model ended at s and the part at s + offset: the pushed surface lies
    ``offset`` further back along the motion than modelled. Of a slide's box only the pushed face moves (a handle's
    inner face no camera saw; its outer face was seen). A hinge's part turns as a whole, for that direction alone.

    Args:
        belief: So far.
        geom: The geom the fingertip pressed on.
        offset: Measured minus modelled joint value at the end of the motion [m or rad].
        positive: The joint grew during the motion, so the pushed face looks against it.
        folder: For the new files.

    Raises:
        SceneError: The model has no such geom.
    """
    if belief.template.slides:
        falling, growing = (
            with_face(source, geom, belief.axis, -offset, folder / name, inner=positive)
            for source, name in ((belief.falling, "falling.xml"), (belief.growing, "growing.xml"))
        )
        return replace(belief, falling=falling, growing=growing, shifts=_added(belief, geom, -offset))
    return side_moved(belief, belief.template.pose(-offset), offset, positive, folder)


def side_moved(belief: Belief, X: np.ndarray, offset: float, positive: bool, folder: Path) -> Belief:
    """Place a hinge's part anew, for motions of one direction alone.

    Args:
        belief: So far.
        X: (4, 4), base frame at joint value 0.
        offset: How much further that lets motions go, about [rad].
        positive: The joint grows during those motions.
        folder: For the new file.

    Raises:
        SceneError: The model has no part.
    """
    name = "growing" if positive else "falling"
    path = with_part_moved(belief.path(positive), JOINT, X, folder / f"{name}.xml")
    shifts = _added(belief, SIDES[positive], -offset)
    return (
        replace(belief, shifts=shifts, growing=path)
        if positive
        else replace(belief, shifts=shifts, falling=path)
    )


def _added(belief: Belief, what: str, shift: float) -> dict[str, float]:
    return {**belief.shifts, what: belief.shifts.get(what, 0.0) + shift}


@dataclass(frozen=True, eq=False)
class Touched:
    """Where a part that a fingertip pushed stays, as far as geometry tells.

    Attributes:
        s: Joint value at which the part just touches the fingertip [m or rad].
        geom: What of it does.
        p: Where, base frame, (3,) [m].
    """

    s: float
    geom: str
    p: np.ndarray


def touch_at(
    path: Path, arm: ArmModel, q_end: np.ndarray, s: float, positive: bool, most: float
) -> Touched | None:
    """Where the part is left by a fingertip that pushed it and stopped.

    Args:
        path: Object file.
        arm: Its fingertip.
        q_end: Posture where it stopped, (dof,) [rad].
        s: About where the part is then.
        positive: It was pushed to let the joint grow.
        most: How far from ``s`` it may be.

    Returns:
        The first touch when the part comes back from ``most`` beyond; None if it is nowhere near the fingertip.
    """
    sign, part = 1.0 if positive else -1.0, part_obstacles(path)

    def apart(value: float) -> Nearest:
        return nearest_to_tip(arm, q_end, part(value))

    ahead = s + sign * most
    if apart(ahead).distance_m <= 0.0:
        return None
    for k in range(1, SEARCH_STEPS + 1):
        back = s + sign * most * (1.0 - 2.0 * k / SEARCH_STEPS)
        if apart(back).distance_m <= 0.0:
            touch = _touch(apart, ahead, back)
            nearest = apart(touch)
            return Touched(touch, nearest.name, nearest.p)
        ahead = back
    return None


def touched_by_push(
    belief: Belief, arm: ArmModel, q_end: np.ndarray, s: float, positive: bool, most: float
) -> tuple[str, float] | None:
    """What a push that ended at ``q_end`` with the part left at ``s`` says about the surface it pushed.

    Args:
        belief: So far.
        arm: Its fingertip.
        q_end: Posture at the end of the push, (dof,) [rad].
        s: Joint value afterwards, as the camera saw it.
        positive: The joint grew.
        most: Offset from which on something else happened: the fingertip slipped, or the part moved on by itself.

    Returns:
        The geom nearest to the fingertip and the offset for :func:`corrected`; None when the model's part is nowhere
        near the fingertip.
    """
    touched = touch_at(belief.path(positive), arm, q_end, s, positive, most)
    return None if touched is None else (touched.geom, s - touched.s)


def _touch(apart: Callable[[float], Nearest], free: float, inside: float) -> float:
    """Joint value between one where the fingertip is free and one where it is inside the part, at the touch."""
    for _ in range(20):
        middle = 0.5 * (free + inside)
        distance = apart(middle).distance_m
        if abs(distance) < TOUCH_M:
            return middle
        free, inside = (middle, inside) if distance > 0.0 else (free, middle)
    return 0.5 * (free + inside)
