"""Batches and losses of the pair network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from s2r_host.learn.blocks import take
from s2r_host.learn.pair_draws import Drawn
from s2r_host.learn.pair_network import PairNetwork
from s2r_host.learn.push_loss import balanced
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.pair_cloud import PairCloud, facing
from s2r_host.perception.pair_network import TURNED_RAD
from s2r_host.perception.pair_votes import (
    FLOW,
    PART,
    SLIDE_DIRECTION,
    SLIDE_DISTANCE,
    SLIDES,
    SPREAD_DIRECTION,
    SPREAD_FLOW,
    TURN_ANGLE,
    TURN_DIRECTION,
    TURN_OFFSET,
    true_votes,
)

WEIGHTS = {"part": 1.0, "type": 0.5, "direction": 1.0, "line": 0.5, "state": 1.0, "flow": 1.0}
WEIGHTS |= {"spread": 0.1, "space": 1.0}
JOINT = ("direction", "line", "state", "flow")  # in the order of the expected errors
SIZES = (0.85, 1.18)  # of the same object, at random
INPUTS = ("x", "down1", "down2", "up1", "up0", "weight1", "weight0")
_NAMES = (*INPUTS, "part", "votes", "slides", "beside", "geometry", "filled")
BETA = (0.1, 0.1, 0.05, 0.05)  # below these errors count squared, above as they are
MOST_SPREAD = 4.0  # of the logarithms


def batch(drawn: Sequence[Drawn], rng: np.random.Generator, vary: bool) -> dict[str, Tensor]:
    """Stack draws, in the network's frame; optionally turned, mirrored, resized.

    Returns:
        The network's inputs; ``part`` (B, 2, P); ``votes`` (B, 2, 2, P, VOTES), first axis after the batch: the motion
        and the turn the other way that equal spokes make as good (else the motion again); ``slides`` (B,); ``beside``
        and ``geometry``: see `pair_space.Beside`; ``filled`` (B, Q).
    """
    parts: dict[str, list[NDArray[np.generic]]] = {name: [] for name in _NAMES}
    for one in drawn:
        turn, mirror, size = random_pose_of_pair(rng) if vary else (0.0, False, 1.0)
        cloud, motions, R = varied(one.cloud, one.motions, turn, mirror, size)
        near = one.beside.turned(R, size)
        values = (
            cloud.features(),
            *(v.astype(np.int64) if v.dtype == np.int16 else v for v in one.pyramid),
            one.part.astype(np.float32),
            np.stack([_votes(cloud, motion) for motion in (motions[0], motions[-1])]),
            np.float32(motions[0].joint_type == "prismatic"),
            near.index,
            near.geometry,
            one.filled.astype(np.float32),
        )
        for name, value in zip(_NAMES, values, strict=True):
            parts[name].append(value)
    return {name: torch.from_numpy(np.stack(value)) for name, value in parts.items()}


def _votes(cloud: PairCloud, motion: JointMotion) -> NDArray[np.float32]:
    return np.stack([true_votes(p, motion, back=bool(k)) for k, p in enumerate(cloud.points)])


def random_pose_of_pair(rng: np.random.Generator) -> tuple[float, bool, float]:
    """Turn [rad], mirror image, size: things know none of them."""
    return (
        rng.uniform(-TURNED_RAD, TURNED_RAD),
        rng.uniform() < 0.5,
        float(np.exp(rng.uniform(*np.log(SIZES)))),
    )


def varied(
    cloud: PairCloud, motions: Sequence[JointMotion], turn_rad: float, mirror: bool, size: float
) -> tuple[PairCloud, list[JointMotion], NDArray[np.floating]]:
    """The same pair in the frame that faces its camera, in another pose and size; and that frame's rotation (3, 3)."""
    R = np.diag([1.0, -1.0 if mirror else 1.0, 1.0]) @ facing(cloud.heading + turn_rad)
    new = replace(
        cloud,
        points=cloud.centre + size * (cloud.points - cloud.centre) @ R.T,
        normals=cloud.normals @ R.T,
        gap_m=size * cloud.gap_m,
        heading=0.0,
    )
    return new, [_moved(motion, cloud.centre, R, size) for motion in motions], R


