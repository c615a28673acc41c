"""One moving part of a PartNet-Mobility, Shape2Motion or own object, in real size on the stand-in's table.

The chosen joint moves, all others stay at 0. Rays see the meshes as they are; contacts use the convex hull of
every mesh file, as MuJoCo does. A mesh that is flat becomes a thin solid. What moves weighs what the solids within its
meshes weigh; a mesh that bounds none weighs as its convex hull.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from s2r_sim.errors import ShapelessError, WorldFileError
from s2r_sim.objects.holding import holding_friction
from s2r_sim.objects.mobility import MobileLink, read_mobility, urdf_of
from s2r_sim.objects.mobility_shapes import SOLIDS, MeshPlace, Shape, SolidPlace
from s2r_sim.objects.naming import BASE_BODY, JOINT, PART_BODY
from s2r_sim.objects.scene import JointTruth, add_table
from s2r_sim.objects.sheets import is_flat, thickened
from s2r_sim.objects.solids import HARD, STIFF
from s2r_sim.objects.wavefront import triangles_of, vertices_of
from s2r_sim.objects.weight import weigh

GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}
FOUND = "as_found"  # the scene's key with the joint as found
GREY = (0.62, 0.6, 0.58, 1.0)
# Shape2Motion: y up, front z  ->  z up, front -x (towards the arm), as PartNet-Mobility's first joint does it.
Y_UP = np.array([[0.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class MobilityPlace:
    """How a folder's object becomes a real one.

    Attributes:
        height_m: Its height on the table; the data sets have no unit of length.
        x_m, y_m, yaw_rad: Place of its middle, and turn.
        damping, coulomb: Of the moving joint [N·m·s/rad, N·m or N·s/m, N]; None: so much that the part stays where it
            is put.
        share: Joint value as found, as a share of its range.
    """

    height_m: float = 0.3
    x_m: float = 0.65
    y_m: float = 0.0
    yaw_rad: float = 0.0
    damping: float = 0.2
    coulomb: float | None = None
    share: float = 0.3


@dataclass(frozen=True)
class Imported:
    """What was written.

    Attributes:
        joint: The true joint.
        thickened: Shapes that were flat and are thin solids now, by link and number.
        hulled: Shapes of the moving part that bound no solid and weigh as their convex hull, by link and number.
    """

    joint: JointTruth
    thickened: tuple[str, ...]
    hulled: tuple[str, ...]


def movable(links: tuple[MobileLink, ...]) -> list[MobileLink]:
    """The links with a joint that moves."""
    return [link for link in links if link.joint != "fixed" and link.limits[1] > link.limits[0]]


def mobility_scene(
    folder: Path, part: str | None = None, place: MobilityPlace | None = None
) -> mujoco.MjSpec:
    """A table with the object, see :func:`weighed_scene`."""
    return weighed_scene(folder, part, place)[0]


def weighed_scene(
    folder: Path, part: str | None = None, place: MobilityPlace | None = None
) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """A table with the object; bodies and joint carry the names all objects of the stand-in have.

    Its one key has the joint as found.

    Args:
        folder: Of one object.
        part: Name or meaning of the link that moves; may be left out if there is one only.
        place: Size, place and physics.

    Returns:
        The scene, and the shapes of the moving part that weigh as their convex hull.

    Raises:
        WorldFileError: No such part, several of them, or a folder that cannot be used.
        ShapelessError: What moves has no shape.
    """
    place = place or MobilityPlace()
    links = read_mobility(folder)
    chosen = _choose(links, part, folder)
    X = _world_poses(links)
    with_part = {chosen.name}
    for link in links:
        if link.parent in with_part:
            with_part.add(link.name)
    _check_shape(links, with_part, folder)
    scene = mujoco.MjSpec()
    scene.modelname = folder.name
    scene.compiler.degree = False
    scene.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    add_table(scene)
    scale, X_W = _standing(links, X, place, np.eye(4) if urdf_of(folder) else Y_UP, folder)
    base = scene.worldbody.add_body(name=BASE_BODY)
    body = base.add_body(name=PART_BODY)
    for link in links:
        _add_shapes(
            scene, body if link.name in with_part else base, link, X_W @ _scaled(X[link.name], scale), scale
        )
    X_joint = X_W @ _scaled(X[chosen.name], scale)
    slides = chosen.joint == "prismatic"
    anchor, axis = X_joint[:3, 3], X_joint[:3, :3] @ chosen.axis
    low, high = (np.array(chosen.limits) * (scale if slides else 1.0)).tolist()
    hulled = weigh(scene, body)
    coulomb = holding_friction(body, anchor, axis, slides) if place.coulomb is None else place.coulomb
    body.add_joint(
        name=JOINT,
        type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
        pos=anchor,
        axis=axis,
        range=[low, high],
        limited=True,
        damping=[place.damping, 0, 0],
        frictionloss=coulomb,
        armature=0.001,
        solref_friction=STIFF,
        solimp_friction=HARD,
    )
    scene.add_exclude(bodyname1=BASE_BODY, bodyname2=PART_BODY)
    scene.add_key(name=FOUND, qpos=[low + place.share * (high - low)])
    return scene, hulled


def mobility_truth(model: mujoco.MjModel) -> JointTruth:
    """The joint of a compiled `mobility_scene`, as found."""
    data = mujoco.MjData(model)
    joint = model.joint(JOINT).id
    low, high = model.jnt_range[joint].tolist()
    data.qpos[:] = model.key(FOUND).qpos
    q = float(data.qpos[model.jnt_qposadr[joint]])
    mujoco.mj_kinematics(model, data)
    x, y, z = data.xanchor[joint].tolist()
    a, b, c = data.xaxis[joint].tolist()
    slides = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    return JointTruth("prismatic" if slides else "revolute", (x, y, z), (a, b, c), q, high, low)


def write_mobility(folder: Path, out: Path, part: str | None, place: MobilityPlace) -> Imported:
    """Write ``scene.xml`` (MJCF, meshes by absolute path) and ``object.json`` (true joint), as for drawn objects.

    Raises:
        WorldFileError: A folder, or a shape of it, that cannot be used.
        ShapelessError: What moves has no shape.
    """
    scene, hulled = weighed_scene(folder, part, place)
    scene.worldbody.add_site(name="arm_base")  # so that `s2r plan` knows where the arm stands
    try:
        model = scene.compile()
    except ValueError as error:  # names a shape by its link and number: a face without corners
        reason = "; ".join(str(error).splitlines()).removeprefix("Error: ")
        raise WorldFileError(
            f"{folder}: MuJoCo takes no such object: {reason}; mend it, or leave that shape out"
        ) from error
    truth = mobility_truth(model)
    place = replace(place, coulomb=float(model.joint(JOINT).frictionloss[0]))
    flat = [mesh.name for mesh in scene.meshes if not mesh.file]
    out.mkdir(parents=True, exist_ok=True)
    (out / "scene.xml").write_text(scene.to_xml())
    content = {
        "source": str(folder), "place": asdict(place), "joint": asdict(truth), "thickened": flat, "hulled": hulled
    }  # fmt: skip
    (out / "object.json").write_text(json.dumps(content, indent=1, sort_keys=True) + "\n")
    return Imported(truth, tuple(flat), hulled)


def _choose(links: tuple[MobileLink, ...], part: str | None, folder: Path) -> MobileLink:
    able = movable(links)
    named = [link for link in able if part is None or part in (link.name, link.meaning)]
    if len(named) == 1:
        return named[0]
    names = (
        ", ".join(f"{link.name} ({link.meaning or 'no meaning'}, {link.joint})" for link in able) or "none"
    )
    wanted = "one moving part" if part is None else f"one moving part {part!r}"
    raise WorldFileError(f"{folder}: {wanted} is needed, there are {len(named)}; parts that move: {names}")


def _check_shape(links: tuple[MobileLink, ...], moving: set[str], folder: Path) -> None:
    """Refuse a part that can be neither seen nor touched."""
    if any(link.shapes for link in links if link.name in moving):
        return
    raise ShapelessError(
        f"{folder}: {', '.join(sorted(moving))} would move and {'has' if len(moving) == 1 else 'have'} no shape; give "
        f"it a <visual> with a mesh or a {', '.join(SOLIDS)}"
    )


def _world_poses(links: tuple[MobileLink, ...]) -> dict[str, np.ndarray]:
    """Pose of every link at joint values 0 in the folder's root frame."""
    X: dict[str, np.ndarray] = {}
    for link in links:
        X[link.name] = (X[link.parent] if link.parent is not None else np.eye(4)) @ link.X_parent_link
    return X


