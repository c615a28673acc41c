"""``s2r train``: fit a network on simulated data and export it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from s2r_protocol.cli.options import SEED
from s2r_protocol.exits import UsageError

_PAIRS = click.option(
    "--data", type=click.Path(path_type=Path, exists=True), required=True, help="From 's2r data pairs'."
)
_OUT = click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder; an interrupted run goes on."
)
_DEVICE = click.option(
    "--device", type=click.Choice(["auto", "cpu", "cuda"]), default="auto", show_default=True
)
_SEED = click.option("--seed", type=SEED, default=0, show_default=True)


@click.group()
def train() -> None:
    """Train the networks of perception (install the extra 'learn')."""


@train.command()
@click.option(
    "--data", type=click.Path(path_type=Path, exists=True), required=True, help="From 's2r data pushes'."
)
@_OUT
@click.option("--epochs", type=int, help="Passes over the data [default: 30].")
@_DEVICE
@_SEED
def affordance(data: Path, out: Path, epochs: int | None, device: str, seed: int) -> None:
    """Where to push: actionability, proposals and likelihood of a useful push."""
    from rich.console import Console
    from rich.progress import Progress

    from s2r_host.learn.export import export
    from s2r_host.learn.network import PushNetwork
    from s2r_host.learn.plot import plot_metrics
    from s2r_host.learn.train import TrainSettings, train_affordance

    settings = TrainSettings(device=_device(device), seed=seed)
    if epochs is not None:
        settings = replace(settings, epochs=_at_least_one(epochs))
    with Progress(console=Console(stderr=True)) as progress:
        state = train_affordance(data, out, settings, progress)
    plot_metrics(state["metrics"], out / "metrics.png")
    network = PushNetwork()
    from safetensors.torch import load_file

    network.load_state_dict(load_file(out / "weights.safetensors"))
    names = ("data_sha256", "objects", "pushes", "epoch", "settings", "calibration")
    about = {name: state[name] for name in names}
    last = state["metrics"][-1]
    about |= {name: value for name, value in last.items() if name.startswith("validation_")}
    about["command"] = (
        f"s2r train affordance --data {data} --out {out} --epochs {settings.epochs} --seed {seed}"
    )
    worst = export(network, out, about)
    click.echo(
        f"{state['epoch']} epochs on {state['objects']} objects, {state['pushes']} pushes; validation AUC"
        f" {last['validation_auc']:.3f}; ONNX differs by {worst:.1g}; in {out}"
    )


@train.command()
@_PAIRS
@_OUT
@click.option("--epochs", type=int, help="Passes over the data [default: 24].")
@_DEVICE
@_SEED
def model(data: Path, out: Path, epochs: int | None, device: str, seed: int) -> None:
    """What moved, about what and how far: votes of the points of two views."""
    from rich.console import Console
    from rich.progress import Progress
    from safetensors.torch import load_file

    from s2r_host.learn.checkpoint import WEIGHTS
    from s2r_host.learn.export import export_pair
    from s2r_host.learn.pair_network import PairNetwork
    from s2r_host.learn.plot import plot_pair_metrics
    from s2r_host.learn.train_model import ModelSettings, train_model

    settings = ModelSettings(device=_device(device), seed=seed)
    if epochs is not None:
        settings = replace(settings, epochs=_at_least_one(epochs))
    with Progress(console=Console(stderr=True)) as progress:
        state = train_model(data, out, settings, progress)
    plot_pair_metrics(state["metrics"], out / "metrics.png")
    network = PairNetwork()
    network.load_state_dict(load_file(out / WEIGHTS))
    about = {name: value for name, value in state.items() if name != "metrics"}
    last = state["metrics"][-1]
    about |= {name: value for name, value in last.items() if name.startswith("validation_")}
    about["command"] = f"s2r train model --data {data} --out {out} --epochs {settings.epochs} --seed {seed}"
    worst = export_pair(network, out, about)
    axis = last.get("validation_axis_deg", float("nan"))
    click.echo(
        f"{state['epoch']} epochs on {state['pairs']} pairs of {state['objects']} objects; unseen objects: type right"
        f" {100 * last['validation_type_right']:.0f} %, axis {axis:.1f} degrees off (median), part's IoU"
        f" {last['validation_iou']:.2f}; ONNX differs by {worst:.1g}; in {out}"
    )


@train.command()
@_PAIRS
@_OUT
@click.option(
    "--size",
    type=click.Choice(["small", "ditto"]),
    default="small",
    show_default=True,
    help="'ditto': as published, for a GPU; 'small': what a CPU trains.",
)
@click.option("--epochs", type=int, help="Passes over the data [default: 40].")
@_DEVICE
@_SEED
def baseline(data: Path, out: Path, size: str, epochs: int | None, device: str, seed: int) -> None:
    """A network in the manner of Ditto, to be measured beside the others: nothing else uses it."""
    from rich.console import Console
    from rich.progress import Progress

    from s2r_host.learn.plot import plot_pair_metrics
    from s2r_host.learn.train_baseline import BaselineSettings, train_baseline

    settings = BaselineSettings(device=_device(device), seed=seed, size=size)
    if epochs is not None:
        settings = replace(settings, epochs=_at_least_one(epochs))
    with Progress(console=Console(stderr=True)) as progress:
        state = train_baseline(data, out, settings, progress)
    plot_pair_metrics(state["metrics"], out / "metrics.png")
    last = state["metrics"][-1]
    axis = last.get("validation_axis_deg", float("nan"))
    click.echo(
        f"{state['epoch']} epochs on {state['pairs']} pairs of {state['objects']} objects, {state['parameters']}"
        f" parameters; unseen objects: type right {100 * last['validation_type_right']:.0f} %, axis {axis:.1f} degrees"
        f" off (median), part's IoU {last['validation_iou']:.2f}; in {out}"
    )


def _device(name: str) -> str:
    import torch

    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise UsageError("--device cuda: torch sees no CUDA device here; use --device cpu")
    return name


def _at_least_one(epochs: int) -> int:
    if epochs < 1:
        raise UsageError(f"--epochs {epochs} must be 1 or more")
    return epochs
