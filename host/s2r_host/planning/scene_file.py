"""Reading an MJCF file somebody else wrote: a scene with an articulated object, with or without the arm in it.

The rest of the planner lives in the arm's base frame. So the scene is read, an arm that is in it is taken out (the
described one takes its place), and the pose of the arm's base in the scene is found: from the arm that was in it, or
from a body or site called ``arm_base``.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import mujoco
import numpy as np

from s2r_host.errors import HostError
from s2r_protocol.arms import ArmDescription
from s2r_protocol.exits import UsageError

logger = logging.getLogger(__name__)

BASE_NAME = "arm_base"
DESCRIPTIONS = (".xml", ".urdf")  # MuJoCo goes by the name, not by the content
_FIELDS = (
    "qpos0", "body_pos", "body_quat", "body_mass", "body_inertia", "body_ipos", "jnt_range", "jnt_stiffness",
    "dof_damping", "dof_frictionloss", "dof_armature", "geom_pos", "geom_quat", "geom_size", "geom_friction",
    "site_pos",
)  # fmt: skip


class SceneFileError(HostError, UsageError):
    """The object file cannot be read, or lacks the joint or the tool that the task names."""


@dataclass(frozen=True, eq=False)
class SceneFile:
    """A scene without an arm, ready to be put together with one.

    Attributes:
        spec: The scene; looks, keyframes and an arm that was in it are gone.
        X_scene_base: Pose of the arm's base in the scene, (4, 4).
        gravity: In the scene's frame [m/s²], (3,).
    """

    spec: mujoco.MjSpec
    X_scene_base: np.ndarray
    gravity: np.ndarray

    @property
    def X_base_scene(self) -> np.ndarray:
        """Pose of the scene in the arm's base frame, (4, 4)."""
        R, p = self.X_scene_base[:3, :3], self.X_scene_base[:3, 3]
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = R.T, -R.T @ p
        return X


def read_spec(path: str | Path, joint: str) -> mujoco.MjSpec:
    """An MJCF file with a slide or hinge of the given name; keyframes and sensors dropped.

    Raises:
        SceneFileError: The file cannot be read or has no such joint.
    """
    if not Path(path).is_file():
        what = "it is a folder; name the .xml or .urdf in it" if Path(path).is_dir() else "no such file"
        raise SceneFileError(f"object file {path}: {what}")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as error:
        if Path(path).suffix.lower() not in DESCRIPTIONS:
            allowed = " or ".join(DESCRIPTIONS)
            raise SceneFileError(
                f"object file {path}: not read as a description of an object: its name should end in {allowed}, "
                "which say that it is MJCF or URDF"
            ) from error
        raise SceneFileError(f"object file {path}: {one_line(error)}") from error
    names = [j.name for j in spec.joints]
    if joint not in names:
        named = ", ".join(name for name in names if name) or "none"
        raise SceneFileError(f"object file {path}: no joint {joint!r}; it has {named}")
    if spec.joint(joint).type not in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE):
        raise SceneFileError(f"object file {path}: joint {joint!r} is neither a slide nor a hinge")
    for unused in (spec.keys, spec.sensors):  # sensors move nothing; the planner reads its own by their order
        for thing in list(unused):
            spec.delete(thing)
    _name_part(spec, joint)
    return spec


def read_scene(path: str | Path, joint: str, arm: ArmDescription) -> SceneFile:
    """Read a scene and find where the arm stands in it.

    Raises:
        SceneFileError: Unreadable, no such joint, no place for the arm, or another arm than the described one.
    """
    spec = read_spec(path, joint)
    names = _names_in_scene(spec, arm, path)
    if joint in names:
        raise SceneFileError(f"scene {path}: joint {joint!r} belongs to arm {arm.name!r}, not to an object")
    _without_looks(spec)
    _with_absolute_files(spec, Path(path))
    try:
        model = spec.copy().compile()
    except (ValueError, mujoco.FatalError) as error:
        raise SceneFileError(f"scene {path}: {one_line(error)}") from error
    _refuse_not_finite(model, path)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    gravity_off = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    gravity = np.zeros(3) if gravity_off else model.opt.gravity.copy()
    had_arm = bool(names)
    if had_arm:
        X = _pose_of_included_arm(model, data, arm, names, path)
        _take_out_arm(spec, model, arm, names, path, joint)
    else:
        X = _pose_of_base(model, data, arm, path)
    logger.info("scene %s: arm %s at %s", path, "replaced" if had_arm else "placed", np.round(X[:3, 3], 3))
    return SceneFile(spec, X, gravity)


def _names_in_scene(spec: mujoco.MjSpec, arm: ArmDescription, path: str | Path) -> tuple[str, ...]:
    """What a scene calls the arm's joints: as the description does, or all with one prefix; empty without an arm.

    Raises:
        SceneFileError: The scene holds several of it.
    """
    joints = [joint.name for joint in spec.joints]
    taken = set(joints)
    first = arm.joint_names[0]
    prefixes = [name.removesuffix(first) for name in joints if name.endswith(first)]
    arms = [p for p in prefixes if taken.issuperset(p + name for name in arm.joint_names)]
    if len(arms) > 1:
        shown = ", ".join(repr(prefix) for prefix in arms)
        raise SceneFileError(
            f"scene {path}: it holds {len(arms)} arms {arm.name!r}, with the prefixes {shown}; keep one"
        )
    return tuple(arms[0] + name for name in arm.joint_names) if arms else ()


def _name_part(spec: mujoco.MjSpec, joint: str) -> None:
    """Give the body that the joint moves a name, which MJCF does not ask for: sensors refer to it by that."""
    part = spec.joint(joint).parent
    taken = {body.name for body in spec.bodies}
    if not part.name:
        part.name = next(name for k in count() if (name := f"{joint}_part{k or ''}") not in taken)


