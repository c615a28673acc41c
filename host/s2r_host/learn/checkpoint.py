"""Checkpoints of a training run: one safetensors file, so that weights, optimiser and state are of one epoch."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import nn

from s2r_host.perception.errors import InputError

logger = logging.getLogger(__name__)

CHECKPOINT, WEIGHTS, STATE = "checkpoint.safetensors", "weights.safetensors", "state.json"
AVERAGE, LIVE, MOMENTS = "average.", "live.", "moments."
MAY_CHANGE = ("device",)  # where it is computed; all others tell what comes out


def save(
    folder: Path,
    network: nn.Module,
    average: nn.Module,
    optimiser: torch.optim.Optimizer,
    state: dict[str, Any],
    data_hash: str,
    validation_hash: str,
) -> None:
    """Write a checkpoint; killed at any moment it leaves this one or the one before, whole.

    ``average`` holds the running average of the weights, which is what is used; ``network`` those being trained.
    The hashes are of the data it is trained on, and of those that its metrics are taken on.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {AVERAGE + key: tensor for key, tensor in average.state_dict().items()}
    tensors |= {LIVE + key: tensor for key, tensor in network.state_dict().items()}
    tensors |= {
        f"{MOMENTS}{index}.{name}": torch.as_tensor(value)
        for index, values in optimiser.state_dict()["state"].items()
        for name, value in values.items()
    }
    tensors = {key: tensor.detach().cpu().contiguous() for key, tensor in tensors.items()}
    state = state | {"data_sha256": data_hash, "validation_sha256": validation_hash}
    _save_whole(folder / CHECKPOINT, tensors, {"state": json.dumps(state)})
    _copy_for_use(folder, tensors, state)


def resume(
    folder: Path,
    network: nn.Module,
    average: nn.Module,
    optimiser: torch.optim.Optimizer,
    settings: dict[str, Any],
    data_hash: str,
    validation_hash: str,
) -> dict[str, Any] | None:
    """Load a checkpoint if there is one; its state.

    A checkpoint of before the validation data was hashed goes on, which is said: the next one has the hash.

    Raises:
        InputError: It was trained on other data, measured on other validation data or made with other settings, or by
            an earlier version.
    """
    if not (folder / CHECKPOINT).exists():
        if (folder / STATE).exists():
            raise InputError(f"{folder} holds a run of an earlier version of s2r; name a new --out")
        return None
    with safe_open(folder / CHECKPOINT, "pt") as file:
        state: dict[str, Any] = json.loads(file.metadata()["state"])
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 - no dictionary
    _check_same_run(folder, state, settings, data_hash, validation_hash)
    _copy_for_use(folder, tensors, state)  # the run may have been killed before it did
    average.load_state_dict(_part(tensors, AVERAGE))
    network.load_state_dict(_part(tensors, LIVE))
    full = optimiser.state_dict()
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for key, value in _part(tensors, MOMENTS).items():
        index, name = key.split(".")
        moments.setdefault(int(index), {})[name] = value
    full["state"] = moments
    optimiser.load_state_dict(full)
    return state | {"settings": settings}


def _check_same_run(
    folder: Path, state: dict[str, Any], settings: dict[str, Any], data_hash: str, validation_hash: str
) -> None:
    if state["data_sha256"] != data_hash:
        raise InputError(
            f"{folder} holds a run on other data (hash {state['data_sha256'][:12]}, here {data_hash[:12]});"
            " name a new --out"
        )
    measured_on = state.get("validation_sha256")
    if measured_on is None:
        logger.warning(
            "%s does not say which validation data it was measured on so far (to epoch %d): whether these are the same"
            " cannot be checked; it notes these with the next epoch",
            folder,
            state["epoch"],
        )
    elif measured_on != validation_hash:  # its curve would be of two sets of objects
        raise InputError(
            f"{folder} holds a run measured on other validation data (hash {measured_on[:12]}, here"
            f" {validation_hash[:12]}): give the same ones with --data, or name a new --out"
        )
    before = state["settings"]
    other = [
        f"{name} {before.get(name)}, here {settings.get(name)}"
        for name in sorted((before.keys() | settings.keys()) - set(MAY_CHANGE))
        if before.get(name) != settings.get(name)
    ]
    if other:  # more epochs, too, are another run: the learning rate falls along all of them
        raise InputError(
            f"{folder} holds a run with other settings ({'; '.join(other)}): give the same ones, or name a new --out"
        )


def _part(tensors: dict[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    return {key.removeprefix(prefix): tensor for key, tensor in tensors.items() if key.startswith(prefix)}


def _copy_for_use(folder: Path, tensors: dict[str, torch.Tensor], state: dict[str, Any]) -> None:
    """The weights alone for who uses them, and the state for who reads it: copies from the checkpoint, which counts."""
    _save_whole(folder / WEIGHTS, _part(tensors, AVERAGE), {"data_sha256": state["data_sha256"]})
    (folder / STATE).write_text(json.dumps(state, indent=1) + "\n")


def _save_whole(path: Path, tensors: dict[str, torch.Tensor], metadata: dict[str, str]) -> None:
    part = path.with_suffix(path.suffix + ".part")
    save_file(tensors, part, metadata=metadata)
    part.replace(path)
