"""The pair network: which points moved, about what, how far, and where the part is that nobody saw, from two clouds.

What Ditto does (Jiang et al., CVPR 2022) at the size of this project: one PointNet++ (Qi et al., NeurIPS 2017) for both
views, attention between the coarse points of both so that each finds where its piece went, votes per point
(`s2r_host.perception.pair_votes`), and an occupancy of the part for any point of space from the features of the points
around it (`s2r_host.perception.pair_space`).

Nonlinearities and norms cost more than products on a CPU: the layers within neighbourhoods have none of the norms.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from s2r_host.learn.blocks import mlp, plain, pool, spread
from s2r_host.perception.pair_cloud import COARSE, FEATURES
from s2r_host.perception.pair_space import BESIDES
from s2r_host.perception.pair_votes import VOTES

WIDTH, HEADS = 64, 4
PLACE = 4  # of a token: where it is [dm], and which view it is of


class PairNetwork(nn.Module):
    """Encoder, votes and occupancy. Shapes: B pairs of 2 views of P points."""

    def __init__(self, width: int = WIDTH) -> None:
        super().__init__()
        half, twice = width // 2, 2 * width
        self.lift = nn.Sequential(nn.Linear(FEATURES, half), nn.ReLU(), nn.Linear(half, half), nn.ReLU())
        self.down1 = plain(half + 3, width)
        self.norm1 = nn.LayerNorm(width)
        self.down2 = plain(width + 3, twice)
        self.place2 = nn.Linear(PLACE, twice)
        self.between2 = nn.ModuleList([_Attention(twice) for _ in range(2)])
        self.up1 = mlp(twice + width, width)
        self.place1 = nn.Linear(PLACE, width)
        self.between1 = nn.ModuleList([_Attention(width) for _ in range(2)])
        self.up0 = mlp(width + half + FEATURES, width)
        self.vote = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, VOTES))
        self.space = nn.Sequential(nn.Linear(width + BESIDES, width), nn.ReLU(), nn.Linear(width, width))
        self.full = nn.Sequential(
            nn.Linear(2 * width + BESIDES, width),
            nn.ReLU(),
            nn.Linear(width, half),
            nn.ReLU(),
            nn.Linear(half, 1),
        )

    def forward(
        self,
        x: Tensor,
        down1: Tensor,
        down2: Tensor,
        up1: Tensor,
        up0: Tensor,
        weight1: Tensor,
        weight0: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Votes (B, 2, P, VOTES) and features (B, 2, P, WIDTH) of clouds (B, 2, P, FEATURES).

        The other arguments are pyramids of both views, (B, 2, ...).
        """
        b, views, count, _ = x.shape
        x, down1, down2, up1, up0, weight1, weight0 = (
            t.flatten(0, 1) for t in (x, down1, down2, up1, up0, weight1, weight0)
        )
        p0 = x[..., :3]
        p1, p2 = p0[:, : COARSE[0]], p0[:, : COARSE[1]]
        f0 = self.lift(x)
        f1 = self.norm1(pool(self.down1, f0, p0, p1, down1))
        f2 = pool(self.down2, f1, p1, p2, down2)
        f2 = _together(f2 + self.place2(_places(p2, b)), b)
        for block in self.between2:
            f2 = block(f2)
        g1 = self.up1(torch.cat([spread(_apart(f2, b), up1, weight1), f1], -1))
        g1 = _together(g1 + self.place1(_places(p1, b)), b)
        for block in self.between1:
            g1 = block(g1)
        hidden = self.up0(torch.cat([spread(_apart(g1, b), up0, weight0), f0, x], -1))
        vote = self.vote(hidden)
        return vote.reshape(b, views, count, VOTES), hidden.reshape(b, views, count, -1)

    def occupied(self, beside: Tensor) -> Tensor:
        """Logits (Q,) that the part is at points of space, from those beside them (Q, NEAREST, WIDTH + BESIDES)."""
        around = self.space(beside).amax(dim=1)
        return self.full(torch.cat([around, beside[:, 0]], -1)).squeeze(-1)


class _Attention(nn.Module):
    """Every token looks at all tokens of both views (pre-norm transformer block)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.before, self.between = nn.LayerNorm(width), nn.LayerNorm(width)
        self.ask = nn.Linear(width, 3 * width)
        self.join = nn.Linear(width, width)
        self.think = nn.Sequential(nn.Linear(width, 2 * width), nn.ReLU(), nn.Linear(2 * width, width))

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
