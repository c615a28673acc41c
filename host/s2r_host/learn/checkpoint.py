"""Checkpoints of a training run: safetensors for weights and optimiser, JSON for everything a person may read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save_file
from torch import nn

from s2r_host.perception.errors import InputError

WEIGHTS, OPTIMISER, STATE = "weights.safetensors", "optimiser.safetensors", "state.json"


def save(
    folder: Path, network: nn.Module, optimiser: torch.optim.Optimizer, state: dict[str, Any], data_hash: str
) -> None:
    """Write a checkpoint; each file appears whole or not at all, the state last."""
    folder.mkdir(parents=True, exist_ok=True)
    weights = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    _whole(folder / WEIGHTS, lambda path: save_file(weights, path, metadata={"data_sha256": data_hash}))
    moments = {
        f"{index}.{name}": torch.as_tensor(value).detach().cpu().contiguous()
        for index, values in optimiser.state_dict()["state"].items()
        for name, value in values.items()
    }
    _whole(folder / OPTIMISER, lambda path: save_file(moments, path))
    text = json.dumps(state | {"data_sha256": data_hash}, indent=1)
    _whole(folder / STATE, lambda path: path.write_text(text + "\n"))


def resume(
    folder: Path, network: nn.Module, optimiser: torch.optim.Optimizer, data_hash: str
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
    network.load_state_dict(load_file(folder / WEIGHTS))
    full = optimiser.state_dict()
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for key, value in load_file(folder / OPTIMISER).items():
        index, name = key.split(".")
        moments.setdefault(int(index), {})[name] = value
    full["state"] = moments
    optimiser.load_state_dict(full)
    return state


def _whole(path: Path, write: Any) -> None:
    part = path.with_suffix(path.suffix + ".part")
    write(part)
    part.replace(path)
