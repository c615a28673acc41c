"""Write an object model as MJCF and URDF.

Both describe the world frame of the views with the part in the pose of the first view at joint value 0. The MJCF
needs no other file (hull corners are inline); the URDF refers to OBJ files beside it. Masses of the URDF are those
MuJoCo computes, so the two agree.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from s2r_host.model.belief import Physics
from s2r_host.model.pieces import Piece
from s2r_host.object_names import BASE_BODY, JOINT, PART_BODY, RIM_PREFIX
from s2r_host.perception.motion import JointMotion

Array = NDArray[np.floating]

COLOUR = {"base": "0.55 0.57 0.60 1", "part": "0.85 0.55 0.25 1"}
RIM_COLOUR = "0.85 0.55 0.25 0.2"
GRAVITY_M_S2 = 9.81


def _text(values: Array | list[float] | tuple[float, ...]) -> str:
    return " ".join(f"{float(v):.7g}" for v in np.ravel(values))


def write_mjcf(
    path: Path,
    pieces: list[Piece],
    motion: JointMotion,
    joint_range: tuple[float, float],
    physics: Physics,
    rims: Sequence[Piece] = (),
    up: Array | None = None,
) -> None:
    """Write the MJCF file.

    Args:
        path: Of the file.
        pieces: Of base and part.
        motion: Type, origin and direction of the joint (its delta is not used).
        joint_range: Lowest and highest joint value [m or rad].
        physics: Numbers of the joint and of all surfaces.
        rims: Of the part, pieces that nothing touches and that weigh nothing: as far as it may reach.
        up: Against gravity, (3,); None: along z, as MuJoCo has it.
    """
    root = ET.Element("mujoco", model="object")
    ET.SubElement(root, "compiler", angle="radian")
    if up is not None:
        ET.SubElement(root, "option", gravity=_text(-GRAVITY_M_S2 * up))
    asset = ET.SubElement(root, "asset")
    for name, piece in [*((_geom(piece), piece) for piece in pieces), *((_rim(rim), rim) for rim in rims)]:
        if piece.half_size is None:
            ET.SubElement(asset, "mesh", name=name, vertex=_text(piece.vertices), inertia="convex")
    world = ET.SubElement(root, "worldbody")
    base = ET.SubElement(world, "body", name=BASE_BODY)
    part = ET.SubElement(base, "body", name=PART_BODY)
    ET.SubElement(
        part,
        "joint",
        name=JOINT,
        type="slide" if motion.joint_type == "prismatic" else "hinge",
        pos=_text(motion.origin),
        axis=_text(motion.direction),
        range=_text(joint_range),
        limited="true",
        damping=_text([physics.damping.value]),
        frictionloss=_text([physics.frictionloss.value]),
        armature=_text([physics.armature]),
    )
    for piece in pieces:
        _add_geom(base if piece.body == "base" else part, piece, physics)
    for rim in rims:
        _add_rim(part, rim)
    if not any(piece.body == "base" for piece in pieces):
        ET.SubElement(base, "inertial", pos="0 0 0", mass="1", diaginertia="0.01 0.01 0.01")
    contact = ET.SubElement(root, "contact")
    ET.SubElement(contact, "exclude", body1=BASE_BODY, body2=PART_BODY)
    ET.indent(root)
    path.write_text(ET.tostring(root, encoding="unicode") + "\n")


def _geom(piece: Piece) -> str:
    return f"{piece.body}_{piece.name}"


def _rim(piece: Piece) -> str:
    return f"{RIM_PREFIX}{piece.name}"


def _add_geom(body: ET.Element, piece: Piece, physics: Physics) -> None:
    attributes = {
        "rgba": COLOUR[piece.body],
        "density": _text([physics.density_kg_m3.value]),
        "friction": _text([physics.surface_friction.value, 0.005, 0.0001]),
    }
    ET.SubElement(body, "geom", {"name": _geom(piece)} | attributes | _shape(piece, _geom(piece)))


def _add_rim(body: ET.Element, piece: Piece) -> None:
    attributes = {"rgba": RIM_COLOUR, "density": "0", "contype": "0", "conaffinity": "0", "group": "4"}
    ET.SubElement(body, "geom", {"name": _rim(piece)} | attributes | _shape(piece, _rim(piece)))


def _shape(piece: Piece, mesh: str) -> dict[str, str]:
    quat = Rotation.from_matrix(piece.X_base_piece[:3, :3]).as_quat(scalar_first=True)
    place = {"pos": _text(piece.X_base_piece[:3, 3]), "quat": _text(quat)}
    if piece.half_size is not None:
        return {"type": "box", "size": _text(piece.half_size)} | place
    return {"type": "mesh", "mesh": mesh} | place


def write_urdf(
    path: Path, pieces: list[Piece], motion: JointMotion, joint_range: tuple[float, float], physics: Physics,
    mjcf_path: Path,
) -> None:  # fmt: skip
    """Write the URDF and its OBJ files; inertia is read from the compiled MJCF."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(mjcf_path))
    robot = ET.Element("robot", name="object")
    p_joint = motion.origin if motion.joint_type == "revolute" else np.zeros(3)
    for body, offset in (("base", np.zeros(3)), ("part", p_joint)):
        link = ET.SubElement(robot, "link", name=f"object_{body}")
        _add_inertial(link, model, model.body(f"object_{body}").id, offset)
        for piece in pieces:
            if piece.body == body:
                _add_shapes(link, piece, offset, path.parent)
    joint = ET.SubElement(
        robot,
        "joint",
        name=JOINT,
        type="prismatic" if motion.joint_type == "prismatic" else "revolute",
    )
    ET.SubElement(joint, "parent", link=BASE_BODY)
    ET.SubElement(joint, "child", link=PART_BODY)
    ET.SubElement(joint, "origin", xyz=_text(p_joint), rpy="0 0 0")
    ET.SubElement(joint, "axis", xyz=_text(motion.direction))
    ET.SubElement(
        joint,
        "limit",
        lower=f"{joint_range[0]:.6g}",
        upper=f"{joint_range[1]:.6g}",
        effort="1000",
        velocity="10",
    )
    ET.SubElement(
        joint,
        "dynamics",
        damping=_text([physics.damping.value]),
        friction=_text([physics.frictionloss.value]),
    )
    ET.indent(robot)
    path.write_text('<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n")


def _add_inertial(link: ET.Element, model: object, body: int, offset: Array) -> None:
    mass = float(model.body_mass[body])  # type: ignore[attr-defined]
    p = np.array(model.body_ipos[body]) - offset  # type: ignore[attr-defined]
    R = Rotation.from_quat(model.body_iquat[body], scalar_first=True)  # type: ignore[attr-defined]
    Ixx, Iyy, Izz = (float(v) for v in model.body_inertia[body])  # type: ignore[attr-defined]
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_text(p), rpy=_text(R.as_euler("xyz")))
    ET.SubElement(inertial, "mass", value=f"{mass:.7g}")
    ET.SubElement(
        inertial, "inertia", ixx=f"{Ixx:.7g}", iyy=f"{Iyy:.7g}", izz=f"{Izz:.7g}", ixy="0", ixz="0", iyz="0"
    )


def _add_shapes(link: ET.Element, piece: Piece, offset: Array, folder: Path) -> None:
    rpy = Rotation.from_matrix(piece.X_base_piece[:3, :3]).as_euler("xyz")
    for kind in ("visual", "collision"):
        element = ET.SubElement(link, kind, name=_geom(piece))
        ET.SubElement(element, "origin", xyz=_text(piece.X_base_piece[:3, 3] - offset), rpy=_text(rpy))
        geometry = ET.SubElement(element, "geometry")
        if piece.half_size is not None:
            ET.SubElement(geometry, "box", size=_text(2 * piece.half_size))
        else:
            name = f"meshes/{_geom(piece)}.obj"
            ET.SubElement(geometry, "mesh", filename=name)
            _write_obj(folder / name, piece)


def _write_obj(path: Path, piece: Piece) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [f"v {_text(v)}" for v in piece.vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in piece.faces()]
    path.write_text("\n".join(lines) + "\n")
