"""Fit the push network: CPU or CUDA, resumable at every epoch, metrics kept and plotted."""

from __future__ import annotations

import copy
import logging
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.progress import Progress

from s2r_host.learn import checkpoint
from s2r_host.learn.calibrate import Calibration, area_under_curve, calibrate, expected_error
from s2r_host.learn.network import PushNetwork, part_of
from s2r_host.learn.push_files import PushSample, data_hash, load_pushes, push_files
from s2r_host.learn.push_loss import ENCODER_INPUTS, batch, losses
from s2r_host.perception.errors import InputError

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrainSettings:
    """How to fit.

    Attributes:
        epochs: Passes over the training objects.
        batch: Views per step.
        pushes: Pushes per view and step.
        samplings: Clouds drawn from every training view; an epoch uses one of them.
        rate: Largest learning rate; it falls to a hundredth along a cosine.
        weight_decay: Of AdamW.
        averaging: What is used is the exponential average of the weights with this decay per step.
        device: "cpu" or "cuda".
        seed: Of weights, order and sampling.
    """

    epochs: int = 30
    batch: int = 8
    pushes: int = 64
    samplings: int = 2
    rate: float = 3e-3
    weight_decay: float = 1e-2
    averaging: float = 0.995
    device: str = "cpu"
    seed: int = 0


def train_affordance(data: Path, out: Path, settings: TrainSettings, progress: Progress) -> dict[str, Any]:
    """Fit or go on fitting; the final state with its metrics per epoch and the critic's calibration.

    Raises:
        InputError: No data that teaches anything, or ``out`` holds a run on other data, training or
            validation, or with other settings.
    """
    torch.manual_seed(settings.seed)
    files = push_files(data, "train")
    digest = data_hash(files)
    fit = _load(files, settings.seed, settings.samplings, progress, "reading training objects")
    check_files = push_files(data, "validation")
    check_digest = data_hash(check_files)
    check = [s[0] for s in _load(check_files, settings.seed, 1, progress, "reading validation")]
    network = PushNetwork().to(settings.device)
    average = copy.deepcopy(network).requires_grad_(False)
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.rate, weight_decay=settings.weight_decay)
    state = checkpoint.resume(out, network, average, optimiser, asdict(settings), digest, check_digest)
    if state is None:
        state = {"epoch": 0, "settings": asdict(settings), "objects": len(fit), "metrics": []}
        state["data_sha256"] = digest
        state["pushes"] = int(sum(len(s[0].at) for s in fit))
    task = progress.add_task("training", total=settings.epochs, completed=state["epoch"])
    for epoch in range(state["epoch"], settings.epochs):
        start = time.perf_counter()
        for group in optimiser.param_groups:
            group["lr"] = cosine_rate(settings.rate, epoch, settings.epochs)
        row = {"epoch": epoch + 1} | _epoch(network, average, optimiser, fit, settings, epoch)
        figures, calibration = evaluate(average, check, settings)
        row |= {f"validation_{name}": value for name, value in figures.items()}
        row["seconds"] = round(time.perf_counter() - start, 2)
        state["metrics"].append(row)
        state["epoch"], state["calibration"] = epoch + 1, asdict(calibration)
        state["validation_sha256"] = check_digest
        checkpoint.save(out, network, average, optimiser, state, digest, check_digest)
        progress.advance(task)
        logger.info("epoch %d: %s", epoch + 1, row)
    return state


def _epoch(
    network: PushNetwork,
    average: PushNetwork,
    optimiser: torch.optim.Optimizer,
    fit: list[list[PushSample]],
    settings: TrainSettings,
    epoch: int,
) -> dict[str, float]:
    """One pass; mean losses."""
    network.train()
    rng = np.random.default_rng([settings.seed, epoch])
    torch.manual_seed(int(rng.integers(2**63)))  # the proposals' noise; a run that goes on draws the same
    order = rng.permutation(len(fit))
    sums: dict[str, float] = {}
    steps = 0
    for first in range(0, len(order), settings.batch):
        views = (fit[i] for i in order[first : first + settings.batch])
        chosen = [view[rng.integers(len(view))] for view in views]
        data = on_device(settings.device, batch(chosen, settings.pushes, rng, vary=True))
        total, parts, _ = losses(network, data)
        optimiser.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        follow(
            average,
            network,
            min(settings.averaging, 1 - 1 / (1 + steps + epoch * len(order) / settings.batch)),
        )
        steps += 1
        for name, value in parts.items():
            sums[name] = sums.get(name, 0.0) + value
    return {name: value / steps for name, value in sums.items()}


def cosine_rate(largest: float, epoch: int, epochs: int) -> float:
    """Learning rate of an epoch: from ``largest`` down to a hundredth of it."""
    return largest * float(0.01 + 0.99 * 0.5 * (1 + np.cos(np.pi * epoch / epochs)))


def follow(average: torch.nn.Module, network: torch.nn.Module, decay: float) -> None:
    """Move the running average of the weights on."""
    with torch.no_grad():
        for mean, weight in zip(average.parameters(), network.parameters(), strict=True):
            mean.lerp_(weight, 1 - decay)


def evaluate(
    network: PushNetwork, samples: list[PushSample], settings: TrainSettings
) -> tuple[dict[str, float], Calibration]:
    """On unseen objects: losses, areas under the ROC curves, and how the critic's logit must be bent to be a share."""
    network.eval()
    rng = np.random.default_rng([settings.seed, 99])
    logits, truths, part_auc = [], [], []
    sums: dict[str, float] = {}
    with torch.no_grad():
        for sample in samples:
            data = on_device(settings.device, batch([sample], settings.pushes, rng, vary=False))
            _, parts, logit = losses(network, data)
            for name, value in parts.items():
                sums[name] = sums.get(name, 0.0) + value / len(samples)
            logits.append(logit.cpu().numpy().ravel())
            truths.append(data["useful"].cpu().numpy().ravel() > 0.5)
            belief = part_of(network.encode(*(data[name] for name in ENCODER_INPUTS)))
            part_auc.append(area_under_curve(belief[0].cpu().numpy(), sample.part))
    logit, truth = np.concatenate(logits), np.concatenate(truths)
    calibration = calibrate(logit, truth)
    figures = {
        "auc": area_under_curve(logit, truth),
        "part_auc": float(np.mean(part_auc)),
        "calibration_error": expected_error(calibration.likelihood(logit), truth),
    }
    return figures | sums, calibration


def on_device(device: str, data: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The same tensors there."""
    return {name: tensor.to(device) for name, tensor in data.items()}


def _load(files: list[Path], seed: int, times: int, progress: Progress, label: str) -> list[list[PushSample]]:
    """Samplings of every view that shows its object.

    Raises:
        InputError: None does.
    """
    samples = [load_pushes(file, seed, times) for file in progress.track(files, description=label)]
    seen = [some for some in samples if some]
    if not seen:
        raise InputError(
            f"{label}: of {len(files)} objects in {files[0].parent} none shows its part and a push at it that could "
            "begin; make more: s2r data pushes --objects N --pushes N"
        )
    if len(seen) < len(files):
        logger.info("%s: %d of %d objects out of sight", label, len(files) - len(seen), len(files))
    return seen
