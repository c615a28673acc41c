"""Which links of an arm come nearer to each other than the executor admits."""

from __future__ import annotations

import numpy as np

from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.collision import LARGEST_STEP_M, Clearance, CollisionChecker
from s2r_protocol.arms import ArmDescription
from s2r_protocol.arms.clearance import LINKS_APART_M

_MORE_M = 1e-4  # between two postures that are looked at


class LinksApart:
    """Measures as admission does: a motion that passes here is not refused there for its links."""

    def __init__(self, arm: ArmDescription) -> None:
        self._arm = ArmModel(arm)
        self._checker = CollisionChecker(self._arm, (), Clearance(self_m=LINKS_APART_M + _MORE_M))

    def near(self, q: np.ndarray) -> str | None:
        """Which two links come too near to each other along a motion (n, dof) [rad], in words; None: no two.

        No point of the arm moves over a centimetre between postures that are looked at, as far as there are so many.
        """
        travel_m = np.append(0.0, np.cumsum(np.abs(np.diff(q, axis=0)) @ self._arm.lever_m))
        looks = np.searchsorted(travel_m, np.arange(0.0, travel_m[-1], LARGEST_STEP_M))
        for k in np.unique(np.append(looks, len(q) - 1)):
            pair = self._checker.touching(q[k])
            if pair is not None:
                return f"two links come nearer than {1e3 * LINKS_APART_M:.0f} mm: {pair}"
        return None