def one_line(error: Exception) -> str:
    """An error's text without its line breaks."""
    return " ".join(str(error).split())


def _id(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> int:
    return mujoco.mj_name2id(model, kind, name)


def _refuse_not_finite(model: mujoco.MjModel, path: str | Path) -> None:
    for field in _FIELDS:
        values = getattr(model, field)
        if not np.isfinite(values).all():
            row = int(np.argwhere(~np.isfinite(values))[0][0])
            raise SceneFileError(f"scene {path}: {field}[{row}] = {values[row]} is not finite")


def _without_looks(spec: mujoco.MjSpec) -> None:
    """Replace materials by their colour: planning needs no textures, and their files may be missing."""
    colours = {material.name: np.array(material.rgba) for material in spec.materials}
    for things in (spec.geoms, spec.sites, spec.tendons, spec.skins, spec.flexes):
        for thing in things:
            if thing.material:
                thing.rgba = colours.get(thing.material, thing.rgba)
                thing.material = ""
    for things in (spec.materials, spec.textures):
        for thing in list(things):
            spec.delete(thing)


def _with_absolute_files(spec: mujoco.MjSpec, path: Path) -> None:
    """Let meshes and height fields be found from anywhere."""
    folder = path.resolve().parent
    for thing in (*spec.meshes, *spec.hfields):
        if not thing.file:
            continue
        relative = Path(thing.file).name if spec.strippath else thing.file
        full = folder / spec.meshdir / relative
        if full.is_file():
            if not thing.name:
                thing.name = Path(relative).stem  # the name it has by default
            thing.file = str(full)


def _pose_of_base(
    model: mujoco.MjModel, data: mujoco.MjData, arm: ArmDescription, path: str | Path
) -> np.ndarray:
    site = _id(model, mujoco.mjtObj.mjOBJ_SITE, BASE_NAME)
    body = _id(model, mujoco.mjtObj.mjOBJ_BODY, BASE_NAME)
    if site < 0 and body < 0:
        raise SceneFileError(
            f"scene {path}: no body or site {BASE_NAME!r} to put arm {arm.name!r} on, and no arm with its joints "
            f'({", ".join(arm.joint_names)}) either; where the arm stands, add <site name="{BASE_NAME}" '
            'pos="x y z"/> to its worldbody'
        )
    owner = int(model.site_bodyid[site]) if site >= 0 else body
    if model.body_weldid[owner] != 0:
        raise SceneFileError(f"scene {path}: {BASE_NAME!r} moves; the arm's base has to stand still")
    X = np.eye(4)
    if site >= 0:
        X[:3, :3], X[:3, 3] = data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
    else:
        X[:3, :3], X[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
    return X


def _pose_of_included_arm(
    model: mujoco.MjModel, data: mujoco.MjData, arm: ArmDescription, names: tuple[str, ...], path: str | Path
) -> np.ndarray:
    """Base pose that puts the described arm's joints where the scene's arm has them.

    Raises:
        SceneFileError: The two arms differ by more than 2 mm or 10 mrad somewhere.
    """
    described = mujoco.MjSpec.from_string(arm.mjcf).compile()
    own = mujoco.MjData(described)
    pairs = tuple(zip(names, arm.joint_names, strict=True))
    for there, here in pairs:
        own.qpos[described.joint(here).qposadr[0]] = data.qpos[model.joint(there).qposadr[0]]
    mujoco.mj_kinematics(described, own)
    frames = [
        (_frame(data, int(model.joint(there).bodyid[0])), _frame(own, int(described.joint(here).bodyid[0])))
        for there, here in pairs
    ]
    base = described.body(arm.source.base).id
    X = frames[0][0] @ np.linalg.inv(frames[0][1]) @ _frame(own, base)
    for name, (there, here) in zip(names, frames, strict=True):
        difference = np.linalg.inv(there) @ X @ np.linalg.inv(_frame(own, base)) @ here
        if np.abs(difference[:3, 3]).max() > 2e-3 or np.abs(difference[:3, :3] - np.eye(3)).max() > 1e-2:
            raise SceneFileError(
                f"scene {path}: its arm has joint {name!r} {1e3 * np.linalg.norm(difference[:3, 3]):.0f} mm from where "
                f"arm {arm.name!r} has it; give the description of that arm with --arm"
            )
    return X


def _frame(data: mujoco.MjData, body: int) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
    return X


def _take_out_arm(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    arm: ArmDescription,
    names: tuple[str, ...],
    path: str | Path,
    joint: str,
) -> None:
    """Delete the bodies of the arm from its base on, with everything that refers to them."""
    root, spec_body = int(model.joint(names[0]).bodyid[0]), spec.joint(names[0]).parent
    base = names[0].removesuffix(arm.joint_names[0]) + arm.source.base
    task = int(model.joint(joint).bodyid[0])
    if task in _subtree(model, root):
        raise SceneFileError(f"scene {path}: joint {joint!r} hangs on the arm itself")
    # The body below the first link is the arm's base if it is called so, or a bare frame for it.
    while True:
        parent = int(model.body_parentid[root])
        name = model.body(parent).name
        others = _subtree(model, parent) - _subtree(model, root) - {parent}
        fixed = parent != 0 and not others and model.body_jntnum[parent] == 0 and name != BASE_NAME
        if not fixed or (model.body_geomnum[parent] and name != base):
            break
        root, spec_body = parent, spec_body.parent
    spec.delete(spec_body)


def _subtree(model: mujoco.MjModel, root: int) -> set[int]:
    inside = {root}
    for body in range(root + 1, model.nbody):
        if int(model.body_parentid[body]) in inside:
            inside.add(body)
    return inside
