"""ONNX graphs of the networks, compared with torch on the spot."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor, nn

from s2r_host.learn.network import FEATURE, IN, NOISE, PushNetwork
from s2r_host.learn.pair_loss import INPUTS as PAIR_INPUTS
from s2r_host.learn.pair_network import WIDTH, PairNetwork
from s2r_host.learn.push_loss import ENCODER_INPUTS
from s2r_host.perception import pair_cloud
from s2r_host.perception.errors import InputError
from s2r_host.perception.object_cloud import COARSE, NEIGHBOURS, POINTS
from s2r_host.perception.pair_space import BESIDES, NEAREST

logger = logging.getLogger(__name__)

MOST_DIFFERENCE = 1e-4
OPSET = 18
PAIR, SPACE = "pair.onnx", "space.onnx"
ENCODER, PROPOSAL, CRITIC, ABOUT = "encoder.onnx", "proposal.onnx", "critic.onnx", "about.json"


class _Encoder(nn.Module):
    def __init__(self, network: PushNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, *inputs: Tensor) -> tuple[Tensor, Tensor]:
        feature = self.network.encode(*inputs)
        return feature, self.network.act(feature)


class _Proposal(nn.Module):
    """Directions for noise, for a list of point features."""

    def __init__(self, network: PushNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, feature: Tensor, noise: Tensor) -> Tensor:
        return self.network.propose(feature, noise)


class _Critic(nn.Module):
    """Verdicts on directions, for a list of point features."""

    def __init__(self, network: PushNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, feature: Tensor, direction: Tensor) -> Tensor:
        return self.network.judge(feature, direction)


class _Space(nn.Module):
    """Occupancy, for a list of points of space."""

    def __init__(self, network: PairNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, beside: Tensor) -> Tensor:
        return self.network.occupied(beside)


def export(network: PushNetwork, folder: Path, about: dict[str, Any]) -> float:
    """Write the graphs and a description; the largest difference from torch.

    Raises:
        InputError: ONNX Runtime computes something else.
    """
    network = network.cpu().eval()
    folder.mkdir(parents=True, exist_ok=True)
    generator = torch.Generator().manual_seed(0)
    feature = torch.randn(100, FEATURE, generator=generator)
    noise = torch.randn(100, NOISE, generator=generator)
    direction = nn.functional.normalize(noise, dim=-1)
    cloud = example_inputs(generator)
    graphs = (
        (_Encoder(network), cloud, ENCODER_INPUTS, ("feature", "actionability"), ENCODER),
        (_Proposal(network), (feature, noise), ("feature", "noise"), ("direction",), PROPOSAL),
        (_Critic(network), (feature, direction), ("feature", "direction"), ("logit",), CRITIC),
    )
    worst = 0.0
    for module, inputs, names, outputs, file in graphs:
        write_graph(module, inputs, names, outputs, folder / file, many=file != ENCODER)
        worst = max(worst, graph_difference(module, inputs, folder / file))
    write_about(folder, about, worst)
    return worst


def export_pair(network: PairNetwork, folder: Path, about: dict[str, Any]) -> float:
    """Write the graphs of the pair network and a description; the largest difference from torch.

    Raises:
        InputError: ONNX Runtime computes something else.
    """
    network = network.cpu().eval()
    folder.mkdir(parents=True, exist_ok=True)
    generator = torch.Generator().manual_seed(0)
    cloud, space = example_pair(generator), _Space(network)
    near = (torch.randn(100, NEAREST, WIDTH + BESIDES, generator=generator),)
    write_graph(network, cloud, PAIR_INPUTS, ("votes", "feature"), folder / PAIR, many=False)
    write_graph(space, near, ("beside",), ("logit",), folder / SPACE, many=True)
    worst = max(
        graph_difference(network, cloud, folder / PAIR), graph_difference(space, near, folder / SPACE)
    )
    write_about(folder, about, worst)
    return worst


def write_about(folder: Path, about: dict[str, Any], worst: float) -> None:
    """Describe the graphs of a folder.

    Raises:
        InputError: ONNX Runtime computes something else than torch.
    """
    if worst > MOST_DIFFERENCE:
        raise InputError(f"ONNX Runtime differs from torch by {worst:.2g}, limit {MOST_DIFFERENCE:g}")
    (folder / ABOUT).write_text(json.dumps(about | {"onnx_difference": worst}, indent=1) + "\n")


def example_pair(generator: torch.Generator) -> tuple[Tensor, ...]:
    """Random inputs of the pair network with the right shapes."""

    def index(high: int, *shape: int) -> Tensor:
        return torch.randint(high, (1, 2, *shape), generator=generator)

    points, coarse, neighbours = pair_cloud.POINTS, pair_cloud.COARSE, pair_cloud.NEIGHBOURS
    return (
        torch.randn(1, 2, points, pair_cloud.FEATURES, generator=generator),
        index(points, coarse[0], neighbours),
        index(coarse[0], coarse[1], neighbours),
        index(coarse[1], coarse[0], 3),
        index(coarse[0], points, 3),
        torch.rand(1, 2, coarse[0], 3, generator=generator),
        torch.rand(1, 2, points, 3, generator=generator),
    )


def example_inputs(generator: torch.Generator) -> tuple[Tensor, ...]:
    """Random inputs of the encoder with the right shapes."""

    def index(high: int, *shape: int) -> Tensor:
        return torch.randint(high, shape, generator=generator)

    return (
        torch.randn(1, POINTS, IN, generator=generator),
        index(POINTS, 1, COARSE[0], NEIGHBOURS),
        index(COARSE[0], 1, COARSE[1], NEIGHBOURS),
        index(COARSE[1], 1, COARSE[0], 3),
        index(COARSE[0], 1, POINTS, 3),
        torch.rand(1, COARSE[0], 3, generator=generator),
        torch.rand(1, POINTS, 3, generator=generator),
    )


def write_graph(
    module: nn.Module,
    inputs: tuple[Tensor, ...],
    names: tuple[str, ...],
    outputs: tuple[str, ...],
    path: Path,
    many: bool,
) -> None:
    """Write one graph; ``many``: the first axis of every input is a free number of pushes."""
    pushes = torch.export.Dim("pushes", min=1)
    shapes = tuple({0: pushes} for _ in inputs) if many else None
    torch.onnx.export(
        module.eval(), inputs, str(path), input_names=list(names), output_names=list(outputs),
        opset_version=OPSET, dynamo=True, dynamic_shapes=shapes, external_data=False, verbose=False,
    )  # fmt: skip
    graph = without_traces(onnx.load(str(path)))
    onnx.checker.check_model(graph)
    onnx.save(graph, str(path))


def without_traces(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same graph without the source lines, with their paths, that the exporter notes on every node."""
    for entry in (model, model.graph, *model.graph.node, *model.graph.value_info, *model.graph.initializer):
        del entry.metadata_props[:]
        entry.doc_string = ""
    return model


def graph_difference(module: nn.Module, inputs: tuple[Tensor, ...], path: Path) -> float:
    """Largest difference between a graph on ONNX Runtime and its module."""
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    feeds = {node.name: tensor.numpy() for node, tensor in zip(session.get_inputs(), inputs, strict=True)}
    with torch.no_grad():
        wanted = module(*inputs)
    wanted = wanted if isinstance(wanted, tuple) else (wanted,)
    found = session.run(None, feeds)
    return max(float(np.abs(np.asarray(a) - b.numpy()).max()) for a, b in zip(found, wanted, strict=True))
