"""Batches and losses of the push network."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from s2r_host.learn.network import FEATURE, NOISE, PushNetwork, line_of, outer, part_of
from s2r_host.learn.push_files import PushSample

PROPOSALS = 8
WEIGHTS = {"critic": 1.0, "part": 1.0, "line": 1.0, "proposal": 0.3, "actionability": 0.3}


def batch(samples: list[PushSample], pushes: int, rng: np.random.Generator, vary: bool) -> dict[str, Tensor]:
    """Stack samples with as many pushes each; optionally turned about the vertical and mirrored at random."""
    parts: dict[str, list[NDArray[np.generic]]] = {name: [] for name in _NAMES}
    for sample in samples:
        x, direction, motion = sample.cloud.features(), sample.direction, sample.motion
        if vary:
            R = random_pose(rng)
            x = np.hstack([x[:, :3] @ R.T, x[:, 3:6] @ R.T, x[:, 6:]])
            direction, motion = direction @ R.T, motion @ R.T
        chosen = rng.choice(len(sample.at), pushes, replace=len(sample.at) < pushes)
        near = sample.neighbours
        values = (
            x, *near.down, *near.up[::-1], *near.weight[::-1], sample.part.astype(np.float32), motion,
            sample.at[chosen], direction[chosen], sample.useful[chosen].astype(np.float32),
        )  # fmt: skip
        for name, value in zip(_NAMES, values, strict=True):
            parts[name].append(value)
    return {name: torch.from_numpy(np.stack(value)) for name, value in parts.items()}


_NAMES = (
    "x",
    "down1",
    "down2",
    "up1",
    "up0",
    "weight1",
    "weight0",
    "part",
    "motion",
    "at",
    "direction",
    "useful",
)
ENCODER_INPUTS = _NAMES[:7]


def losses(network: PushNetwork, data: dict[str, Tensor]) -> tuple[Tensor, dict[str, float], Tensor]:
    """Total loss, its parts, and the critic's logits (B, S).

    Critic: cross-entropy over the pushes as drawn. Part: cross-entropy over all points, each object's part and the
    rest counting alike (a lever is one point in twenty). Line: squared error of the outer product on the part.
    Proposals: the nearest of several must be near every useful push. Actionability: the critic's mean verdict on the
    network's own proposals, as in Where2Act.
    """
    feature = network.encode(*(data[name] for name in ENCODER_INPUTS))
    at = feature.gather(1, data["at"].unsqueeze(-1).expand(-1, -1, FEATURE))
    logit = network.judge(at, data["direction"])
    good, part = data["useful"], data["part"]
    many = at.unsqueeze(2).expand(-1, -1, PROPOSALS, -1)
    noise = torch.randn(*many.shape[:-1], NOISE, device=many.device)
    proposed = network.propose(many.detach(), noise)
    cosine = (proposed * data["direction"].unsqueeze(2)).sum(-1).amax(dim=2)
    with torch.no_grad():
        target = torch.sigmoid(network.judge(many, proposed)).mean(dim=2)
    error = (line_of(feature) - outer(data["motion"])).square().sum(-1)
    terms = {
        "critic": functional.binary_cross_entropy_with_logits(logit, good),
        "part": balanced(part_of(feature), part),
        "line": (error * part).sum() / part.sum().clamp(min=1),
        "proposal": ((1 - cosine) * good).sum() / good.sum().clamp(min=1),
        "actionability": functional.binary_cross_entropy_with_logits(network.act(at.detach()), target),
    }
    total = torch.stack([WEIGHTS[name] * term for name, term in terms.items()]).sum()
    return total, {name: term.item() for name, term in terms.items()}, logit


def balanced(logit: Tensor, truth: Tensor) -> Tensor:
    """Cross-entropy with the square root of the imbalance evened out, per cloud."""
    share = truth.mean(dim=1, keepdim=True).clamp(0.005, 0.995)
    weight = truth * ((1 - share) / share).sqrt() + (1 - truth) * (share / (1 - share)).sqrt()
    loss = functional.binary_cross_entropy_with_logits(logit, truth, reduction="none")
    return ((loss * weight).sum(dim=1) / weight.sum(dim=1)).mean()


def random_pose(rng: np.random.Generator) -> NDArray[np.float32]:
    """A turn about the vertical, with a mirror image every other time: pushing knows neither, (3, 3)."""
    angle = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=np.float32)
    return R * np.array([1, -1, 1], dtype=np.float32) if rng.uniform() < 0.5 else R
