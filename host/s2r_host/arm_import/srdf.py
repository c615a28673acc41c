"""Named poses of the SRDF that lies beside a URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from s2r_protocol.arms.source import ArmSource

_NAMES = ("ready", "home")
_FOLDERS = (".", "srdf", "config", "../srdf", "../config")


def named_poses(urdf: Path, arm: ArmSource) -> Iterator[tuple[str, Path, np.ndarray]]:
    """Poses called 'ready', then 'home', that place every joint of the arm within its limits: name, file, (dof,) [rad].

    A file that cannot be read, or a value that is no number, is passed over: no SRDF has to be there.
    """
    files = [file for folder in _FOLDERS for file in sorted((urdf.parent / folder).glob("*.srdf"))]
    states = [(file, state) for file in files for state in _states(file)]
    for name in _NAMES:
        for file, state in states:
            q = _pose(state, arm) if state.get("name", "").lower() == name else None
            if q is not None:
                yield state.get("name", ""), file, q


def _states(file: Path) -> list[ET.Element]:
    try:
        return list(ET.fromstring(file.read_bytes()).iter("group_state"))
    except (OSError, ET.ParseError):
        return []


def _pose(state: ET.Element, arm: ArmSource) -> np.ndarray | None:
    values = {joint.get("name"): joint.get("value", "") for joint in state.iter("joint")}
    try:
        q = np.array([float(values[joint.name]) for joint in arm.joints])
    except (KeyError, ValueError):
        return None
    within = all(joint.q[0] <= value <= joint.q[1] for joint, value in zip(arm.joints, q, strict=True))
    return q if within else None
