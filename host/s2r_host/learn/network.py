"""The push network: a small PointNet++ with the three heads of Where2Act (Mo et al., ICCV 2021) and two of its own.

Actionability per point, proposals of a push direction, and the likelihood that a push is useful; besides, whether a
point belongs to the part that moves and along which line it moves. The last two are known for every point of a
simulated view, not only for the few that were pushed, and teach the encoder most of what it knows.

Neighbour indices come from outside (`s2r_host.perception.object_cloud.pyramid`), so that the graph is nothing but
gathers and small matrix products.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from s2r_host.learn.blocks import mlp, pool, spread
from s2r_host.perception.object_cloud import COARSE, FEATURES

IN, WIDTH, HIDDEN, NOISE = FEATURES, 80, 80, 3
LINE = 6  # xx, yy, zz, xy, xz, yz of the outer product of a direction with itself: a line has no sign
FEATURE = HIDDEN + 3 + LINE + 1  # what the heads get per point: hidden, normal, line of motion, part logit


class PushNetwork(nn.Module):
    """Encoder and heads. Shapes: B clouds of N points, S pushes."""

    def __init__(self, width: int = WIDTH) -> None:
        super().__init__()
        self.lift = mlp(IN, width // 2, width // 2)
        self.down1 = mlp(width // 2 + 3, width, width)
        self.down2 = mlp(width + 3, 2 * width, 2 * width)
        self.whole = mlp(2 * width, 2 * width, 2 * width)
        self.up1 = mlp(4 * width + width, 2 * width, width)
        self.up0 = mlp(width + width // 2 + IN, width, HIDDEN)
        self.part = nn.Sequential(mlp(HIDDEN, width), nn.Linear(width, 1))
        self.line = nn.Sequential(mlp(HIDDEN, width), nn.Linear(width, LINE))
        self.actionability = nn.Sequential(mlp(FEATURE, width), nn.Linear(width, 1))
        self.proposal = nn.Sequential(mlp(FEATURE + NOISE, width, width), nn.Linear(width, 3))
        self.critic = nn.Sequential(mlp(FEATURE + 5, 2 * width, width), nn.Linear(width, 1))

    def encode(
        self,
        x: Tensor,
        down1: Tensor,
        down2: Tensor,
        up1: Tensor,
        up0: Tensor,
        weight1: Tensor,
        weight0: Tensor,
    ) -> Tensor:
        """Features per point (B, N, FEATURE) of clouds (B, N, IN); the rest is a batched pyramid."""
        p0 = x[..., :3]
        p1, p2 = p0[:, : COARSE[0]], p0[:, : COARSE[1]]
        f0 = self.lift(x)
        f1 = pool(self.down1, f0, p0, p1, down1)
        f2 = pool(self.down2, f1, p1, p2, down2)
        whole = self.whole(f2).amax(dim=1, keepdim=True).expand(-1, f2.shape[1], -1)
        g1 = self.up1(torch.cat([spread(torch.cat([f2, whole], -1), up1, weight1), f1], -1))
        hidden = self.up0(torch.cat([spread(g1, up0, weight0), f0, x], -1))
        return torch.cat([hidden, x[..., 3:6], self.line(hidden), self.part(hidden)], -1)

    def act(self, feature: Tensor) -> Tensor:
        """Logit of the actionability, shape of ``feature`` without its last axis."""
        return self.actionability(feature).squeeze(-1)

    def propose(self, feature: Tensor, noise: Tensor) -> Tensor:
        """Unit push directions (..., 3) from features (..., FEATURE) and normal noise (..., NOISE)."""
        return nn.functional.normalize(self.proposal(torch.cat([feature, noise], -1)), dim=-1)

    def judge(self, feature: Tensor, direction: Tensor) -> Tensor:
        """Logit that a push along ``direction`` (..., 3) is useful, shape (...)."""
        inward = -(feature[..., HIDDEN : HIDDEN + 3] * direction).sum(-1, keepdim=True)
        along = (line_of(feature) * squares(direction)).sum(-1, keepdim=True)
        return self.critic(torch.cat([feature, direction, inward, along], -1)).squeeze(-1)


def line_of(feature: Tensor) -> Tensor:
    """The line along which a point moves, as the outer product of its direction (..., LINE)."""
    return feature[..., HIDDEN + 3 : HIDDEN + 3 + LINE]


def part_of(feature: Tensor) -> Tensor:
    """Logit that a point belongs to the part that moves, shape (...)."""
    return feature[..., -1]


def outer(direction: Tensor) -> Tensor:
    """Outer product of unit vectors (..., 3) with themselves: xx, yy, zz, xy, xz, yz."""
    x, y, z = direction.unbind(-1)
    return torch.stack([x * x, y * y, z * z, x * y, x * z, y * z], -1)


def squares(direction: Tensor) -> Tensor:
    """Such that ``(outer(u) * squares(d)).sum(-1)`` is the squared cosine between u and d."""
    return outer(direction) * direction.new_tensor([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
