"""Object files (MJCF) with one thing changed: a face of a geom, the place of the part, the friction of its joint."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from s2r_host.errors import SceneError

THINNEST_M = 0.004


def with_face(source: Path, name: str, axis: np.ndarray, shift_m: float, path: Path, *, inner: bool) -> Path:
    """Write the object with one face of a box shifted along the axis; other shapes shift as a whole.

    Args:
        source: Object file (MJCF).
        name: Of the geom.
        axis: Of the slide, unit vector in the part's frame, (3,).
        shift_m: How far along the axis.
        path: Where the new file goes.
        inner: The face that looks against the axis; else the one that looks along it.

    Raises:
        SceneError: There is no such geom.
    """
    tree = ET.parse(source)
    geom = tree.find(f".//geom[@name='{name}']")
    if geom is None:
        raise SceneError(f"object model {source} has no geom '{name}' to correct")
    move = shift_m * axis
    if geom.get("type") == "box":
        size = _numbers(geom, "size")
        R = Rotation.from_quat(_numbers(geom, "quat"), scalar_first=True).as_matrix()
        along = int(np.argmax(np.abs(R.T @ axis)))
        half = max(size[along] + (-0.5 if inner else 0.5) * shift_m, 0.5 * THINNEST_M)
        move = (half - size[along]) * (-axis if inner else axis)
        size[along] = half
        geom.set("size", _text(size))
    geom.set("pos", _text(_numbers(geom, "pos") + move))
    return _written(tree, path)


def with_part_moved(source: Path, joint: str, X: np.ndarray, path: Path) -> Path:
    """Write the object with every geom of the part that ``joint`` moves placed anew by ``X`` (4, 4) in its frame.

    Raises:
        SceneError: There is no such joint.
    """
    tree = ET.parse(source)
    body = next((b for b in tree.iter("body") if b.find(f"joint[@name='{joint}']") is not None), None)
    if body is None:
        raise SceneError(f"object model {source} has no joint '{joint}' whose part could be corrected")
    for geom in body.iter("geom"):
        R = Rotation.from_matrix(X[:3, :3]) * Rotation.from_quat(_numbers(geom, "quat"), scalar_first=True)
        geom.set("pos", _text(X[:3, :3] @ _numbers(geom, "pos") + X[:3, 3]))
        geom.set("quat", _text(R.as_quat(scalar_first=True)))
    return _written(tree, path)


def with_friction(source: Path, joint: str, friction: float, path: Path) -> Path:
    """Write the object with another dry friction of a joint [N or N·m].

    Raises:
        SceneError: There is no such joint.
    """
    tree = ET.parse(source)
    element = tree.find(f".//joint[@name='{joint}']")
    if element is None:
        raise SceneError(f"object model {source} has no joint '{joint}' whose friction could be set")
    element.set("frictionloss", f"{friction:.7g}")
    return _written(tree, path)


def with_numbers(
    source: Path, joint: str, mass_share: float, friction: float, damping: float, path: Path
) -> Path:
    """Write the object with other friction of a joint and a part of another mass.

    Args:
        source: Object file (MJCF) whose geoms have densities.
        joint: That moves the part.
        mass_share: New mass of the part over its mass in ``source``.
        friction: Dry friction [N or N·m].
        damping: Viscous friction [N·s/m or N·m·s/rad].
        path: Where the new file goes.

    Raises:
        SceneError: There is no such joint.
    """
    tree = ET.parse(with_friction(source, joint, friction, path))
    part = next(b for b in tree.iter("body") if b.find(f"joint[@name='{joint}']") is not None)
    for geom in part.iter("geom"):
        geom.set("density", f"{mass_share * float(geom.get('density', 1000.0)):.7g}")
    for element in part.iter("joint"):
        element.set("damping", f"{damping:.7g}")
    return _written(tree, path)


def with_lean(source: Path, joint: str, lean: float, path: Path) -> Path:
    """Write the object with gravity turned as if a slide rose more where its joint grows.

    Args:
        source: Object file (MJCF).
        joint: A slide; for a hinge gravity stays.
        lean: How much more [rad].
        path: Where the new file goes.
    """
    tree = ET.parse(source)
    model = mujoco.MjModel.from_xml_path(str(source))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    index, gravity = model.joint(joint).id, model.opt.gravity
    across = np.cross(data.xaxis[index], gravity)
    if model.jnt_type[index] == mujoco.mjtJoint.mjJNT_SLIDE and np.linalg.norm(across) > 0.0:
        turn = Rotation.from_rotvec(lean * across / np.linalg.norm(across))
        option = tree.find("option")
        if option is None:
            option = ET.SubElement(tree.getroot(), "option")
        option.set("gravity", _text(turn.apply(gravity)))
    return _written(tree, path)


def _written(tree: ET.ElementTree[ET.Element], path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    tree.write(path, encoding="unicode")
    return path


def _text(values: np.ndarray) -> str:
    return " ".join(f"{value:.7g}" for value in values)


def _numbers(element: ET.Element, key: str) -> np.ndarray:
    default = {"pos": "0 0 0", "quat": "1 0 0 0", "size": "0 0 0"}[key]
    return np.array([float(v) for v in element.get(key, default).split()])