def _moved(
    motion: JointMotion, centre: NDArray[np.floating], R: NDArray[np.floating], size: float
) -> JointMotion:
    """A mirror image (det R = -1) turns the other way: directions of rotation are pseudo-vectors."""
    slides = motion.joint_type == "prismatic"
    direction = (1.0 if slides else np.linalg.det(R)) * (R @ motion.direction)
    delta = size * motion.delta if slides else motion.delta
    return replace(
        motion, origin=centre + size * R @ (motion.origin - centre), direction=direction, delta=delta
    )


def losses(network: PairNetwork, data: dict[str, Tensor]) -> tuple[Tensor, dict[str, float], Tensor]:
    """Total loss, its parts, and the network's votes (B, 2, P, VOTES).

    Part: cross-entropy over all points, evened out as for pushes. Votes count over the true part's points, those of
    the true family only: smooth L1 of the length of the error in direction, line [dm], state [rad or dm], flow [dm].
    Where equal spokes make two turns as good, the nearer counts. Spread: likelihood of these errors under exponential
    distributions of the size told; the errors themselves are not taught by it. Space: cross-entropy.
    """
    out, feature = network(*(data[name] for name in INPUTS))
    part, slides = data["part"].flatten(1), data["slides"]
    vote, truth = out.flatten(1, 2), data["votes"].flatten(2, 3)
    mine = part / part.sum(dim=1, keepdim=True).clamp(min=1)
    kind = functional.binary_cross_entropy_with_logits(
        vote[..., SLIDES], slides[:, None].expand_as(part), reduction="none"
    )
    both = torch.stack([_lengths(vote, truth[:, k], slides) for k in (0, 1)], dim=1)  # (B, 2, points, 4)
    beta = both.new_tensor(BETA)
    of_motion = (((both + beta * beta).sqrt() - beta) * mine[:, None, :, None]).sum(dim=2)
    weight = of_motion.new_tensor([WEIGHTS[name] for name in JOINT])
    nearer = (of_motion * weight).sum(-1).argmin(dim=1)
    pair = torch.arange(len(nearer), device=nearer.device)
    joint = of_motion[pair, nearer].mean(dim=0)
    error = (both[pair, nearer].detach() + 1e-8).sqrt()
    told = vote[..., SPREAD_DIRECTION : SPREAD_FLOW + 1].clamp(-MOST_SPREAD, MOST_SPREAD)
    applies = torch.stack(
        [torch.ones_like(slides), 1 - slides, torch.ones_like(slides), torch.ones_like(slides)], 1
    )
    spread = ((error * (-told).exp() + told) * applies[:, None]).sum(-1)
    terms = {"part": balanced(vote[..., PART], part), "type": (kind * mine).sum(dim=1).mean()}
    terms |= dict(zip(JOINT, joint, strict=True))
    terms["spread"] = (spread * mine).sum(dim=1).mean()
    terms["space"] = functional.binary_cross_entropy_with_logits(
        space_logits(network, feature, data), data["filled"]
    )
    total = torch.stack([WEIGHTS[name] * term for name, term in terms.items()]).sum()
    return total, {name: term.item() for name, term in terms.items()}, out


def space_logits(network: PairNetwork, feature: Tensor, data: dict[str, Tensor]) -> Tensor:
    """Whether the part is at the queries, (B, Q)."""
    near = torch.cat([take(feature.flatten(1, 2), data["beside"]), data["geometry"]], -1)
    return network.occupied(near.flatten(0, 1)).reshape(near.shape[:2])


def _lengths(vote: Tensor, truth: Tensor, slides: Tensor) -> Tensor:
    """Squared errors of direction, line, state and flow per point, (B, points, 4)."""
    slide = slides[:, None] > 0.5

    def squared(columns: slice) -> Tensor:
        return (vote[..., columns] - truth[..., columns]).square().sum(-1)

    def one(column: int) -> Tensor:
        return (vote[..., column] - truth[..., column]).square()

    direction = torch.where(slide, squared(SLIDE_DIRECTION), squared(TURN_DIRECTION))
    line = torch.where(slide, torch.zeros_like(direction), squared(TURN_OFFSET))
    state = torch.where(slide, one(SLIDE_DISTANCE), one(TURN_ANGLE))
    return torch.stack([direction, line, state, squared(FLOW)], dim=-1)
