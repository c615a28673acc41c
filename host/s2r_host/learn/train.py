"""Fit the push network: CPU or CUDA, resumable at every epoch, metrics kept and plotted."""

from __future__ import annotations

import logging
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.progress import Progress

from s2r_host.learn import checkpoint
from s2r_host.learn.network import PushNetwork
from s2r_host.learn.push_files import PushSample, data_hash, load_pushes, push_files
from s2r_host.learn.push_loss import batch, losses

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrainSettings:
    """How to fit.

    Attributes:
        epochs: Passes over the training objects.
        batch: Objects per step.
        pushes: Pushes per object and step.
        rate: Largest learning rate; it falls to a hundredth along a cosine.
        weight_decay: Of AdamW.
        device: "cpu" or "cuda".
        seed: Of weights, order and sampling.
    """

    epochs: int = 60
    batch: int = 8
    pushes: int = 32
    rate: float = 2e-3
    weight_decay: float = 1e-3
    device: str = "cpu"
    seed: int = 0


def train_affordance(data: Path, out: Path, settings: TrainSettings, progress: Progress) -> dict[str, Any]:
    """Fit or go on fitting; the final state with its metrics per epoch.

    Raises:
        InputError: No data, or ``out`` holds a run on other data.
    """
    torch.manual_seed(settings.seed)
    files = push_files(data, "train")
    digest = data_hash(files)
    fit = _load(files, settings.seed, progress, "reading training objects")
    check = _load(push_files(data, "validation"), settings.seed, progress, "reading validation objects")
    network = PushNetwork().to(settings.device)
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.rate, weight_decay=settings.weight_decay)
    state = checkpoint.resume(out, network, optimiser, digest)
    if state is None:
        state = {"epoch": 0, "settings": asdict(settings), "objects": len(fit), "metrics": []}
        state["data_sha256"] = digest
        state["pushes"] = int(sum(len(s.at) for s in fit))
    useful = float(np.mean(np.concatenate([s.useful for s in fit])))
    weight = (1 - useful) / max(useful, 1e-3)
    task = progress.add_task("training", total=settings.epochs, completed=state["epoch"])
    for epoch in range(state["epoch"], settings.epochs):
        start = time.perf_counter()
        rate = settings.rate * (0.01 + 0.99 * 0.5 * (1 + np.cos(np.pi * epoch / settings.epochs)))
        for group in optimiser.param_groups:
            group["lr"] = rate
        row = {"epoch": epoch + 1} | _epoch(network, optimiser, fit, settings, weight, epoch)
        row |= {f"validation_{name}": value for name, value in evaluate(network, check, settings).items()}
        row["seconds"] = round(time.perf_counter() - start, 2)
        state["metrics"].append(row)
        state["epoch"] = epoch + 1
        checkpoint.save(out, network, optimiser, state, digest)
        progress.advance(task)
        logger.info("epoch %d: %s", epoch + 1, row)
    return state


def _epoch(
    network: PushNetwork,
    optimiser: torch.optim.Optimizer,
    samples: list[PushSample],
    settings: TrainSettings,
    weight: float,
    epoch: int,
) -> dict[str, float]:
    """One pass; mean losses."""
    network.train()
    rng = np.random.default_rng([settings.seed, epoch])
    order = rng.permutation(len(samples))
    sums: dict[str, float] = {}
    steps = 0
    for first in range(0, len(order), settings.batch):
        chosen = [samples[i] for i in order[first : first + settings.batch]]
        data = {
            name: tensor.to(settings.device)
            for name, tensor in batch(chosen, settings.pushes, rng, turn=True).items()
        }
        total, parts, _ = losses(network, data, weight)
        optimiser.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        steps += 1
        for name, value in parts.items():
            sums[name] = sums.get(name, 0.0) + value
    return {name: value / steps for name, value in sums.items()}


def evaluate(network: PushNetwork, samples: list[PushSample], settings: TrainSettings) -> dict[str, float]:
    """Area under the critic's ROC curve and its loss on unseen objects."""
    network.eval()
    rng = np.random.default_rng([settings.seed, 99])
    logits, truths, total = [], [], 0.0
    with torch.no_grad():
        for sample in samples:
            data = {
                name: tensor.to(settings.device)
                for name, tensor in batch([sample], settings.pushes, rng, turn=False).items()
            }
            _, parts, logit = losses(network, data, 1.0)
            total += parts["critic"]
            logits.append(logit.cpu().numpy().ravel())
            truths.append(data["useful"].cpu().numpy().ravel())
    return {
        "auc": area_under_curve(np.concatenate(logits), np.concatenate(truths) > 0.5),
        "critic": total / len(samples),
    }


def area_under_curve(score: np.ndarray, truth: np.ndarray) -> float:
    """Probability that a useful push scores above a useless one; 0.5 if there is only one sort."""
    good, bad = score[truth], score[~truth]
    if len(good) == 0 or len(bad) == 0:
        return 0.5
    order = np.argsort(np.concatenate([good, bad]), kind="stable")
    rank = np.empty(len(order))
    rank[order] = np.arange(1, len(order) + 1)
    return float((rank[: len(good)].sum() - len(good) * (len(good) + 1) / 2) / (len(good) * len(bad)))


def _load(files: list[Path], seed: int, progress: Progress, label: str) -> list[PushSample]:
    samples = []
    for file in progress.track(files, description=label):
        sample = load_pushes(file, seed)
        if sample is not None:
            samples.append(sample)
    if len(samples) < len(files):
        logger.info("%s: %d of %d objects out of sight", label, len(files) - len(samples), len(files))
    return samples
