"""Which of several parts to push: the one at a point that the operator names."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from s2r_host.errors import SceneError
from s2r_host.motion.push_proposals import PushProposal
from s2r_host.motion.scene import Scene
from s2r_host.run.task import Point

RADIUS_M = 0.08
_LEAST_POINTS = 100


def scene_at(scene: Scene, at: Point | None) -> Scene:
    """What was seen within ``RADIUS_M`` of the point; all of it if there is none.

    Raises:
        SceneError: Nothing was.
    """
    if at is None:
        return scene
    far_m = np.linalg.norm(scene.p_base - at, axis=1)
    if (far_m < RADIUS_M).sum() < _LEAST_POINTS:
        raise SceneError(
            f"nothing was seen within {100 * RADIUS_M:.0f} cm of --at {_shown(at)}; the nearest point of the object is "
            f"{_shown(scene.p_base[far_m.argmin()])}, {100 * far_m.min():.0f} cm away"
        )
    return Scene(scene.p_base[far_m < RADIUS_M], scene.p_camera)


def proposals_at(proposals: Iterator[PushProposal], at: Point | None) -> Iterator[PushProposal]:
    """Those that touch within ``RADIUS_M`` of the point; all of them if there is none."""
    for one in proposals:
        if at is None or np.linalg.norm(one.p_contact - at) < RADIUS_M:
            yield one


def _shown(point: Point | np.ndarray) -> str:
    return ",".join(f"{x:.2f}" for x in point)
