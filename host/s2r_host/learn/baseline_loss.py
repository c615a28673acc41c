"""Losses of the baseline: cross-entropies, and on the part's points the errors of its joint, as Ditto is taught."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from s2r_host.learn.baseline_network import (
    PART,
    SLIDE_DIRECTION,
    SLIDE_DISTANCE,
    SLIDES,
    TURN_ANGLE,
    TURN_DIRECTION,
    WAY_DIRECTION,
    WAY_LENGTH,
    BaselineNetwork,
)
from s2r_host.learn.pair_loss import INPUTS

WEIGHTS = {"part": 1.0, "type": 1.0, "direction": 1.0, "line": 1.0, "state": 1.0, "space": 1.0}
OF_JOINT = ("direction", "line", "state")


def baseline_losses(
    network: BaselineNetwork, data: dict[str, Tensor]
) -> tuple[Tensor, dict[str, float], Tensor]:
    """Total loss, its parts, and what is told of the first view's points (B, P, JOINT).

    Part, type, space: cross-entropies. Direction: 1 - cosine. Line: 1 - cosine of the way to it, and the error of its
    length. State: error of the motion [rad or half sides]. Those of the joint count on the part's points, for its
    family; where equal spokes make two turns as good, the nearer counts.
    """
    planes, grid = network(*(data[name] for name in INPUTS))
    told = network.joint(planes, data["x"][:, 0])
    part, slides = data["part"], data["slides"]
    mine = part / part.sum(dim=1, keepdim=True).clamp(min=1)
    kind = functional.binary_cross_entropy_with_logits(
        told[..., SLIDES], slides[:, None].expand_as(part), reduction="none"
    )
    both = torch.stack([_errors(told, data["truth"][:, k], slides) for k in (0, 1)], dim=1)
    of_joint = (both * mine[:, None, :, None]).sum(dim=2)  # (B, 2, errors)
    pair = torch.arange(len(part), device=part.device)
    joint = of_joint[pair, of_joint.sum(-1).argmin(dim=1)].mean(dim=0)
    terms = {"part": functional.binary_cross_entropy_with_logits(told[..., PART], part)}
    terms["type"] = (kind * mine).sum(dim=1).mean()
    terms |= dict(zip(OF_JOINT, joint, strict=True))
    terms["space"] = functional.binary_cross_entropy_with_logits(
        network.occupied(grid, data["query"]), data["filled"]
    )
    total = torch.stack([WEIGHTS[name] * term for name, term in terms.items()]).sum()
    return total, {name: term.item() for name, term in terms.items()}, told


def _errors(told: Tensor, truth: Tensor, slides: Tensor) -> Tensor:
    """Errors of direction, line and state per point, (B, P, 3)."""
    slide = slides[:, None] > 0.5

    def away(columns: slice) -> Tensor:
        return 1 - functional.cosine_similarity(told[..., columns], truth[..., columns], dim=-1)

    def off(column: int) -> Tensor:
        return (told[..., column] - truth[..., column]).abs()

    line = away(WAY_DIRECTION) + off(WAY_LENGTH)
    return torch.stack(
        [
            torch.where(slide, away(SLIDE_DIRECTION), away(TURN_DIRECTION)),
            torch.where(slide, torch.zeros_like(line), line),
            torch.where(slide, off(SLIDE_DISTANCE), off(TURN_ANGLE)),
        ],
        dim=-1,
    )
