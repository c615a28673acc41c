"""What a real case is: the files given to the tool, and what is known about the machine to judge the answer by."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml


@dataclass(frozen=True)
class Check:
    """One line of the verdict: what is known, what the tool said, whether they agree."""

    known: str
    found: str
    ok: bool


@dataclass(frozen=True)
class Case:
    """One run of the tool.

    Attributes:
        name: Folder of the answer.
        model: MJCF or URDF; ``fit``, ``holdout``, ``repeat``: recordings; ``config``: content of GAP.yaml.
        judge: Reads ``gap.json`` and compares it with what is known.
        after: Name of the case whose ``model_patched.xml`` is this one's model.
    """

    name: str
    model: Path
    fit: list[Path]
    judge: Callable[[dict], list[Check]]
    holdout: list[Path] = field(default_factory=list)
    repeat: list[Path] = field(default_factory=list)
    config: dict = field(default_factory=dict)
    after: str | None = None


def shared_data() -> Path:
    """Folder of the public recordings; each with a PROVENANCE.md."""
    return Path(os.environ.get("S2R_SHARED_DATA", Path(__file__).resolve().parents[4] / "shared" / "data"))


def write_recording(path: Path, columns: Mapping[str, np.ndarray], side: dict) -> Path:
    """CSV and side file."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(
            zip(*[[f"{x:.9g}" for x in np.asarray(c, dtype=float)] for c in columns.values()], strict=True)
        )
    path.with_suffix(".yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
    return path


def effect(answer: dict, *names: str, joint: str | None = None) -> dict | None:
    """The most probable of the named effects, or None."""
    for e in answer["effects"]:
        if e["name"] in names and joint in (None, e["joint"]):
            return e
    return None


def named(answer: dict, known: str, *names: str, joint: str | None = None) -> Check:
    """Is one of these effects in the answer?"""
    e = effect(answer, *names, joint=joint)
    return Check(known, describe(e) if e else f"not among {effects_text(answer)}", e is not None)


def effects_text(answer: dict) -> str:
    """The answer's names in one line."""
    found = [f"{e['name']}@{e['joint']}" for e in answer["effects"]]
    found += [f"{p['name']}@{p.get('body', p.get('joint'))}" for p in answer["parameters_off"]]
    return f"{answer['verdict']}: {', '.join(found) or '-'}"


def describe(e: dict) -> str:
    """One effect with its numbers."""
    values = ", ".join(
        f"{k} {v['value']:.4g} {v['unit']}".removesuffix(" 1") for k, v in e["parameters"].items()
    )
    also = f" (or {', '.join(e['could_also_be'])})" if e["could_also_be"] else ""
    return f"{e['name']}{also} p {e['probability']:.2f}: {values}"


def within(known: str, value: float | None, low: float, high: float, unit: str) -> Check:
    """Is a number inside its goal?"""
    ok = value is not None and low <= value <= high
    return Check(known, "absent" if value is None else f"{value:.4g} {unit}", ok)
