"""The smallest simple shape around points, as the keys of an ``arm.yaml``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from s2r_protocol.arms.source import SHORTEST_ROD_M


def enclose(points: np.ndarray) -> dict[str, Any]:
    """Of boxes, cylinders and capsules along the axes the smallest one that holds all points (n, 3)."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.maximum(0.5 * (high - low), 0.5 * SHORTEST_ROD_M)
    best, least = box(0.5 * (low + high), half), float(8.0 * half.prod())
    for k in range(3):
        axis, across = np.eye(3)[k], [i for i in range(3) if i != k]
        centre = 0.5 * (low + high)
        away = np.linalg.norm(points[:, across] - centre[across], axis=1)
        radius = max(float(away.max()), 0.5 * SHORTEST_ROD_M)
        volume = float(np.pi * radius**2 * 2.0 * half[k])
        if volume < least:
            best, least = rod("cylinder", centre, axis, float(half[k]), radius), volume
        bulge = np.sqrt(np.maximum(radius**2 - away**2, 0.0))
        ends = (points[:, k] + bulge).min(), (points[:, k] - bulge).max()
        centre[k], length = 0.5 * sum(ends), max(float(ends[1] - ends[0]), 0.0)
        volume = float(np.pi * radius**2 * (length + 4.0 / 3.0 * radius))
        if volume < least:
            best, least = rod("capsule", centre, axis, 0.5 * length, radius), volume
    return best


def volume(shape: dict[str, Any]) -> float:
    """Of a box, cylinder or capsule [m³]."""
    if shape["type"] == "box":
        return 8.0 * math.prod(shape["half"])
    radius, length = shape["radius"], math.dist(shape["a"], shape["b"])
    return math.pi * radius**2 * (length + (4.0 / 3.0 * radius if shape["type"] == "capsule" else 0.0))


def rod(kind: str, centre: np.ndarray, along: np.ndarray, half: float, radius: float) -> dict[str, Any]:
    """A capsule or cylinder about a point (3,), along a unit vector (3,); half its length and its radius [m]."""
    half = max(half, 0.5 * SHORTEST_ROD_M * (1.0 + 1e-6))  # also once its ends are rounded
    a, b = centre - half * along, centre + half * along
    return {"type": kind, "a": a.tolist(), "b": b.tolist(), "radius": radius}


def box(centre: np.ndarray, half: np.ndarray) -> dict[str, Any]:
    """A box along the axes: centre (3,) and half extents (3,) [m]."""
    return {"type": "box", "center": centre.tolist(), "half": half.tolist()}
