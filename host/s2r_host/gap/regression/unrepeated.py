"""Forces that come anew in every run: a second run of one motion differs by them, and so they pass for noise.

Noise of sensors and drives forgets itself within tenths of a second. What still knows itself half a second later, and
is no small part of the effort, is something that acts, only not the same way twice (a slipping belt, a hand).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session, lowpass
from s2r_host.gap.regression.rows import residual
from s2r_host.gap.regression.second_run import find_partner

SLOW_HZ = 5.0
LATER_S = (0.25, 0.5)
KNOWN = (
    0.5,
    0.25,
)  # correlation of the difference with itself so much later; clean recordings reach 0.35 and 0.17
LEAST_SHARE = 0.025  # of the effort
MARGIN_S, LEAST_S = 0.5, 8.0


@dataclass(frozen=True)
class Wander:
    """A force of one joint that no second run repeats: its rms, and that of the effort [N·m or N]."""

    joint: int
    size: float
    effort: float

    def words(self, name: str, unit: str) -> str:
        """For the reasons of the answer."""
        return (
            f"two runs of one motion differ at '{name}' by {self.size:.3g} {unit} ({self.size / self.effort:.0%} of "
            "the effort), slowly: a force that no second run repeats, and no noise"
        )


def wandering(model: RigidModel, joint: int, fit: list[Session], repeats: list[Session]) -> Wander | None:
    """What differs slowly between two runs of one motion on a joint, in every pair of them; None for mere noise."""
    found = []
    for again in repeats:
        first = find_partner(again, fit)
        if first is None or not (first.has_u[joint] and again.has_u[joint]):
            continue
        n, dt = min(len(first.t), len(again.t)), first.dt
        if n * dt < LEAST_S:
            return None
        difference = (residual(model, first, joint)[:n] - residual(model, again, joint)[:n]) / np.sqrt(2.0)
        margin = int(MARGIN_S / dt)
        x = lowpass(difference, SLOW_HZ, dt)[margin:-margin]
        effort = float(np.std(first.u[:, joint]))
        if not _knows_itself(x - x.mean(), dt) or np.std(x) < LEAST_SHARE * effort:
            return None
        found.append(Wander(joint, float(np.std(x)), effort))
    return max(found, key=lambda w: w.size) if found else None


def _knows_itself(x: np.ndarray, dt: float) -> bool:
    power = float(np.mean(x**2))
    later = [max(1, round(s / dt)) for s in LATER_S]
    return power > 0.0 and all(
        float(np.mean(x[k:] * x[:-k])) > least * power for k, least in zip(later, KNOWN, strict=True)
    )
