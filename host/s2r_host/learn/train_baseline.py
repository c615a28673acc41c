"""Fit the baseline by the loop and on the pairs of the pair network: resumable, metrics kept and plotted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.progress import Progress

from s2r_host.learn.baseline import mean_joint
from s2r_host.learn.baseline_draws import baseline_batch, draw_plain, in_cube
from s2r_host.learn.baseline_loss import baseline_losses
from s2r_host.learn.baseline_network import PART, SIZES, BaselineNetwork
from s2r_host.learn.pair_files import PairSample
from s2r_host.learn.pair_loss import varied
from s2r_host.learn.train import on_device
from s2r_host.learn.train_model import ModelSettings, Taught, figures_of, fit_pairs
from s2r_host.perception.pair_votes import errors


@dataclass(frozen=True)
class BaselineSettings(ModelSettings):
    """How to fit, and how large a network: a name of `baseline_network.SIZES`."""

    epochs: int = 40
    rate: float = 1e-3
    size: str = "small"


def train_baseline(data: Path, out: Path, settings: BaselineSettings, progress: Progress) -> dict[str, Any]:
    """Fit or go on fitting; the final state with its metrics per epoch.

    Raises:
        InputError: As `train_model.fit_pairs`.
    """
    size = SIZES[settings.size]

    def draw(one: PairSample, rng: np.random.Generator, back: bool) -> Any:
        return draw_plain(one, size, rng, back)

    taught = Taught(partial(BaselineNetwork, size), draw, baseline_batch, baseline_losses, evaluate_baseline)
    return fit_pairs(taught, data, out, settings, progress)


def evaluate_baseline(
    network: BaselineNetwork, samples: list[PairSample], settings: BaselineSettings
) -> dict[str, float]:
    """On unseen objects: mean losses, and the figures of `train_model.evaluate`; ``iou`` is of the first view alone."""
    network.eval()
    sums: dict[str, float] = {}
    right, iou, silent = [], [], 0
    axis, line, turn, slide = [], [], [], []
    with torch.no_grad():
        for k, one in enumerate(samples):
            drawn = draw_plain(one, network.size, np.random.default_rng([99, k]))
            data = baseline_batch([drawn], np.random.default_rng(0), vary=False)
            _, parts, told = baseline_losses(network, on_device(settings.device, data))
            for name, value in parts.items():
                sums[name] = sums.get(name, 0.0) + value / len(samples)
            cloud, (motion, *_), _ = varied(drawn.cloud, drawn.motions, 0.0, False, 1.0)
            out = told[0].cpu().numpy()
            found = mean_joint(cloud, out, in_cube(cloud.points, cloud)[1])
            if found is None:
                silent += 1
                continue
            iou.append(
                float((drawn.part & (out[:, PART] > 0)).sum() / (drawn.part | (out[:, PART] > 0)).sum())
            )
            right.append(found.joint_type == motion.joint_type)
            if not right[-1]:
                continue
            angle, gap, delta = errors(found, motion, cloud.centre)
            axis.append(np.degrees(angle))
            if found.joint_type == "revolute":
                line.append(1e3 * gap)
                turn.append(np.degrees(abs(delta)))
            else:
                slide.append(1e3 * abs(delta))
    errors_of = {"axis_deg": axis, "line_mm": line, "turn_deg": turn, "slide_mm": slide}
    return figures_of(errors_of, right, iou) | {"silent": silent / len(samples)} | sums
