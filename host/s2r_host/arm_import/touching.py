"""Which links of an arm touch in every pose: they do so by construction, and are not to be checked."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from s2r_protocol.arms import ArmDescription
from s2r_protocol.arms.link_pairs import link_pairs

_POSES = 64


def always_touching(arm: ArmDescription, apart_m: float, seed: int = 0) -> list[tuple[str, str]]:
    """Pairs of links that come no farther apart than ``apart_m`` [m] in any of many poses within the limits.

    Twice that where one joint carries both: these can never come nearer. Neighbours, and what the arm excludes
    already, are not among them.
    """
    model, shapes, pairs = link_pairs(arm)
    near = set(pairs)
    joint = {
        link: model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint
        for p in pairs
        for link in p
    }
    data, found = model.createData(), shapes.createData()
    rng = np.random.default_rng(seed)
    for _ in range(_POSES if pairs else 0):
        q = rng.uniform(arm.limits.q_min, arm.limits.q_max)
        pin.computeDistances(model, data, shapes, found, q)
        touching = {
            pair
            for pair, result in zip(pairs, found.distanceResults, strict=True)
            if result.min_distance <= apart_m * (2.0 if joint[pair[0]] == joint[pair[1]] else 1.0)
        }
        near &= touching
    return sorted(near)
