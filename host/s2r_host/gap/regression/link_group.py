"""The inertial parameters of all links as one term, for models whose masses come from a drawing."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from s2r_host.gap.effects.base import Context, Value
from s2r_host.gap.regression.base_terms import PREFIX, BaseTerm
from s2r_host.gap.regression.nuisance import BaseParameter

LINKS = f"{PREFIX}links"
LINK_PRIOR = 10.0  # in units of the usual small error: masses within 30 %


class LinkGroup(BaseTerm):
    """Mass, centre and inertia of every link, off by tens of per cent."""

    def __init__(self, members: list[BaseParameter]) -> None:
        super().__init__(LINKS, members)

    def deviations(self) -> np.ndarray:
        """Prior deviation of each member: an error of a drawing, not of a measurement."""
        return LINK_PRIOR * np.array([m.prior for m in self.members])

    def parameters(
        self, ctx: Context, joint: int, shape: Mapping[str, float], theta: np.ndarray
    ) -> dict[str, Value]:
        """Members keyed ``mass@link3``, in their own units."""
        found = {}
        for i, m in enumerate(self.members):
            gradient = [0.0] * len(theta)
            gradient[i] = m.size
            found[f"{m.name}@{m.place}"] = Value(
                m.nominal + float(theta[i]) * m.size, m.unit, tuple(gradient)
            )
        return found