def _scaled(X: np.ndarray, scale: float) -> np.ndarray:
    result = X.copy()
    result[:3, 3] *= scale
    return result


def _standing(
    links: tuple[MobileLink, ...],
    X: dict[str, np.ndarray],
    place: MobilityPlace,
    upright: np.ndarray,
    folder: Path,
) -> tuple[float, np.ndarray]:
    """Scale, and the pose (4, 4) that puts the scaled object upright on the table.

    A URDF has z up (PartNet-Mobility's turns its meshes by its first fixed joint); Shape2Motion's files stay y up.
    """
    corners = [_corners(shape, upright @ X[link.name]) for link in links for shape in link.shapes]
    cloud = np.concatenate(corners)
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    if high[2] - low[2] < 1e-9:
        raise WorldFileError(
            f"{folder}: the object has no height that could be scaled to {place.height_m:g} m; it is flat as a whole"
        )
    scale = place.height_m / float(high[2] - low[2])
    c, s = np.cos(place.yaw_rad), np.sin(place.yaw_rad)
    turn = np.eye(4)
    turn[:2, :2] = [[c, -s], [s, c]]
    centre = scale * np.append((low[:2] + high[:2]) / 2, low[2])
    lift = np.eye(4)
    lift[:3, 3] = -centre
    X_W = turn @ lift @ upright
    X_W[:3, 3] += [place.x_m, place.y_m, 0.0]
    return scale, X_W


