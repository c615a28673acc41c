"""The pair network's opinion as a belief in candidate motions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.motion import JointMotion, line_distance
from s2r_host.perception.network_belief import Trust
from s2r_host.perception.pair_votes import Opinion, Votes, median

Array = NDArray[np.floating]

UNLIKELY_NATS = -2.0
LEAST_PROBABILITY = 0.01  # of a family: the network is never surer than that
LEAST_EXPECTED = np.array(
    [0.02, 0.002, 0.01, 0.001]
)  # errors of direction [1], line [m], state [rad, m], flow [m]


@dataclass(frozen=True, eq=False)
class PairBelief:
    """What the network makes of one pair.

    Attributes:
        opinion: The poll of all passes.
        votes: All votes.
        trust: What they are worth.
    """

    opinion: Opinion
    votes: Votes
    trust: Trust

    @property
    def unlikely_nats(self) -> float:
        """See `network_belief.Belief`."""
        return UNLIKELY_NATS

    def motions(self) -> list[JointMotion]:
        """The network's own motions, of both families where it is in doubt, the likelier first."""
        both = [self.opinion.slide, self.opinion.turn]
        if self.opinion.slides < 0.5:
            both.reverse()
        doubtful = min(self.opinion.slides, 1 - self.opinion.slides) > LEAST_PROBABILITY
        return both if doubtful else both[:1]

    def nats(self, motion: JointMotion) -> float:
        """See `network_belief.Belief`."""
        return self.trust.nats(self.family(motion), self.errors(motion))

    def family(self, motion: JointMotion) -> float:
        """Logarithm of the probability of the motion's family relative to the likelier one."""
        slides = float(np.clip(self.opinion.slides, LEAST_PROBABILITY, 1 - LEAST_PROBABILITY))
        mine = slides if motion.joint_type == "prismatic" else 1 - slides
        return float(np.log(mine / max(slides, 1 - slides)))

    def errors(self, motion: JointMotion) -> Array:
        """How far a motion is from the votes: direction, line, state, flow, in what the network expects, (4,).

        Of the less likely family the flow counts only: its other votes were never taught on such a pair.
        """
        motion = motion.positive()
        before, after, weight = self.votes.where()
        X = motion.transform()
        gap = np.linalg.norm(before @ X[:3, :3].T + X[:3, 3] - after, axis=1)
        found = np.array([0.0, 0.0, 0.0, median(gap, weight)])
        best = self.opinion.best()
        if motion.joint_type == best.joint_type:
            middle = np.median(before, axis=0)
            found[0] = np.linalg.norm(motion.direction - best.direction)
            found[2] = abs(motion.delta - best.delta)
            if motion.joint_type == "revolute":
                # Where the network's axis passes the part.
                foot = best.origin + ((middle - best.origin) @ best.direction) * best.direction
                found[1] = line_distance(motion.origin, motion.direction, foot[None])[0]
        return found / np.maximum(self.opinion.expected, LEAST_EXPECTED)
