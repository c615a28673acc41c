"""How much of a hidden effect there is in what the arm felt: what it never crossed, no tool can name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gap_objects.hidden import draw
from s2r_host.object_names import JOINT
from s2r_sim.paper.trials import Trial

FELT = 0.5  # of the accuracy of the effort: less of an effect cannot be expected to get a name
AT_STOP = 0.02  # of the joint's range


def strength(effect: str, index: int, seed: int, folder: Path) -> float:
    """Effort of the hidden effect that friction, damping and mass cannot take on, root mean square over its accuracy.

    Args:
        effect, index, seed: Of the object.
        folder: With its recordings; 0 without any.
    """
    return _left(draw(effect, index, seed), _rows(folder))


def at_stop(effect: str, index: int, seed: int, folder: Path) -> bool:
    """Whether the part was pushed against the end of its way: a stop that the belief does not know is there, then."""
    rows, spec = _rows(folder), _spec(draw(effect, index, seed))
    most = spec.range_m if spec.kind == "drawer" else spec.q_max
    q = [spec.q_start + s for part in rows for s in part[1]]
    return bool(q) and (min(q) < AT_STOP * most or max(q) > (1.0 - AT_STOP) * most)


def _spec(trial: Trial) -> Any:
    return trial.world.object


def _rows(folder: Path) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, float]]:
    """Time, joint value from as found, speed and accuracy of every recording."""
    found = []
    for path in sorted((folder / "object-log").glob("*.csv")):
        t, s, ds, _ = np.loadtxt(path, delimiter=",", skiprows=1).T
        side = yaml.safe_load(path.with_suffix(".yaml").read_text(encoding="utf-8"))
        found.append((t, s, ds, float(side["effort_sigma"][JOINT])))
    return found


def _left(trial: Trial, rows: list[tuple[np.ndarray, np.ndarray, np.ndarray, float]]) -> float:
    """Of the effects' effort what the numbers of the joint leave over, in units of its accuracy."""
    if not rows:
        return 0.0
    spec, effects = _spec(trial), trial.world.effects
    dry = float(spec.coulomb_N if spec.kind == "drawer" else spec.coulomb)
    columns, effort = [], []
    for t, s, ds, sigma in rows:
        more = [effects.friction(dry, spec.q_start + a, b) - dry for a, b in zip(s, ds, strict=True)]
        force = np.array([effects.force(spec.q_start + a) for a in s])
        effort.append((np.sign(ds) * np.array(more) - force) / sigma)
        columns.append(np.column_stack([np.sign(ds), ds, np.gradient(ds, t)]) / sigma)
    A, b = np.vstack(columns), np.concatenate(effort)
    return float(np.sqrt(np.mean((b - A @ np.linalg.lstsq(A, b, rcond=None)[0]) ** 2)))
