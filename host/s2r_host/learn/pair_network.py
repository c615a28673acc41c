"""The pair network: which points moved, about what, and how far, from two clouds.

What Ditto does (Jiang et al., CVPR 2022) at the size of this project, without its reconstruction: one PointNet++ (Qi et
al., NeurIPS 2017) for both views, attention between the coarse points of both so that each finds where its piece went,
and votes per point (`s2r_host.perception.pair_votes`).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from s2r_host.learn.blocks import mlp, pool, spread
from s2r_host.perception.pair_cloud import COARSE, FEATURES
from s2r_host.perception.pair_votes import VOTES

WIDTH, HEADS = 64, 4
PLACE = 4  # of a token: where it is [dm], and which view it is of


class PairNetwork(nn.Module):
    """Encoder and votes. Shapes: B pairs of 2 views of P points."""

    def __init__(self, width: int = WIDTH) -> None:
        super().__init__()
        half, twice = width // 2, 2 * width
        self.lift = mlp(FEATURES, half, half)
        self.down1 = mlp(half + 3, width, width)
        self.down2 = mlp(width + 3, twice, twice)
        self.place2 = nn.Linear(PLACE, twice)
        self.between2 = nn.ModuleList([_Attention(twice) for _ in range(2)])
        self.up1 = mlp(twice + width, twice, width)
        self.place1 = nn.Linear(PLACE, width)
        self.between1 = _Attention(width)
        self.up0 = mlp(width + half + FEATURES, width, width)
        self.vote = nn.Sequential(mlp(width, width), nn.Linear(width, VOTES))

    def forward(
        self,
        x: Tensor,
        down1: Tensor,
        down2: Tensor,
        up1: Tensor,
        up0: Tensor,
        weight1: Tensor,
        weight0: Tensor,
    ) -> Tensor:
        """Votes (B, 2, P, VOTES) of clouds (B, 2, P, FEATURES); the rest are pyramids of both views, (B, 2, ...)."""
        b, views, count, _ = x.shape
        x, down1, down2, up1, up0, weight1, weight0 = (
            t.flatten(0, 1) for t in (x, down1, down2, up1, up0, weight1, weight0)
        )
        p0 = x[..., :3]
        p1, p2 = p0[:, : COARSE[0]], p0[:, : COARSE[1]]
        f0 = self.lift(x)
        f1 = pool(self.down1, f0, p0, p1, down1)
        f2 = pool(self.down2, f1, p1, p2, down2)
        f2 = _together(f2 + self.place2(_places(p2, b)), b)
        for block in self.between2:
            f2 = block(f2)
        g1 = self.up1(torch.cat([spread(_apart(f2, b), up1, weight1), f1], -1))
        g1 = _apart(self.between1(_together(g1 + self.place1(_places(p1, b)), b)), b)
        hidden = self.up0(torch.cat([spread(g1, up0, weight0), f0, x], -1))
        return self.vote(hidden).reshape(b, views, count, VOTES)


class _Attention(nn.Module):
    """Every token looks at all tokens of both views (pre-norm transformer block)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.before, self.between = nn.LayerNorm(width), nn.LayerNorm(width)
        self.ask = nn.Linear(width, 3 * width)
        self.join = nn.Linear(width, width)
        self.think = nn.Sequential(nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))

    def forward(self, f: Tensor) -> Tensor:
        b, n, c = f.shape
        q, k, v = (
            self.ask(self.before(f)).reshape(b, n, 3, HEADS, c // HEADS).permute(2, 0, 3, 1, 4).unbind(0)
        )
        seen = functional.scaled_dot_product_attention(q, k, v)
        f = f + self.join(seen.transpose(1, 2).reshape(b, n, c))
        return f + self.think(self.between(f))


def _places(p: Tensor, b: int) -> Tensor:
    """Places of tokens (2B, M, 3) with the number of their view, (2B, M, PLACE)."""
    view = torch.tensor([-1.0, 1.0], dtype=p.dtype, device=p.device).repeat(b).reshape(-1, 1, 1)
    return torch.cat([p, view.expand(-1, p.shape[1], -1)], -1)


def _together(f: Tensor, b: int) -> Tensor:
    return f.reshape(b, -1, f.shape[-1])


def _apart(f: Tensor, b: int) -> Tensor:
    return f.reshape(2 * b, -1, f.shape[-1])
