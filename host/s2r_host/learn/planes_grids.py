"""Features of points on planes and grids, and U-Nets over them, as in convolutional occupancy networks.

Peng et al., ECCV 2020; Ditto (Jiang et al., CVPR 2022) uses both. Points p lie in the cube [-1, 1]³. A plane is named
by the two axes along it, a grid by all three; ``maps`` are (B, C, R, R) or (B, C, R, R, R), in the order of the axes.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

PLANES = ((0, 1), (0, 2), (1, 2))
GRID = (0, 1, 2)
GROUPS = 8  # of channels that are normalised together


def put(f: Tensor, p: Tensor, axes: Sequence[int], cells: int) -> Tensor:
    """Mean feature of the points in each of ``cells`` per axis: maps of features (B, N, C) at p (B, N, 3)."""
    at = ((p[..., list(axes)] + 1) / 2 * cells).long().clamp(0, cells - 1)
    flat = torch.zeros_like(at[..., 0])
    for k in range(len(axes)):
        flat = flat * cells + at[..., k]
    b, _, c = f.shape
    index = flat.unsqueeze(-1).expand(-1, -1, c)
    maps = f.new_zeros(b, cells ** len(axes), c).scatter_reduce(1, index, f, "mean", include_self=False)
    return maps.transpose(1, 2).reshape(b, c, *[cells] * len(axes))


def look_up(maps: Tensor, p: Tensor, axes: Sequence[int]) -> Tensor:
    """Features (B, Q, C) at p (B, Q, 3), between the middles of cells by linear interpolation."""
    # grid_sample counts the axes of its maps from the last one.
    at = p[..., list(reversed(axes))].reshape(len(p), *[1] * (len(axes) - 1), -1, len(axes))
    found = functional.grid_sample(maps, at, mode="bilinear", padding_mode="border", align_corners=False)
    return found.flatten(2).transpose(1, 2)


class UNet(nn.Module):
    """Two convolutions per level, channels doubled downwards, features of the same level joined on the way up."""

    def __init__(self, axes: int, channels: int, maps: int, levels: int) -> None:
        """``axes``: 2 or 3. ``channels``: in and out. ``maps``: of the finest level."""
        super().__init__()
        sizes = [maps * 2**k for k in range(levels)]
        self.shrink = functional.max_pool2d if axes == 2 else functional.max_pool3d
        self.down = nn.ModuleList(
            [_twice(axes, a, b) for a, b in zip([channels, *sizes[:-1]], sizes, strict=True)]
        )
        self.up = nn.ModuleList([_twice(axes, 3 * size, size) for size in reversed(sizes[:-1])])
        self.out = (nn.Conv2d if axes == 2 else nn.Conv3d)(maps, channels, 1)

    def forward(self, maps: Tensor) -> Tensor:
        """Maps of the same shape."""
        passed: list[Tensor] = []
        for k, block in enumerate(self.down):
            maps = block(self.shrink(maps, 2) if k else maps)
            passed.append(maps)
        passed.pop()
        for block in self.up:
            beside = passed.pop()
            maps = block(torch.cat([beside, functional.interpolate(maps, size=beside.shape[2:])], 1))
        return self.out(maps)


def _twice(axes: int, inputs: int, outputs: int) -> nn.Sequential:
    convolution = nn.Conv2d if axes == 2 else nn.Conv3d
    # In space the published U-Net grows with its second convolution only, where it grows.
    middle = outputs if axes == 2 or inputs > outputs else max(outputs // 2, inputs)
    layers: list[nn.Module] = []
    for a, b in ((inputs, middle), (middle, outputs)):
        layers += [convolution(a, b, 3, padding=1), nn.GroupNorm(GROUPS, b), nn.ReLU()]
    return nn.Sequential(*layers)


class Decoder(nn.Module):
    """What is at a point: residual blocks, each of which is told the feature anew (Mescheder et al., CVPR 2019)."""

    def __init__(self, feature: int, outputs: int, hidden: int, blocks: int) -> None:
        super().__init__()
        self.place = nn.Linear(3, hidden)
        self.feature = nn.ModuleList([nn.Linear(feature, hidden) for _ in range(blocks)])
        self.block = nn.ModuleList(
            [
                nn.Sequential(nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, hidden))
                for _ in range(blocks)
            ]
        )
        self.out = nn.Sequential(nn.ReLU(), nn.Linear(hidden, outputs))

    def forward(self, p: Tensor, feature: Tensor) -> Tensor:
        """(B, Q, outputs) from places (B, Q, 3) and features (B, Q, C)."""
        hidden = self.place(p)
        for told, block in zip(self.feature, self.block, strict=True):
            hidden = hidden + told(feature)
            hidden = hidden + block(hidden)
        return self.out(hidden)
