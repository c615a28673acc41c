"""The baseline: a network in the manner of Ditto, to be measured beside the pair network and geometry.

Ditto (Jiang et al., CVPR 2022, "Building Digital Twins of Articulated Objects from Interaction") as its authors
describe it, written anew: a PointNet++ for both clouds, attention by which the coarse points of the first view look at
those of the second, features of the first view's points on three planes and a grid with U-Nets over them, and five
decoders that answer for any point in the pose of the first view: occupancy from the grid; from the planes part, kind of
joint, hinge (8 numbers) and slide (4 numbers). Points come without normals and without labels of what changed.

The size is given by name: "ditto" has the numbers of the published configuration (but a quarter of the points: hardly
more are kept of a view), "small" is what a CPU can train.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from s2r_host.learn.blocks import mlp, plain, pool, spread
from s2r_host.learn.planes_grids import GRID, PLANES, Decoder, UNet, look_up, put

# Columns of what the planes tell of a point: logits, then the hinge and the slide, lengths in half sides of the cube.
PART, SLIDES = 0, 1
TURN_DIRECTION, TURN_ANGLE, WAY_DIRECTION, WAY_LENGTH = (
    slice(2, 5),
    5,
    slice(6, 9),
    9,
)  # way: to the hinge line
SLIDE_DIRECTION, SLIDE_DISTANCE = slice(10, 13), 13
JOINT = 14
HEADS = 4


@dataclass(frozen=True)
class Size:
    """How large a network is.

    Attributes:
        points: Of each view.
        coarse: Points of the two coarser levels, of each view.
        neighbours: Of each coarser point.
        width: Channels of the points; twice as many at the coarsest level.
        maps: Channels of planes and grid, and of the decoders' input.
        hidden, blocks: Channels and blocks of the decoders.
        plane, plane_maps, plane_levels: Cells per axis of the planes, channels and levels of their U-Net.
        grid, grid_maps, grid_levels: The same of the grid.
    """

    points: int
    coarse: tuple[int, int]
    neighbours: int
    width: int
    maps: int
    hidden: int
    blocks: int
    plane: int
    plane_maps: int
    plane_levels: int
    grid: int
    grid_maps: int
    grid_levels: int


SIZES = {
    "small": Size(384, (96, 48), 12, 64, 32, 32, 3, 32, 16, 4, 12, 16, 2),
    "ditto": Size(2048, (512, 128), 32, 64, 64, 32, 5, 64, 32, 5, 32, 64, 4),
}


class BaselineNetwork(nn.Module):
    """Encoder, planes, grid and decoders. Shapes: B pairs of 2 views of P points, in cubes [-1, 1]³."""

    def __init__(self, size: Size) -> None:
        super().__init__()
        self.size = size
        width, twice = size.width, 2 * size.width
        self.lift = plain(3, width // 2)
        self.down1 = plain(width // 2 + 3, width)
        self.norm1 = nn.LayerNorm(width)
        self.down2 = plain(width + 3, twice)
        self.place = nn.Linear(3, twice)
        self.between = _Between(twice)
        self.up1 = mlp(2 * twice + width, width)
        self.up0 = mlp(width + width // 2 + 3, size.maps)
        self.planes = UNet(2, size.maps, size.plane_maps, size.plane_levels)
        self.grid = UNet(3, size.maps, size.grid_maps, size.grid_levels)
        self.occupancy = Decoder(size.maps, 1, size.hidden, size.blocks)
        self.of_planes = nn.ModuleList(
            [Decoder(size.maps, k, size.hidden, size.blocks) for k in (1, 1, 8, 4)]
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
    ) -> tuple[list[Tensor], Tensor]:
        """Planes (3 times (B, C, R, R)) and grid (B, C, R, R, R) of clouds (B, 2, P, 3).

        The other arguments are pyramids of both views, (B, 2, ...).
        """
        b = len(x)
        p0 = x.flatten(0, 1)
        p1, p2 = p0[:, : self.size.coarse[0]], p0[:, : self.size.coarse[1]]
        f0 = self.lift(p0)
        f1 = self.norm1(pool(self.down1, f0, p0, p1, down1.flatten(0, 1)))
        f2 = pool(self.down2, f1, p1, p2, down2.flatten(0, 1)) + self.place(p2)
        first, second = f2.unflatten(0, (b, 2)).unbind(1)
        both = torch.cat([first, self.between(first, second)], -1)
        f0, f1 = f0.unflatten(0, (b, 2))[:, 0], f1.unflatten(0, (b, 2))[:, 0]
        g1 = self.up1(torch.cat([spread(both, up1[:, 0], weight1[:, 0]), f1], -1))
        g0 = self.up0(torch.cat([spread(g1, up0[:, 0], weight0[:, 0]), f0, x[:, 0]], -1))
        seen = torch.cat([put(g0, x[:, 0], axes, self.size.plane) for axes in PLANES])
        return list(self.planes(seen).chunk(3)), self.grid(put(g0, x[:, 0], GRID, self.size.grid))

    def joint(self, planes: list[Tensor], p: Tensor) -> Tensor:
        """What is told of places p (B, Q, 3) in the first view, (B, Q, `JOINT`)."""
        feature = torch.stack([look_up(m, p, axes) for m, axes in zip(planes, PLANES, strict=True)]).sum(0)
        return torch.cat([decoder(p, feature) for decoder in self.of_planes], -1)

    def occupied(self, grid: Tensor, p: Tensor) -> Tensor:
        """Logits (B, Q) that the part is at places p (B, Q, 3) in the first view."""
        return self.occupancy(p, look_up(grid, p, GRID)).squeeze(-1)


class _Between(nn.Module):
    """What points of the first view find in the second, (B, M, C)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.ask = nn.Linear(width, width)
        self.answer = nn.Linear(width, 2 * width)
        self.join = mlp(width, width)

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        q, k, v = (
            f.unflatten(-1, (HEADS, -1)).transpose(1, 2)
            for f in (self.ask(first), *self.answer(second).chunk(2, -1))
        )
        return self.join(functional.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2))
