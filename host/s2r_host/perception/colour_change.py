"""Whether anything moved between two looks from one place, by colour.

Depth of a stereo camera differs a little every time, at rims by more than a small motion moves them. Colours do not:
where nothing moves they stay, and the rim of what moves by a few pixels changes them.
"""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.frames import DepthFrame

Mask = NDArray[np.bool_]

SMOOTH_PX = 1.0
FAINT, CHANGED, CLEAR = 6.0, 12.0, 25.0  # 8-bit levels, after smoothing
# On 44 pairs of looks at drawn faucets that stayed, around the thing 116 pixels at most changed faintly and 7 clearly;
# levers that turned by 2 degrees or more changed 240 and more faintly, or 60 and more clearly.
LEAST_FAINT, LEAST_CLEAR = 180, 20


class Coloured(Protocol):
    """A look in colour."""

    @property
    def colour(self) -> NDArray[np.uint8] | None:
        """Its image, (h, w, 3)."""
        ...

    @property
    def K(self) -> NDArray[np.floating]:
        """Pinhole matrix, (3, 3)."""
        ...

    @property
    def X_base_camera(self) -> NDArray[np.floating]:
        """Pose of the camera, (4, 4)."""
        ...


def comparable(before: Coloured, after: Coloured) -> bool:
    """Whether both looks have colour, from one place: then what stays has the same colours in both."""
    return (
        before.colour is not None
        and after.colour is not None
        and before.colour.shape == after.colour.shape
        and np.allclose(before.K, after.K)
        and np.allclose(before.X_base_camera, after.X_base_camera)
    )


def colour_changed(before: Coloured, after: Coloured) -> Mask | None:
    """Pixels (h, w) of two looks whose colours differ clearly; None where colours cannot tell, as below."""
    change = _change(before, after)
    return None if change is None else change > CHANGED


def colour_moved(before: DepthFrame, after: DepthFrame, where: Mask) -> bool | None:
    """Whether something moved; None where colours cannot tell: there are none, or the camera stands elsewhere.

    Args:
        before, after: Two looks.
        where: Pixels to compare, shape (h, w), without the robot.
    """
    change = _change(before, after)
    if change is None:
        return None
    return bool((change[where] > FAINT).sum() >= LEAST_FAINT or (change[where] > CLEAR).sum() >= LEAST_CLEAR)


def _change(before: Coloured, after: Coloured) -> NDArray[np.float32] | None:
    """8-bit levels of the channel that differs most, (h, w)."""
    if not comparable(before, after) or before.colour is None or after.colour is None:
        return None
    return np.asarray(np.abs(_smooth(before.colour) - _smooth(after.colour)).max(axis=2), np.float32)


def _smooth(colour: NDArray[np.uint8]) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(colour.astype(np.float32), (0, 0), SMOOTH_PX), np.float32)
