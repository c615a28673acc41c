"""Whether the inertia of a link can be that of a body as large as its shapes."""

from __future__ import annotations

import numpy as np

from s2r_protocol.arms.source import ArmSource, Box, Link

_WIDER = 5.0  # of vendors' arms 2 is the most, and placeholders like 1 kg m2 on a fingertip are 25 and more


def gyration_m(link: Link) -> float:
    """How far from its centre of mass a link's mass lies, were it all at one distance from an axis [m]."""
    return float(np.sqrt(max(link.inertia) / link.mass))


def placeholders(source: ArmSource) -> list[tuple[Link, float]]:
    """Links that move and whose mass would lie far outside their shapes, and how far these reach from it [m]."""
    moving = [link for link in source.links if link.name not in source.standing]
    reaches = [(link, _reach_m(source, link)) for link in moving if source.shapes_of(link.name)]
    return [(link, reach_m) for link, reach_m in reaches if gyration_m(link) > _WIDER * reach_m]


def _reach_m(source: ArmSource, link: Link) -> float:
    """How far a link's shapes reach from its centre of mass, at most [m]."""
    return max(
        float(np.linalg.norm(np.abs(np.subtract(s.center, link.com)) + s.half))
        if isinstance(s, Box)
        else max(float(np.linalg.norm(np.subtract(end, link.com))) for end in (s.a, s.b)) + s.radius
        for s in source.shapes_of(link.name)
    )
