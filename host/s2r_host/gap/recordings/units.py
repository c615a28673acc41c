"""Declared units to SI, once, at the border."""

from __future__ import annotations

import math

from s2r_host.gap.errors import GapRecordingError

ANGLE = {"rad": 1.0, "deg": math.pi / 180.0, "mrad": 1e-3, "rev": 2.0 * math.pi, "turn": 2.0 * math.pi}
LENGTH = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "in": 0.0254}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
TORQUE = {"Nm": 1.0, "N.m": 1.0, "N*m": 1.0, "N·m": 1.0, "mNm": 1e-3, "Nmm": 1e-3, "Ncm": 1e-2}
FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "lbf": 4.4482216152605, "kip": 4448.2216152605}
EFFORT = TORQUE | FORCE
EFFORT_OF = {"rad": "N·m", "m": "N"}
"""Unit of a joint's effort, by the unit of its position."""
SPEED = {
    **{f"{u}/s": f for u, f in (ANGLE | LENGTH).items()},
    "rpm": 2.0 * math.pi / 60.0,
}
CURRENT = {"A": 1.0, "mA": 1e-3}
TEMPERATURE = {"C": 1.0, "degC": 1.0, "°C": 1.0}
TABLES: dict[str, dict[str, float]] = {
    "t": TIME,
    "q": ANGLE | LENGTH,
    "q_cmd": ANGLE | LENGTH,
    "dq": SPEED,
    "dq_cmd": SPEED,
    "tau": EFFORT,
    "tau_ff": EFFORT,
    "wrench": EFFORT,
    "current": CURRENT,
    "temp": TEMPERATURE,
}


def declared_unit(units: dict[str, str], column: str, called: str = "") -> str | None:
    """The unit that is declared for a column; None when none is.

    Args:
        units: Declared units, keyed by full column name (``q.elbow``) or by its kind (``q``).
        column: Column name of the recording.
        called: The same with the model's name of the joint.
    """
    kind = column.split(".", 1)[0]
    keys = [column, called, kind]
    if kind in ("q_cmd", "dq_cmd", "tau_ff"):
        keys.append(kind.split("_", 1)[0])
    return next((units[key] for key in keys if key in units), None)


def factor(column: str, unit: str | None, file_name: str) -> float:
    """Multiplier that brings ``column`` to SI; 1 when nothing is declared.

    Raises:
        GapRecordingError: The unit is unknown or of the wrong dimension.
    """
    if unit is None:
        return 1.0
    kind = column.split(".", 1)[0]
    if unit not in TABLES[kind]:
        raise GapRecordingError(
            f"{file_name}: column '{column}' declares the unit '{unit}', which is not a unit of "
            f"'{kind}'; known: {', '.join(sorted(TABLES[kind]))}"
        )
    return TABLES[kind][unit]


def moves(unit: str) -> str:
    """What a unit of a position, speed or effort measures: ``rad`` of a hinge, or ``m`` of a slide."""
    return "m" if unit.removesuffix("/s") in LENGTH or unit in FORCE else "rad"
