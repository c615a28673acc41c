"""Recordings: CSV, Parquet or MCAP plus ``NAME.yaml``, read, converted to SI and checked by name."""

from __future__ import annotations

import difflib
import math
from pathlib import Path

import numpy as np
import yaml

from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.recordings import units as unit_tables
from s2r_host.gap.recordings.recording import Controller, Recording, belongs
from s2r_host.gap.recordings.tables import read_table
from s2r_host.gap.recordings.usable_rows import usable_rows

CONTROLLERS = ("pd", "pid", "position_servo", "none")
CONTROLLER_KEYS = {"type", "kp", "kd", "ki", "rate_hz"}
SIDE_KEYS = {
    "controller",
    "effort",
    "effort_sigma",
    "effort_gain_sigma",
    "position_sigma",
    "input",
    "units",
    "joint_names",
    "session",
    "notes",
}


def read_recording(path: Path, name: str | None = None) -> Recording:
    """Read one recording and its side file.

    Args:
        path: The recording.
        name: What it is called, and its session where the side file names none; None: the file without its suffix.

    Raises:
        GapRecordingError: The file is missing, unreadable, or says something that cannot be used.
    """
    path = Path(path)
    if not path.is_file():
        raise GapRecordingError(f"recording '{path}': no such file")
    table = read_table(path)
    side = _read_side_file(path)
    return _assemble(path, path.stem if name is None else name, table, side)


def _read_side_file(path: Path) -> dict:
    side_path = next((p for p in (path.with_suffix(".yaml"), path.with_suffix(".yml")) if p.is_file()), None)
    if side_path is None:
        return {}
    try:
        side = yaml.safe_load(side_path.read_text(encoding="utf-8")) or {}
    # ValueError: no UTF-8, or a date that there is not.
    except (OSError, ValueError, yaml.YAMLError) as error:
        text = str(error).splitlines()[0]
        raise GapRecordingError(f"{side_path.name}: not readable YAML ({text})") from error
    if not isinstance(side, dict):
        raise GapRecordingError(f"{side_path.name}: expected keys and values, found {type(side).__name__}")
    return side


def _assemble(path: Path, name: str, table: dict[str, np.ndarray], side: dict) -> Recording:
    warnings: list[str] = []
    _refuse_misspelt(side, SIDE_KEYS, f"{path.stem}.yaml")
    unknown = sorted(set(side) - SIDE_KEYS)
    if unknown:
        warnings.append(f"side file: unknown key(s) {', '.join(map(str, unknown))} ignored")
    names = {str(own): str(joint) for own, joint in _mapping(side, "joint_names", path).items()}
    declared = {str(k): str(v) for k, v in _mapping(side, "units", path).items()}
    for key in declared:
        if key.split(".", 1)[0] not in unit_tables.TABLES:
            raise GapRecordingError(
                f"{path.name}: units for '{key}' make no sense; kinds are {', '.join(unit_tables.TABLES)}"
            )
    if "t" not in table:
        raise GapRecordingError(f"{path.name}: no column 't'; columns are {', '.join(list(table)[:12])}")
    t = table["t"] * unit_tables.factor("t", unit_tables.declared_unit(declared, "t"), path.name)
    rows = usable_rows(path, t, table, warnings)
    channels: dict[str, dict[str, np.ndarray]] = {}
    units: dict[str, str] = {}
    empty: list[str] = []
    for column, raw in table.items():
        kind, _, joint = column.partition(".")
        if column == "t":
            continue
        if not belongs(column):
            warnings.append(f"column '{column}' is not part of the contract and is ignored")
            continue
        joint = names.get(joint, joint)
        unit = unit_tables.declared_unit(declared, column, f"{kind}.{joint}")
        values = raw * unit_tables.factor(column, unit, path.name)
        if unit is not None:
            units[f"{kind}.{joint}"] = unit
        values = rows.filled(column, values, warnings)
        if values is None:
            empty.append(column)
        elif joint in channels.setdefault(kind, {}):
            raise GapRecordingError(
                f"{path.name}: 'joint_names' gives joint '{joint}' another '{kind}' column, '{column}'; one is enough"
            )
        else:
            channels[kind][joint] = values
    if not channels.get("q"):
        if positions := [column for column in empty if column.startswith("q.")]:
            raise GapRecordingError(
                f"{path.name}: {', '.join(positions)} without numbers: without positions there is nothing to compare"
            )
        raise GapRecordingError(
            f"{path.name}: no column 'q.<joint>': without positions there is nothing to compare"
        )
    columns = {*table, *(f"{kind}.{joint}" for kind, found in channels.items() for joint in found)}
    if idle := [key for key in declared if "." in key and key not in columns]:
        warnings.append(f"side file: units of {', '.join(idle)} are of no column and convert nothing")
    t = t[rows.kept]
    _check_speed_units(path, t, channels)
    effort = _choice(side, "effort", ("commanded", "measured"), "commanded", path)
    has_command = bool(channels.get("q_cmd"))
    driven_by = _choice(side, "input", ("effort", "q_cmd"), "q_cmd" if has_command else "effort", path)
    if driven_by == "effort" and not channels.get("tau"):
        if not has_command:
            warnings.append("neither effort nor command is recorded: nothing drives a simulation")
        driven_by = "q_cmd"
    return Recording(
        name=name,
        t=t - t[0],
        channels=channels,
        controller=_controller(side, names, path),
        effort=effort,
        driven_by=driven_by,
        session=name if side.get("session") is None else str(side["session"]),
        notes=str(side.get("notes", "")),
        warnings=tuple(warnings),
        start_s=float(t[0]),
        units=units,
        effort_sigma=_positive_numbers(side, "effort_sigma", names, path),
        effort_gain_sigma=_positive_numbers(side, "effort_gain_sigma", names, path),
        position_sigma=_positive_numbers(side, "position_sigma", names, path),
    )


