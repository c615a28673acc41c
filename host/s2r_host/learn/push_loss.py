"""Batches and losses of the push network."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from s2r_host.learn.network import FEATURE, NOISE, PushNetwork
from s2r_host.learn.push_files import PushSample

PROPOSALS = 16


def batch(samples: list[PushSample], pushes: int, rng: np.random.Generator, turn: bool) -> dict[str, Tensor]:
    """Stack samples with the same number of pushes each; optionally turned about the vertical at random."""
    parts: dict[str, list[NDArray[np.generic]]] = {name: [] for name in _NAMES}
    for sample in samples:
        x, direction = sample.cloud.features(), sample.direction
        if turn:
            x, direction = _turned(x, direction, rng.uniform(0, 2 * np.pi))
        chosen = rng.choice(len(sample.at), pushes, replace=len(sample.at) < pushes)
        near = sample.neighbours
        values = (x, *near.down, *near.up[::-1], *near.weight[::-1], sample.at[chosen], direction[chosen])
        for name, value in zip(_NAMES, (*values, sample.useful[chosen].astype(np.float32)), strict=True):
            parts[name].append(value)
    return {name: torch.from_numpy(np.stack(value)) for name, value in parts.items()}


_NAMES = ("x", "down1", "down2", "up1", "up0", "weight1", "weight0", "at", "direction", "useful")
_ENCODER_INPUTS = _NAMES[:7]


def losses(
    network: PushNetwork, data: dict[str, Tensor], weight: float
) -> tuple[Tensor, dict[str, float], Tensor]:
    """Total loss, its parts, and the critic's logits (B, S).

    Critic: cross-entropy, useful pushes weighted up. Proposals: the nearest of sixteen must be near every useful push.
    Actionability: the critic's mean verdict on the network's own proposals, as in Where2Act.
    """
    feature = network.encode(*(data[name] for name in _ENCODER_INPUTS))
    at = feature.gather(1, data["at"].unsqueeze(-1).expand(-1, -1, FEATURE))
    logit = network.judge(at, data["direction"])
    critic = functional.binary_cross_entropy_with_logits(
        logit, data["useful"], pos_weight=torch.tensor(weight, device=logit.device)
    )
    many = at.unsqueeze(2).expand(-1, -1, PROPOSALS, -1)
    noise = torch.randn(*many.shape[:-1], NOISE, device=many.device)
    proposed = network.propose(many, noise)
    cosine = (proposed * data["direction"].unsqueeze(2)).sum(-1).amax(dim=2)
    good = data["useful"]
    proposal = ((1 - cosine) * good).sum() / good.sum().clamp(min=1)
    with torch.no_grad():
        target = torch.sigmoid(network.judge(many, proposed)).mean(dim=2)
    action = functional.binary_cross_entropy_with_logits(network.act(at), target)
    parts = {"critic": critic.item(), "proposal": proposal.item(), "actionability": action.item()}
    return critic + proposal + action, parts, logit


def _turned(
    x: NDArray[np.float32], direction: NDArray[np.float32], angle: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=np.float32)
    return np.hstack([x[:, :3] @ R.T, x[:, 3:6] @ R.T, x[:, 6:]]), direction @ R.T
