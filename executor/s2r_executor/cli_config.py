"""``s2r config``: what the executor would run with, where each value comes from, and the schema of the file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import yaml

from s2r_executor.config import ExecutorConfig, load_config, parse_override

_OPTIONS = (
    click.option(
        "--config",
        "config_path",
        type=click.Path(exists=True, dir_okay=False, path_type=Path),
        help="YAML file of the executor.",
    ),
    click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="As for 's2r executor'."),
)


@click.group()
def config() -> None:
    """Look at the executor's configuration without starting it."""


@config.command()
@_OPTIONS[0]
@_OPTIONS[1]
@click.option("--origin", is_flag=True, help="Say where each value comes from: default, file or --set.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def show(config_path: Path | None, overrides: tuple[str, ...], origin: bool, as_json: bool) -> None:
    """Print every key with the value that holds."""
    chosen = dict(parse_override(text) for text in overrides)
    values = flat(load_config(config_path, chosen).model_dump(mode="json"))
    origins = {key: origin_of(key, config_path, chosen) for key in values}
    if as_json:
        body = {k: {"value": v, "origin": origins[k]} for k, v in values.items()} if origin else values
        click.echo(json.dumps(body, indent=1))
        return
    width = max(len(key) for key in values)
    for key, value in values.items():
        line = f"{key:{width}s}  {json.dumps(value)}"
        click.echo(f"{line:{width + 34}s}  # {origins[key]}" if origin else line)


@config.command()
@click.option(
    "--out", type=click.Path(dir_okay=False, path_type=Path), help="File [default: standard output]."
)
def schema(out: Path | None) -> None:
    """Print the JSON Schema of the executor's configuration file, for editors and checkers."""
    body = {"$schema": "https://json-schema.org/draft/2020-12/schema", **ExecutorConfig.model_json_schema()}
    text = json.dumps(body, indent=1) + "\n"
    if out is None:
        click.echo(text, nl=False)
    else:
        out.write_text(text, encoding="utf-8")


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested values as dotted keys, as ``--set`` wants them."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            found.update(flat(value, f"{prefix}{key}."))
        else:
            found[f"{prefix}{key}"] = value
    return found


def origin_of(key: str, path: Path | None, overrides: Mapping[str, Any]) -> str:
    """Where a dotted key's value comes from."""
    if any(key == name or key.startswith(f"{name}.") for name in overrides):
        return "--set"
    if path is not None and key in flat(yaml.safe_load(path.read_text(encoding="utf-8")) or {}):
        return str(path)
    return "default"