def _corners(shape: Shape, X_link: np.ndarray) -> np.ndarray:
    """The two corners of the box along the axes around a shape of a link that is at ``X_link``, shape (2, 3)."""
    if isinstance(shape, SolidPlace):
        T = X_link @ shape.X_link_solid
        reach = shape.reach(T[:3, :3])
        return np.stack([T[:3, 3] - reach, T[:3, 3] + reach])
    T = X_link @ shape.X_link_mesh
    points = (vertices_of(shape.file) * shape.scale) @ T[:3, :3].T + T[:3, 3]
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _add_shapes(
    scene: mujoco.MjSpec, body: mujoco.MjsBody, link: MobileLink, X_W_link: np.ndarray, scale: float
) -> None:
    for k, shape in enumerate(link.shapes):
        name, quat = f"{link.name}_{k}", np.empty(4)
        X_link_shape = shape.X_link_mesh if isinstance(shape, MeshPlace) else shape.X_link_solid
        T = X_W_link @ _scaled(X_link_shape, scale)
        mujoco.mju_mat2Quat(quat, T[:3, :3].ravel())
        if isinstance(shape, SolidPlace):
            size = [*(scale * np.array(shape.size)), 0.0, 0.0][:3]
            body.add_geom(name=name, type=GEOMS[shape.kind], size=size, pos=T[:3, 3], quat=quat, rgba=GREY)
            continue
        _add_mesh(scene, name, shape, scale)
        body.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, pos=T[:3, 3], quat=quat, rgba=GREY
        )


def _add_mesh(scene: mujoco.MjSpec, name: str, shape: MeshPlace, scale: float) -> None:
    """By its file, or, where it is flat, as the thin solid that is made of it."""
    mesh = scene.add_mesh(
        name=name,
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,  # not closed; what moves is weighed apart
    )
    points = vertices_of(shape.file) * scale * shape.scale
    if not is_flat(points):
        mesh.file, mesh.scale = str(shape.file.resolve()), scale * shape.scale
        return
    triangles = triangles_of(shape.file, len(points))
    points, triangles = thickened(points, triangles, f"{shape.file}: shape {name!r}")
    mesh.uservert, mesh.userface = points.ravel(), triangles.ravel()