def _mapping(side: dict, key: str, path: Path) -> dict:
    value = side.get(key) or {}
    if not isinstance(value, dict):
        raise GapRecordingError(f"{path.stem}.yaml: '{key}' must be a map, found {type(value).__name__}")
    return value


def _refuse_misspelt(table: dict, known: set[str], where: str) -> None:
    """Refuse a key that is all but one of the known ones: a law that is not read is not missed by anybody."""
    for key in table:
        meant = difflib.get_close_matches(str(key).lower(), known, n=1, cutoff=0.75)
        if key not in known and meant:
            raise GapRecordingError(f"{where}: key '{key}' is not known; is '{meant[0]}' meant?")


def _positive_numbers(side: dict, key: str, names: dict, path: Path) -> dict[str, float]:
    try:
        found = {names.get(str(j), str(j)): float(v) for j, v in _mapping(side, key, path).items()}
    except (TypeError, ValueError) as error:
        raise GapRecordingError(f"{path.stem}.yaml: {key} must map joints to numbers: {error}") from error
    wrong = next((j for j, v in found.items() if not (np.isfinite(v) and v > 0.0)), None)
    if wrong is not None:
        raise GapRecordingError(
            f"{path.stem}.yaml: {key} of '{wrong}' is {found[wrong]:g}; it must be positive"
        )
    return found


def _choice(side: dict, key: str, allowed: tuple[str, ...], default: str, path: Path) -> str:
    value = side.get(key, default)
    if value not in allowed:
        raise GapRecordingError(f"{path.stem}.yaml: {key} = '{value}'; allowed: {', '.join(allowed)}")
    return str(value)


def _check_speed_units(path: Path, t: np.ndarray, channels: dict[str, dict[str, np.ndarray]]) -> None:
    """A velocity that is not the slope of its position was logged in another unit or for another joint."""
    for joint, dq in channels.get("dq", {}).items():
        q = channels["q"].get(joint)
        if q is None or np.std(dq) == 0 or np.std(q) == 0:
            continue
        moved = np.diff(q)
        predicted = 0.5 * (dq[1:] + dq[:-1]) * np.diff(t)
        block = max(1, len(moved) // 200)
        n = len(moved) // block * block
        moved = moved[:n].reshape(-1, block).sum(1)
        predicted = predicted[:n].reshape(-1, block).sum(1)
        scale = float(moved @ predicted / max(predicted @ predicted, 1e-30))
        agreement = float(np.corrcoef(moved, predicted)[0, 1]) if np.std(predicted) > 0 else 0.0
        if agreement > 0.9 and not 0.5 < scale < 2.0:
            raise GapRecordingError(
                f"{path.name}: 'dq.{joint}' times {scale:.3g} is the slope of 'q.{joint}': one of them is in "
                "another unit (degrees? rpm?); declare it under 'units' in the side file"
            )
        if (
            agreement < 0.3
            and len(moved) > 50
            and np.std(moved) > 20 * np.median(np.abs(np.diff(np.unique(q))))
        ):
            raise GapRecordingError(
                f"{path.name}: 'dq.{joint}' is not the slope of 'q.{joint}' (correlation {agreement:.2f}): "
                "the columns belong to different joints or clocks"
            )


def _controller(side: dict, names: dict, path: Path) -> Controller:
    raw = side.get("controller") or {}
    if isinstance(raw, str):
        raw = {"type": raw}
    if not isinstance(raw, dict):
        raise GapRecordingError(f"{path.stem}.yaml: 'controller' must be a map, found {type(raw).__name__}")
    kind = raw.get("type", "none")
    if kind not in CONTROLLERS:
        raise GapRecordingError(
            f"{path.stem}.yaml: controller type '{kind}'; allowed: {', '.join(CONTROLLERS)}"
        )
    _refuse_misspelt(raw, CONTROLLER_KEYS, f"{path.stem}.yaml: controller")
    gains: dict[str, dict[str, float]] = {}
    for key in ("kp", "kd", "ki"):
        table = raw.get(key) or {}
        if not isinstance(table, dict):
            raise GapRecordingError(f"{path.stem}.yaml: controller.{key} must map joints to numbers")
        try:
            gains[key] = {names.get(str(j), str(j)): float(v) for j, v in table.items()}
        except (TypeError, ValueError) as error:
            raise GapRecordingError(f"{path.stem}.yaml: controller.{key}: {error}") from error
        for joint, value in gains[key].items():
            if not 0.0 <= value < math.inf:
                raise GapRecordingError(
                    f"{path.stem}.yaml: controller.{key} of '{joint}' is {value:g}; a gain is a finite number of 0 or "
                    "more, as in kp (q_cmd - q)"
                )
    return Controller(kind=str(kind), rate_hz=_rate(raw.get("rate_hz"), path), **gains)


def _rate(raw: object, path: Path) -> float | None:
    """Rate of the law; nothing and 0 are none."""
    try:
        rate = float(str(raw or 0))
    except ValueError:
        rate = math.nan
    if not 0.0 <= rate < math.inf:
        raise GapRecordingError(
            f"{path.stem}.yaml: controller.rate_hz is {raw!r}; it is how often the law runs in a second, a number"
        )
    return rate or None
