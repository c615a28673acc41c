"""Fit the pair network: CPU or CUDA, resumable at every epoch, metrics kept and plotted.

The baseline is fitted by the same loop on the same pairs (`s2r_host.learn.train_baseline`).
"""

from __future__ import annotations

import copy
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.progress import Progress
from torch import Tensor, nn

from s2r_host.learn import checkpoint
from s2r_host.learn.pair_draws import draw
from s2r_host.learn.pair_files import PairSample, load_pairs, pair_files
from s2r_host.learn.pair_loss import batch, losses
from s2r_host.learn.pair_network import PairNetwork
from s2r_host.learn.push_files import data_hash
from s2r_host.learn.train import cosine_rate, follow, on_device
from s2r_host.perception.errors import InputError
from s2r_host.perception.pair_cloud import facing
from s2r_host.perception.pair_votes import Votes, errors

logger = logging.getLogger(__name__)

DRAWS = 2  # of points of every pair, forwards and back; an epoch uses one of them


@dataclass(frozen=True)
class ModelSettings:
    """How to fit.

    Attributes:
        epochs: Passes over the training pairs.
        batch: Pairs per step.
        rate: Largest learning rate; it falls to a hundredth along a cosine.
        weight_decay: Of AdamW.
        averaging: What is used is the exponential average of the weights with this decay per step.
        device: "cpu" or "cuda".
        seed: Of weights, order, points and poses.
    """

    epochs: int = 24
    batch: int = 8
    rate: float = 1.5e-3
    weight_decay: float = 1e-2
    averaging: float = 0.995
    device: str = "cpu"
    seed: int = 0


@dataclass(frozen=True)
class Taught:
    """What is fitted.

    Attributes:
        network: Makes it, with random weights.
        draw: One sample of a pair's points, the other way round if the last argument is true.
        batch: Such samples as tensors; varied at random if the last argument is true.
        losses: Total loss, its parts by name, and what the network said.
        evaluate: Figures on unseen objects.
    """

    network: Callable[[], nn.Module]
    draw: Callable[[PairSample, np.random.Generator, bool], Any]
    batch: Callable[[Sequence[Any], np.random.Generator, bool], dict[str, Tensor]]
    losses: Callable[[Any, dict[str, Tensor]], tuple[Tensor, dict[str, float], Tensor]]
    evaluate: Callable[[Any, list[PairSample], Any], dict[str, float]]


def train_model(data: Path, out: Path, settings: ModelSettings, progress: Progress) -> dict[str, Any]:
    """Fit the pair network, see `fit_pairs`."""
    return fit_pairs(Taught(PairNetwork, draw, batch, losses, evaluate), data, out, settings, progress)


def fit_pairs(
    taught: Taught, data: Path, out: Path, settings: ModelSettings, progress: Progress
) -> dict[str, Any]:
    """Fit or go on fitting; the final state with its metrics per epoch.

    Raises:
        InputError: No data that teaches anything, or ``out`` holds a run on other data, training or
            validation, or with other settings.
    """
    torch.manual_seed(settings.seed)
    files = pair_files(data, "train")
    digest = data_hash(files)
    fit = _load(files, progress, "reading training pairs")
    check_files = pair_files(data, "validation")
    check_digest = data_hash(check_files)
    check = _load(check_files, progress, "reading validation pairs")
    network = taught.network().to(settings.device)
    average = copy.deepcopy(network).requires_grad_(False)
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.rate, weight_decay=settings.weight_decay)
    state = checkpoint.resume(out, network, average, optimiser, asdict(settings), digest, check_digest)
    if state is None:
        state = {
            "epoch": 0,
            "settings": asdict(settings),
            "objects": len(files),
            "pairs": len(fit),
            "metrics": [],
        }
        state |= {"data_sha256": digest, "parameters": sum(p.numel() for p in network.parameters())}
        state["kinds"] = {kind: sum(s.kind == kind for s in fit) for kind in sorted({s.kind for s in fit})}
    draws = [
        [
            taught.draw(one, np.random.default_rng([settings.seed, k, turn]), turn == 1)
            for turn in range(DRAWS)
        ]
        for k, one in enumerate(progress.track(fit, description="drawing points"))
    ]
    task = progress.add_task("training", total=settings.epochs, completed=state["epoch"])
    for epoch in range(state["epoch"], settings.epochs):
        start = time.perf_counter()
        for group in optimiser.param_groups:
            group["lr"] = cosine_rate(settings.rate, epoch, settings.epochs)
        row = {"epoch": epoch + 1} | _epoch(taught, network, average, optimiser, draws, settings, epoch)
        row |= {
            f"validation_{name}": value for name, value in taught.evaluate(average, check, settings).items()
        }
        row["seconds"] = round(time.perf_counter() - start, 2)
        state["metrics"].append(row)
        state["epoch"], state["validation_sha256"] = epoch + 1, check_digest
        checkpoint.save(out, network, average, optimiser, state, digest, check_digest)
        progress.advance(task)
        logger.info("epoch %d: %s", epoch + 1, row)
    return state


