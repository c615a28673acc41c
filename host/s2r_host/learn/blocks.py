"""Blocks of the networks here, in the manner of PointNet++ (Qi et al., NeurIPS 2017).

Neighbour indices come from outside (`s2r_host.perception.object_cloud.pyramid`), so that the graphs are nothing but
gathers and small matrix products.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn


def mlp(*sizes: int) -> nn.Sequential:
    """Linear layers of these sizes, each with LayerNorm and GELU."""
    layers: list[nn.Module] = []
    for a, b in pairwise(sizes):
        layers += [nn.Linear(a, b), nn.LayerNorm(b), nn.GELU()]
    return nn.Sequential(*layers)


def plain(inputs: int, outputs: int) -> nn.Sequential:
    """Two linear layers without norms, for what is done to every neighbour."""
    return nn.Sequential(nn.Linear(inputs, outputs), nn.ReLU(), nn.Linear(outputs, outputs))


def take(f: Tensor, index: Tensor) -> Tensor:
    """Rows of f (B, N, C) at index (B, M, K): (B, M, K, C)."""
    b, m, k = index.shape
    flat = index.reshape(b, m * k, 1).expand(-1, -1, f.shape[-1])
    return torch.gather(f, 1, flat).reshape(b, m, k, f.shape[-1])


def spread(f: Tensor, index: Tensor, weight: Tensor) -> Tensor:
    """Coarse features to finer points by their three nearest."""
    return (take(f, index) * weight.unsqueeze(-1)).sum(dim=2)


def pool(layer: nn.Module, f: Tensor, p: Tensor, centre: Tensor, index: Tensor) -> Tensor:
    """Set abstraction: the largest of ``layer`` over each centre's neighbours, (B, M, C').

    Args:
        layer: Of feature and offset.
        f, p: Features (B, N, C) and places (B, N, 3) of the finer points.
        centre: Places of the coarser points, (B, M, 3).
        index: Their neighbours, (B, M, K).
    """
    near = take(torch.cat([f, p], -1), index)
    offset = near[..., -3:] - centre.unsqueeze(2)
    return layer(torch.cat([near[..., :-3], offset], -1)).amax(dim=2)
