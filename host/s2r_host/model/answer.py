"""The JSON answer of ``s2r build-model``."""

from __future__ import annotations

from typing import Any

import numpy as np

from s2r_host.model.build import ObjectModel
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.view import DepthView


def answer(
    estimate: JointEstimate, model: ObjectModel, frame: str
) -> dict[str, Any]:  # values are plain JSON
    """What was found, as plain JSON values.

    Angles in rad, lengths in m. ``axis_direction`` carries the sense of the motion seen, so ``delta`` is positive.
    """
    iv = estimate.intervals90
    return {
        "joint_type": estimate.joint_type,
        "axis_origin_m": _list(estimate.axis_origin_m),
        "axis_direction": _list(estimate.axis_direction),
        "frame": frame,
        "delta": round(float(estimate.delta), 6),
        "unit": estimate.unit,
        "intervals90": {
            "axis_angle_rad": round(iv.axis_angle_rad, 5),
            "axis_offset_m": round(iv.axis_offset_m, 5),
            "delta": [round(float(v), 6) for v in iv.delta],
        },
        "residual_m": round(float(estimate.residual_m), 6),
        "explained": round(estimate.explained, 4),
        "parts": [_part(estimate, model, body) for body in ("part", "base")],
        "model_urdf": str(model.urdf_path),
        "model_mjcf": str(model.mjcf_path),
        "warnings": [*estimate.warnings, *model.warnings],
    }


def _part(estimate: JointEstimate, model: ObjectModel, body: str) -> dict[str, Any]:
    pieces = [p for p in model.pieces if p.body == body]
    corners = [p.vertices @ p.X_base_piece[:3, :3].T + p.X_base_piece[:3, 3] for p in pieces]
    entry: dict[str, Any] = {
        "name": f"object_{body}",
        "moves": body == "part",
        "pieces": [p.name for p in pieces],
        "guessed_pieces": [p.name for p in pieces if not p.seen],
        "volume_m3": round(sum(p.volume_m3 for p in pieces), 6),
    }
    if corners:
        everything = np.concatenate(corners)
        entry["box_m"] = [_list(everything.min(axis=0)), _list(everything.max(axis=0))]
    if body == "part":
        kind = "pixels" if isinstance(estimate.view_before, DepthView) else "points"
        entry[f"{kind}_before"] = int(estimate.parts.before.sum())
        entry[f"{kind}_after"] = int(estimate.parts.after.sum())
    return entry


def _list(values: np.ndarray) -> list[float]:
    return [round(float(v), 6) for v in values]