def _epoch(
    taught: Taught,
    network: nn.Module,
    average: nn.Module,
    optimiser: torch.optim.Optimizer,
    fit: list[list[Any]],
    settings: ModelSettings,
    epoch: int,
) -> dict[str, float]:
    """One pass; mean losses."""
    network.train()
    rng = np.random.default_rng([settings.seed, epoch])
    order = rng.permutation(len(fit))
    steps, sums = 0, dict[str, float]()
    for first in range(0, len(order), settings.batch):
        chosen = [fit[i][(epoch + i) % DRAWS] for i in order[first : first + settings.batch]]
        total, parts, _ = taught.losses(network, on_device(settings.device, taught.batch(chosen, rng, True)))
        optimiser.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        done = steps + epoch * len(order) / settings.batch
        follow(average, network, min(settings.averaging, 1 - 1 / (1 + done)))
        steps += 1
        for name, value in parts.items():
            sums[name] = sums.get(name, 0.0) + value
    return {name: value / steps for name, value in sums.items()}


def evaluate(network: PairNetwork, samples: list[PairSample], settings: ModelSettings) -> dict[str, float]:
    """On unseen objects: mean losses; type, part and joint as one pass over one sample of points gives them.

    Medians are over the pairs whose type is right, and left out where there are none; ``iou`` is that of the part over
    the points of both views, ``silent`` the share of pairs without an opinion.
    """
    network.eval()
    sums: dict[str, float] = {}
    right, iou, silent = [], [], 0
    axis, line, turn, slide, flows = [], [], [], [], []
    with torch.no_grad():
        for k, one in enumerate(samples):
            drawn = draw(one, np.random.default_rng([99, k]))
            data = on_device(settings.device, batch([drawn], np.random.default_rng(0), vary=False))
            _, parts, out = losses(network, data)
            for name, value in parts.items():
                sums[name] = sums.get(name, 0.0) + value / len(samples)
            cloud = drawn.cloud
            votes = Votes.of(cloud, out[0].cpu().numpy(), facing(cloud.heading))
            found = votes.opinion()
            if found is None:
                silent += 1
                continue
            true = data["part"].flatten().cpu().numpy() > 0.5
            iou.append(float((true & (found.part > 0.5)).sum() / max((true | (found.part > 0.5)).sum(), 1)))
            best = found.best()
            right.append(best.joint_type == one.motion.joint_type)
            if not right[-1]:
                continue
            angle, gap, delta = errors(best, one.motion, one.centre)
            before, after, _ = votes.where()
            X = one.motion.transform()
            flows.append(
                1e3 * float(np.median(np.linalg.norm(before @ X[:3, :3].T + X[:3, 3] - after, axis=1)))
            )
            axis.append(np.degrees(angle))
            if best.joint_type == "revolute":
                line.append(1e3 * gap)
                turn.append(np.degrees(abs(delta)))
            else:
                slide.append(1e3 * abs(delta))
    errors_of = {"axis_deg": axis, "line_mm": line, "turn_deg": turn, "slide_mm": slide, "flow_mm": flows}
    return figures_of(errors_of, right, iou) | {"silent": silent / len(samples)} | sums


def figures_of(
    medians: dict[str, list[float]], right: Sequence[bool], iou: Sequence[float]
) -> dict[str, float]:
    """Medians of errors where there are any, the axis' 90th percentile, and the means of ``right`` and ``iou``."""
    figures = {name: float(np.median(values)) for name, values in medians.items() if values}
    if medians["axis_deg"]:
        figures["axis_p90_deg"] = float(np.percentile(medians["axis_deg"], 90))
    means = {"type_right": right, "iou": iou}
    return figures | {name: float(np.mean(values)) if values else 0.0 for name, values in means.items()}


def _load(files: list[Path], progress: Progress, label: str) -> list[PairSample]:
    """All pairs that show their motion.

    Raises:
        InputError: None does.
    """
    samples = [one for file in progress.track(files, description=label) for one in load_pairs(file)]
    if not samples:
        raise InputError(
            f"{label}: of {len(files)} objects in {files[0].parent} no pair of views shows what moved; make more: "
            "s2r data pairs --objects N"
        )
    logger.info("%s: %d pairs of %d objects", label, len(samples), len(files))
    return samples
