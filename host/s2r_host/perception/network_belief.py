"""What a network's belief about a pair is worth among the hypotheses of geometry, in nats.

The network sees what a part of such a shape usually does; geometry sees exactly where surfaces went. A candidate that
is far off from what the network votes for, measured by the errors that it expects of itself, loses belief, but no more
than a fixed amount however far off it is: the network may be wrong altogether.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.evidence import Scene
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.ranking import EVIDENCE_SCALE, Hypothesis

Array = NDArray[np.floating]


class Belief(Protocol):
    """A view of one pair of views."""

    @property
    def unlikely_nats(self) -> float:
        """Candidates below this are found unlikely."""
        ...

    def nats(self, motion: JointMotion) -> float:
        """Logarithm of how well a motion agrees, 0 at best."""
        ...

    def motions(self) -> list[JointMotion]:
        """What it believes in itself, the likelier first."""
        ...


class Network(Protocol):
    """What `estimate.estimate_joint` needs of a network."""

    def belief(self, scene: Scene, rng: np.random.Generator) -> Belief | None:
        """About two views with their changes; None where it has no opinion."""
        ...


@dataclass(frozen=True)
class Trust:
    """How much a network's votes are worth, fitted on validation pairs by `learn.pair_trust`.

    Attributes:
        family: Nats per nat of the network's own belief in hinge or slide.
        direction, line, state, flow: Nats per doubling of the error beyond what the network expects.
        most_nats: Of any candidate against the network's own.
        size: Factor on the errors that the network expects.
    """

    family: float = 1.0
    direction: float = 1.0
    line: float = 1.0
    state: float = 1.0
    flow: float = 1.0
    most_nats: float = 4.0
    size: float = 1.0

    def nats(self, family: float, errors: Array) -> float:
        """Belief in a candidate.

        Args:
            family: Logarithm of the network's probability of the candidate's family, relative to the likelier one.
            errors: Of direction, line, state and flow, in units of what the network expects, shape (4,).
        """
        weight = np.array([self.direction, self.line, self.state, self.flow])
        total = self.family * family - float(weight @ np.log1p((errors / self.size) ** 2))
        return max(total, -self.most_nats)


def weighed_by(belief: Belief, ranked: list[Hypothesis]) -> list[Hypothesis]:
    """The hypotheses with a network's belief in their cost and weight, best first."""
    if not ranked:
        return ranked
    cost = np.array([h.cost - EVIDENCE_SCALE * belief.nats(h.motion) for h in ranked])
    weight = np.exp(-(cost - cost.min()) / EVIDENCE_SCALE)
    weight /= weight.sum()
    order = np.argsort(cost, kind="stable")
    return [replace(ranked[i], cost=float(cost[i]), weight=float(weight[i])) for i in order]
