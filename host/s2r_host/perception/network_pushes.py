"""Push proposals of the push network in the form the motion planner takes: poses of the fingertip, best first.

The network was trained with a finger that points along its push. An arm cannot point everywhere, so every push
is also offered with the finger leaning down, as the rule-based proposals are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from s2r_host.motion.fingertip import CLOSED_GRIPPER, Fingertip
from s2r_host.motion.push_proposals import PushProposal
from s2r_host.perception.affordance import Affordance, PushNetworkRuntime
from s2r_host.perception.affordance import PushProposal as NetworkPush
from s2r_host.perception.frames import DepthFrame

DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class NetworkPushSettings:
    """Geometry of a push the network proposes.

    Attributes:
        depth_m: Way past the first touch; the network was trained with 8 cm.
        standoff_m: Free way before the touch.
        leans: Share of "down" in the finger's axis; 0 points along the push.
        steepest_z: Fingers whose axis points less downwards than this come from below; they are left out.
        least_likelihood: Pushes the network believes in less are not offered.
        first: So many pushes are offered in every posture before the others are.
        tip: Of the finger that pushes.
    """

    depth_m: float = 0.08
    standoff_m: float = 0.04
    leans: tuple[float, ...] = (0.0, 0.5, 0.75, 1.0)
    steepest_z: float = -0.05
    least_likelihood: float = 0.2
    first: int = 8
    tip: Fingertip = CLOSED_GRIPPER


def push_proposals_from_network(
    frame: DepthFrame,
    rng: np.random.Generator,
    *,
    runtime: PushNetworkRuntime | None = None,
    settings: NetworkPushSettings | None = None,
) -> Iterator[PushProposal]:
    """Where to push first, from one view, without being told what the object is.

    Args:
        frame: The view without the robot (its pixels set to 0), camera pose in the arm's base frame, z up.
        rng: For the sampling of points and directions.
        runtime: The network; the shipped weights if None.
        settings: Geometry of the push.

    Yields:
        Proposals like those of `s2r_host.motion.push_proposals.push_proposals`, best first.

    Raises:
        BadViewError: No object in the view.
        InputError: The weights are missing.
    """
    yield from proposals_of((runtime or shipped()).affordance(frame, rng), settings)


def proposals_of(found: Affordance, settings: NetworkPushSettings | None = None) -> Iterator[PushProposal]:
    """The pushes of a judged view as poses of the fingertip, best first."""
    settings = settings or NetworkPushSettings()
    believed = [push for push in found.proposals if push.likelihood >= settings.least_likelihood]
    for some in (believed[: settings.first], believed[settings.first :]):
        for lean, push in product(settings.leans, some):
            yield from _postures(push, lean, settings)


@lru_cache(maxsize=1)
def shipped() -> PushNetworkRuntime:
    """The network with the weights that come with the package, loaded once."""
    return PushNetworkRuntime()


def _postures(push: NetworkPush, lean: float, settings: NetworkPushSettings) -> Iterator[PushProposal]:
    """Both rolls of the finger for one push and one lean; the tip's foremost corner touches the point."""
    d = np.asarray(push.direction, dtype=float)
    z = (1.0 - lean) * d + lean * DOWN
    length = float(np.linalg.norm(z))
    if length < 1e-6 or z[2] / length > settings.steepest_z:
        return
    z = z / length
    for R in _rolls(z):
        p_contact = np.asarray(push.point, dtype=float) - settings.tip.ahead_m(R, d) * d
        X = np.eye(4)
        X[:3, :3] = R
        X[:3, 3] = p_contact - settings.standoff_m * d
        yield PushProposal(X, p_contact, p_contact + settings.depth_m * d, d)


def _rolls(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (3, 3) whose z is the finger's axis: its wide side level, and turned by a right angle."""
    y = np.array([-z[1], z[0], 0.0])
    y = y / np.linalg.norm(y) if np.linalg.norm(y) > 1e-6 else np.array([0.0, 1.0, 0.0])
    x = np.cross(y, z)
    return np.column_stack([x, y, z]), np.column_stack([y, -x, z])
