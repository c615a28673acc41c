"""Checkpoints of a training run: safetensors for weights and optimiser, JSON for everything a person may read."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save_file
from torch import nn

from s2r_host.perception.errors import InputError

WEIGHTS, LIVE, OPTIMISER, STATE = (
    "weights.safetensors",
    "live.safetensors",
    "optimiser.safetensors",
    "state.json",
)


def save(
    folder: Path,
    network: nn.Module,
    average: nn.Module,
    optimiser: torch.optim.Optimizer,
    state: dict[str, Any],
    data_hash: str,
) -> None:
    """Write a checkpoint; each file appears whole or not at all, the state last.

    ``average`` holds the running average of the weights, which is what is used; ``network`` those being trained.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, module in ((WEIGHTS, average), (LIVE, network)):
        weights = {key: tensor.detach().cpu().contiguous() for key, tensor in module.state_dict().items()}
        _whole(folder / name, partial(save_file, weights, metadata={"data_sha256": data_hash}))
    moments = {
        f"{index}.{name}": torch.as_tensor(value).detach().cpu().contiguous()
        for index, values in optimiser.state_dict()["state"].items()
        for name, value in values.items()
    }
    _whole(folder / OPTIMISER, partial(save_file, moments))
    text = json.dumps(state | {"data_sha256": data_hash}, indent=1)
    _whole(folder / STATE, lambda path: path.write_text(text + "\n"))


def resume(
    folder: Path,
    network: nn.Module,
    average: nn.Module,
    optimiser: torch.optim.Optimizer,
    data_hash: str,
) -> dict[str, Any] | None:
    """Load a checkpoint if there is one; its state.

    Raises:
        InputError: It was trained on other data.
    """
    if not (folder / STATE).exists():
        return None
    state: dict[str, Any] = json.loads((folder / STATE).read_text())
    if state["data_sha256"] != data_hash:
        raise InputError(
            f"{folder} holds a run on other data (hash {state['data_sha256'][:12]}, here {data_hash[:12]});"
            " name a new --out"
        )
    average.load_state_dict(load_file(folder / WEIGHTS))
    network.load_state_dict(load_file(folder / LIVE))
    full = optimiser.state_dict()
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for key, value in load_file(folder / OPTIMISER).items():
        index, name = key.split(".")
        moments.setdefault(int(index), {})[name] = value
    full["state"] = moments
    optimiser.load_state_dict(full)
    return state


def _whole(path: Path, write: Callable[[Path], Any]) -> None:
    part = path.with_suffix(path.suffix + ".part")
    write(part)
    part.replace(path)
