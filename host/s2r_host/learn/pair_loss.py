"""Batches and losses of the pair network."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from s2r_host.learn.pair_files import PairSample
from s2r_host.learn.pair_network import PairNetwork
from s2r_host.learn.push_loss import balanced
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.pair_cloud import PairCloud, facing, sample
from s2r_host.perception.pair_network import TURNED_RAD, neighbourhoods
from s2r_host.perception.pair_votes import (
    PART,
    SLIDE_DIRECTION,
    SLIDE_DISTANCE,
    SLIDES,
    TURN_ANGLE,
    TURN_DIRECTION,
    TURN_OFFSET,
    true_votes,
)

WEIGHTS = {"part": 1.0, "type": 0.5, "direction": 1.0, "line": 0.5, "state": 0.5}
SIZES = (0.85, 1.18)  # of the same object, at random
INPUTS = ("x", "down1", "down2", "up1", "up0", "weight1", "weight0")
_NAMES = (*INPUTS, "part", "votes", "slides")
DIRECTION_BETA, LINE_BETA_DM, STATE_BETA = (
    0.1,
    0.1,
    0.05,
)  # below these errors count squared, above as they are


def batch(samples: list[PairSample], rng: np.random.Generator, vary: bool) -> dict[str, Tensor]:
    """Draw points of each pair and stack them; in the network's frame; optionally turned, mirrored, resized, reversed.

    Returns:
        The network's inputs; ``part`` (B, 2, P); ``votes`` (B, 2, 2, P, VOTES), first axis after the batch: the motion
        and the turn the other way that equal spokes make as good (else the motion again); ``slides`` (B,).
    """
    parts: dict[str, list[NDArray[np.generic]]] = {name: [] for name in _NAMES}
    for one in samples:
        cloud = sample(one.pools(), rng)
        part = np.stack([mine[at] for mine, at in zip(one.part(), cloud.chosen, strict=True)])
        motions = [one.motion, one.other if one.other is not None else one.motion]
        cloud, part, motions = varied(
            cloud, part, motions, *(_pose(rng) if vary else (0.0, False, 1.0, False))
        )
        values = (
            cloud.features(),
            *neighbourhoods(cloud),
            part.astype(np.float32),
            np.stack([[true_votes(p, motion) for p in cloud.points] for motion in motions]),
            np.float32(one.motion.joint_type == "prismatic"),
        )
        for name, value in zip(_NAMES, values, strict=True):
            parts[name].append(value)
    return {name: torch.from_numpy(np.stack(value)) for name, value in parts.items()}


def _pose(rng: np.random.Generator) -> tuple[float, bool, float, bool]:
    """Turn [rad], mirror image, size, views exchanged: things know none of them."""
    return (
        rng.uniform(-TURNED_RAD, TURNED_RAD),
        rng.uniform() < 0.5,
        float(np.exp(rng.uniform(*np.log(SIZES)))),
        rng.uniform() < 0.5,
    )


def varied(
    cloud: PairCloud,
    part: NDArray[np.bool_],
    motions: list[JointMotion],
    turn_rad: float,
    mirror: bool,
    size: float,
    back: bool,
) -> tuple[PairCloud, NDArray[np.bool_], list[JointMotion]]:
    """The same pair in the frame that faces its camera, in another pose and size, ``back``: its views exchanged."""
    R = np.diag([1.0, -1.0 if mirror else 1.0, 1.0]) @ facing(cloud.heading + turn_rad)
    order = [1, 0] if back else [0, 1]
    turned = [_moved(motion, cloud.centre, R, size, -1.0 if back else 1.0) for motion in motions]
    new = PairCloud(
        cloud.centre + size * (cloud.points - cloud.centre)[order] @ R.T,
        cloud.normals[order] @ R.T,
        cloud.flags[order],
        cloud.chosen[order],
        cloud.centre,
        0.0,
    )
    return new, part[order], turned


def _moved(
    motion: JointMotion, centre: NDArray[np.floating], R: NDArray[np.floating], size: float, sense: float
) -> JointMotion:
    """A mirror image (det R = -1) turns the other way: directions of rotation are pseudo-vectors."""
    slides = motion.joint_type == "prismatic"
    direction = sense * (1.0 if slides else np.linalg.det(R)) * (R @ motion.direction)
    delta = size * motion.delta if slides else motion.delta
    return replace(
        motion, origin=centre + size * R @ (motion.origin - centre), direction=direction, delta=delta
    )


def losses(network: PairNetwork, data: dict[str, Tensor]) -> tuple[Tensor, dict[str, float], Tensor]:
    """Total loss, its parts, and the network's output (B, 2, P, VOTES).

    Part: cross-entropy over all points, evened out as for pushes. The rest over the true part's points, votes of the
    true family only: smooth L1 of the length of the error in direction, line [dm] and state [rad or dm]. Where equal
    spokes make two turns as good, the nearer counts.
    """
    out = network(*(data[name] for name in INPUTS))
    part, slides = data["part"].flatten(1), data["slides"]
    vote, truth = out.flatten(1, 2), data["votes"].flatten(2, 3)
    mine = part / part.sum(dim=1, keepdim=True).clamp(min=1)
    kind = functional.binary_cross_entropy_with_logits(
        vote[..., SLIDES], slides[:, None].expand_as(part), reduction="none"
    )
    of_family = torch.stack(
        [_joint_errors(vote, truth[:, k], mine, slides) for k in (0, 1)], dim=1
    )  # (B, 2, 3)
    weight = of_family.new_tensor([WEIGHTS["direction"], WEIGHTS["line"], WEIGHTS["state"]])
    nearer = (of_family * weight).sum(-1).argmin(dim=1)
    chosen = of_family[torch.arange(len(nearer), device=nearer.device), nearer].mean(dim=0)
    terms = {
        "part": balanced(vote[..., PART], part),
        "type": (kind * mine).sum(dim=1).mean(),
        "direction": chosen[0],
        "line": chosen[1],
        "state": chosen[2],
    }
    total = torch.stack([WEIGHTS[name] * term for name, term in terms.items()]).sum()
    return total, {name: term.item() for name, term in terms.items()}, out


def _joint_errors(vote: Tensor, truth: Tensor, mine: Tensor, slides: Tensor) -> Tensor:
    """Mean error of direction, line and state per pair, (B, 3)."""
    turn = torch.stack(
        [
            _smooth(vote[..., TURN_DIRECTION] - truth[..., TURN_DIRECTION], DIRECTION_BETA),
            _smooth(vote[..., TURN_OFFSET] - truth[..., TURN_OFFSET], LINE_BETA_DM),
            _smooth((vote[..., TURN_ANGLE] - truth[..., TURN_ANGLE]).unsqueeze(-1), STATE_BETA),
        ],
        dim=-1,
    )
    slide = torch.stack(
        [
            _smooth(vote[..., SLIDE_DIRECTION] - truth[..., SLIDE_DIRECTION], DIRECTION_BETA),
            torch.zeros_like(mine),
            _smooth((vote[..., SLIDE_DISTANCE] - truth[..., SLIDE_DISTANCE]).unsqueeze(-1), STATE_BETA),
        ],
        dim=-1,
    )
    error = torch.where(slides[:, None, None] > 0.5, slide, turn)
    return (error * mine.unsqueeze(-1)).sum(dim=1)


def _smooth(difference: Tensor, beta: float) -> Tensor:
    """Length of the error, squared below beta; smooth at 0."""
    return (difference.square().sum(-1) + beta * beta).sqrt() - beta
