"""Numbers and poses in the tags of a URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np


def triple(
    tag: ET.Element | None, attribute: str, fallback: str, who: str, error: type[Exception]
) -> np.ndarray:
    """Three numbers of an attribute, separated by blanks, shape (3,); ``fallback`` where there is none.

    Raises:
        error: They are not three finite numbers; the text begins with ``who``.
    """
    text = fallback if tag is None else tag.get(attribute, fallback)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise error(f"{who}: {attribute} {text!r} must be three finite numbers, separated by blanks")
    return values


def origin(element: ET.Element, who: str, error: type[Exception]) -> np.ndarray:
    """Pose (4, 4) of an ``<origin>``; roll, pitch, yaw [rad] about fixed axes.

    Raises:
        error: It cannot be read; the text begins with ``who``.
    """
    X = np.eye(4)
    tag = element.find("origin")
    if tag is None:
        return X
    (r, p, y) = triple(tag, "rpy", "0 0 0", who, error)
    Rx = np.array([[1, 0, 0], [0, np.cos(r), -np.sin(r)], [0, np.sin(r), np.cos(r)]])
    Ry = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    Rz = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
    X[:3, :3], X[:3, 3] = Rz @ Ry @ Rx, triple(tag, "xyz", "0 0 0", who, error)
    return X
