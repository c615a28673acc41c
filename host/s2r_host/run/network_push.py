"""What the push network makes of a view: which pieces it believes to give way, and what it would push itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from s2r_host.motion.push import PushScene, piece_scene
from s2r_host.motion.push_proposals import PushProposal
from s2r_host.perception.affordance import Affordance
from s2r_host.perception.network_pushes import NetworkPushSettings, proposals_of, shipped
from s2r_host.run.observe import Observation

BELIEVED = 0.4  # belief that a point belongs to the part, from which on it gives way
LEAST_POINTS = 100
TRIED_M = 0.025  # a contact this near to one that told nothing is not worth another push


def judged(view: Observation, rng: np.random.Generator) -> Affordance:
    """The network's verdict on a look, the robot's own pixels left out.

    Raises:
        BadViewError: No object in the view.
        InputError: The network's weights are missing.
    """
    depth_m = np.where(view.arm_mask, 0.0, view.capture.frame.depth_m)
    return shipped().affordance(replace(view.capture.frame, depth_m=depth_m), rng)


def belief_in(found: Affordance, p: np.ndarray) -> float:
    """Mean belief that points (n, 3) belong to the part that moves, 0 to 1."""
    return float(found.part[cKDTree(found.cloud.points).query(p)[1]].mean())


def line_in(found: Affordance, p: np.ndarray) -> np.ndarray:
    """Unit direction, without sense, along which points (n, 3) are believed to move if they do, (3,)."""
    index = cKDTree(found.cloud.points).query(p)[1]
    line, weight = found.line[index], found.part[index]
    return np.linalg.eigh(np.einsum("n,ni,nj->ij", weight, line, line))[1][:, -1]


def network_push(
    found: Affordance, view: Observation, settings: NetworkPushSettings, avoid: Sequence[np.ndarray]
) -> tuple[PushScene, list[PushProposal]] | None:
    """Obstacles and proposals, best first; None where the network sees nothing that would give way.

    Args:
        found: The network's verdict.
        view: On this look.
        settings: Geometry of the pushes.
        avoid: Where earlier pushes touched [m], (3,) each.
    """
    p = view.scene.p_base
    part = p[found.part[cKDTree(found.cloud.points).query(p)[1]] >= BELIEVED]
    proposals = [
        proposal
        for proposal in proposals_of(found, settings)
        if all(np.linalg.norm(proposal.p_contact - tried) > TRIED_M for tried in avoid)
    ]
    if len(part) < LEAST_POINTS or not proposals:
        return None
    return piece_scene(view.scene, part), proposals
