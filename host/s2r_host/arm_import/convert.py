"""From the tree of a URDF to what an ``arm.yaml`` says: one chain of joints whose frames are parallel at zero."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from s2r_host.arm_import.masses import possible, together
from s2r_host.arm_import.shapes import shapes_of, with_round_ends
from s2r_host.arm_import.touching import always_touching
from s2r_host.arm_import.urdf_tree import Inertial, UrdfJoint, UrdfTree, read_urdf, turn
from s2r_protocol.arms import ArmDescription, ArmDescriptionError
from s2r_protocol.arms.clearance import LINKS_APART_M
from s2r_protocol.arms.inertias import gyration_m, placeholders
from s2r_protocol.arms.source import FINGER_PREFIX, WORLD, ArmSource, problems_in

_UPRIGHT_RAD = 0.01
_PARALLEL_RAD = 2e-3  # 1.57 for a right angle is off by 0.8e-3
_OUTWARDS = 0.5  # least cosine between the tool's z axis and the way to it
_BESIDE = 1e-6  # of a limit: rounding [rad, m]
_NO_PRODUCT = 1e-6  # of a moment of inertia, what frames turned to and fro leave
_DIGITS = 9
_BASE_INERTIAL = Inertial(1.0, np.zeros(3), 0.01 * np.eye(3))  # it never moves

AXES = {
    "z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "-x": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "-y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
"""Rotations whose z axis is the named axis."""


@dataclass(frozen=True)
class Wishes:
    """What a URDF does not say.

    Attributes:
        base: Link that stands on the table; empty: of those that carry the tip the first with a mass or a shape.
        tip: Link whose frame is the fingertip's; empty: the only one that nothing hangs off.
        name: Name of the arm; empty: the robot's.
        left_out: Links that are left out with all that hangs off them, a second arm or a pedestal.
        held: Joints that are not the arm's own, with the value [rad, m] at which they stay.
        fingers: Links that may touch the object; empty: those with "finger" in their name.
        home: Home pose [rad]; empty: zeros, or the middle of a range without zero, until one is looked for.
        tip_axis: Axis of the tip's frame that points out of the gripper, a key of :data:`AXES`.
        exclude: Pairs of links that are not checked against each other.
        packages: Folders in which ``package://`` is looked for.
        ddq_max: Of all joints [rad/s²].
        dddq_max: Of all joints [rad/s³].
    """

    base: str = ""
    tip: str = ""
    tip_axis: str = "z"
    name: str = ""
    left_out: tuple[str, ...] = ()
    held: dict[str, float] = field(default_factory=dict)
    fingers: tuple[str, ...] = ()
    home: tuple[float, ...] = ()
    exclude: tuple[tuple[str, str], ...] = ()
    packages: tuple[Path, ...] = ()
    ddq_max: float = 6.0
    dddq_max: float = 300.0


@dataclass(frozen=True)
class Imported:
    """An arm as a URDF has it, and in words what was decided or left out on the way."""

    source: ArmSource
    told: tuple[str, ...]


def import_arm(urdf: Path, wishes: Wishes) -> Imported:
    """Read an arm from a URDF.

    Raises:
        ArmDescriptionError: It cannot be read, or holds what an ``arm.yaml`` cannot say.
    """
    tree = read_urdf(urdf)
    told: list[str] = []
    _refuse_unknown(tree, wishes)
    tree = _without(tree, wishes)
    tip = wishes.tip or _only_tip(tree, wishes.base or tree.root, wishes)
    base = wishes.base or _first_body(tree, tip)
    if base == WORLD:
        base, tree, wishes = _with_base_named(tree, wishes, told)
    chain = _chain(tree, base, tip, wishes)
    told.append(f"the arm's joints are {', '.join(j.name for j in chain)}")
    _tell_tilt(tree, base, told)
    poses = _poses(tree, base, {j.name for j in chain}, wishes, told)
    joints, names = _joints(chain, poses, wishes, told), [base, *(j.child for j in chain)]
    bodies = _Bodies(tree, poses, names)
    raw: dict[str, Any] = {
        "name": _arm_name(wishes.name or tree.name),
        "vendor": f"{tree.name or 'arm'}, from {urdf.name}",
        "base": base,
        "links": bodies.links(told),
        "joints": joints,
        "mounts": bodies.mounts(),
        "tool": bodies.tool(tip, wishes.tip_axis, told),
        "shapes": _shapes(tree, bodies, urdf, wishes, told),
        "q_home": _home(joints, wishes),
        "collision_exclude": wishes.exclude,
    }
    raw["joints"] = [
        {**joint, "parent": names[k], "child": names[k + 1], "origin": bodies.step(names[k], names[k + 1])}
        for k, joint in enumerate(joints)
    ]
    try:
        source = ArmSource.model_validate(raw)
    except ValidationError as error:
        raise ArmDescriptionError(f"{urdf} makes no arm description:\n{problems_in(error, raw)}") from error
    source = _without_placeholders(source, told)
    pairs = always_touching(ArmDescription(source, urdf.parent), LINKS_APART_M)
    told += [
        f"links '{a}' and '{b}' touch in every pose and are not checked"
        for a, b in pairs
        if bodies.carrier(a) != bodies.carrier(b)
    ]
    pairs = [*source.collision_exclude, *pairs]
    return Imported(source.model_copy(update={"collision_exclude": tuple(pairs)}), tuple(told))


def _without_placeholders(source: ArmSource, told: list[str]) -> ArmSource:
    """The arm with inertias no wider than its shapes, where they were far wider: simulated so, an arm falls."""
    for link, reach_m in placeholders(source):
        told.append(
            f"link '{link.name}' has the inertia of a body {gyration_m(link):.3g} m around, its shapes reach "
            f"{reach_m:.3g} m from its centre of mass: made as small as these; correct it"
        )
        smaller = (reach_m / gyration_m(link)) ** 2
        update = {
            key: tuple(_short(smaller * v) for v in getattr(link, key)) for key in ("inertia", "products")
        }
        links = (link.model_copy(update=update) if other is link else other for other in source.links)
        source = source.model_copy(update={"links": tuple(links)})
    return source


def _with_base_named(tree: UrdfTree, wishes: Wishes, told: list[str]) -> tuple[str, UrdfTree, Wishes]:
    """Another name for the base ``world``, as no link of an arm may be called, and tree and wishes with it."""
    new = next(name for name in ("base", "arm_base", "arm_root") if name not in tree.links)
    told.append(f"link '{WORLD}' is called '{new}' here")

    def here(link: str) -> str:
        return new if link == WORLD else link

    exclude = tuple((here(a), here(b)) for a, b in wishes.exclude)
    fingers = tuple(map(here, wishes.fingers))
    return new, tree.renamed(WORLD, new), replace(wishes, fingers=fingers, exclude=exclude)


def _refuse_unknown(tree: UrdfTree, wishes: Wishes) -> None:
    for option, names, known in (
        ("--base", [wishes.base], tree.links),
        ("--tip", [wishes.tip], tree.links),
        ("--finger", wishes.fingers, tree.links),
        ("--leave-out", wishes.left_out, tree.links),
        ("--exclude", [link for pair in wishes.exclude for link in pair], tree.links),
        ("--hold", wishes.held, tree.joints),
    ):
        for name in names:
            if name and name not in known:
                what = "joint" if option == "--hold" else "link"
                raise ArmDescriptionError(
                    f"{option}: there is no {what} {name!r}; there are {', '.join(known)}"
                )


def _without(tree: UrdfTree, wishes: Wishes) -> UrdfTree:
    """The tree without the links that are to be left out, and what hangs off them."""
    gone = {link for name in wishes.left_out for link in tree.below(name)}
    for option, link in (("--base", wishes.base or tree.root), ("--tip", wishes.tip)):
        if link in gone:
            raise ArmDescriptionError(
                f"--leave-out {', '.join(wishes.left_out)} takes {option} {link!r} away"
            )
    links = {name: link for name, link in tree.links.items() if name not in gone}
    return UrdfTree(tree.name, links, {name: j for name, j in tree.joints.items() if j.child not in gone})


def _first_body(tree: UrdfTree, tip: str) -> str:
    """Of what carries the tip, before anything moves, the first link with a mass or a shape; else the last.

    The root where that link is not upright in it: gravity and the table go by the base.
    """
    rigid = list(itertools.takewhile(lambda j: j.kind == "fixed", tree.way_to(tip)))
    links = [tree.root, *(j.child for j in rigid)]
    link = next((n for n in links if tree.links[n].inertial is not None or tree.links[n].solids), links[-1])
    return link if _tilt(tree, link) < _UPRIGHT_RAD else tree.root


def _tilt(tree: UrdfTree, link: str) -> float:
    """Angle [rad] between the z axes of a link and of the root, all joints at zero."""
    X = np.eye(4)
    for joint in tree.way_to(link):
        X = X @ joint.X_parent_joint
    return float(np.arctan2(np.linalg.norm(X[:2, 2]), X[2, 2]))


def _tell_tilt(tree: UrdfTree, base: str, told: list[str]) -> None:
    tilt = _tilt(tree, base)
    if tilt >= _UPRIGHT_RAD:
        told.append(
            f"base '{base}' is tilted by {np.degrees(tilt):.3g}° in the URDF; here its z axis points up, against "
            f"gravity: give --base {tree.root} if it is mounted as the URDF has it"
        )


def _only_tip(tree: UrdfTree, base: str, wishes: Wishes) -> str:
    """The one link at the end; several fixed frames there leave the choice open, and so do several fingers."""
    carriers = {j.parent for j in tree.joints.values()}
    tips = [link for link in tree.below(base) if link not in carriers]
    turning = ("revolute", "continuous")  # a gripper's slides are none of the arm's
    moving = {t: len([j for j in tree.way_to(t) if _moves(j, wishes) and j.kind in turning]) for t in tips}
    longest = [t for t in tips if moving[t] == max(moving.values())]
    if len(longest) != 1:
        raise ArmDescriptionError(
            f"several links are at the end of the arm: {', '.join(longest)}; name with --tip the one whose frame is "
            "the fingertip's, z out of the gripper (joints off the way to it are held)"
        )
    return longest[0]


def _moves(joint: UrdfJoint, wishes: Wishes) -> bool:
    return joint.kind != "fixed" and joint.name not in wishes.held and joint.mimic is None


def _chain(tree: UrdfTree, base: str, tip: str, wishes: Wishes) -> list[UrdfJoint]:
    """The arm's own joints, from the base to the tip."""
    way = tree.way_to(tip)
    if tip != base and base not in {j.parent for j in way}:
        raise ArmDescriptionError(f"--tip {tip} does not hang off the base {base!r}; name another --base")
    start = 0 if base == tree.root else next((k + 1 for k, j in enumerate(way) if j.child == base), len(way))
    chain = [j for j in way[start:] if _moves(j, wishes)]
    if not chain:
        raise ArmDescriptionError(f"no joint moves between the base {base!r} and {tip!r}; is --tip right?")
    problems = [
        f"joint '{j.name}' is {j.kind}; an arm.yaml holds revolute joints: --hold {j.name}=0 keeps it where it is"
        for j in chain
        if j.kind not in ("revolute", "continuous")
    ]
    problems += [
        f"joint '{j.name}' on the way to the tip follows '{j.mimic[0]}', which moves; those of an arm.yaml move by "
        f"themselves: --hold {j.name}=0 keeps it where it is"
        for j in way[start:]
        if j.mimic is not None and j.mimic[0] in {c.name for c in chain} and j.name not in wishes.held
    ]
    for j in chain:
        missing = [key for key in ("velocity", "effort") if not (getattr(j, key) or 0.0) > 0.0]
        if j.kind == "revolute":
            missing += [key for key in ("lower", "upper") if getattr(j, key) is None]
        if missing and j.kind in ("revolute", "continuous"):
            problems.append(
                f"joint '{j.name}' has no {', '.join(missing)} above 0 in its <limit>; say it there"
            )
    if problems:
        raise ArmDescriptionError("this arm cannot be described:\n" + "\n".join(f"  {p}" for p in problems))
    return chain


def _poses(
    tree: UrdfTree, base: str, moving: set[str], wishes: Wishes, told: list[str]
) -> dict[str, np.ndarray]:
    """Pose (4, 4) in the base of everything below it, all joints of the arm at zero; frames of joints included."""
    poses = {base: np.eye(4)}
    for link in tree.below(base):
        for joint in (j for j in tree.joints.values() if j.parent == link):
            X = poses[link] @ joint.X_parent_joint
            if joint.kind != "fixed" and joint.name not in moving:
                value = _held_at(tree, joint, moving, wishes)
                told.append(_said_of_held(joint, value))
                step = np.eye(4)
                if joint.kind == "prismatic":
                    step[:3, 3] = value * joint.axis
                elif joint.kind in ("revolute", "continuous"):
                    step[:3, :3] = turn(joint.axis, value)
                X = X @ step
            poses[joint.child] = X
    left_out = len(tree.links) - len(poses)
    if left_out:
        told.append(
            f"{left_out} links that do not hang off '{base}' are left out; the world frame is that of '{base}'"
        )
    return poses


def _held_at(tree: UrdfTree, joint: UrdfJoint, moving: set[str], wishes: Wishes) -> float:
    """Where a joint stands [rad, m], all joints of the arm at zero; a follower where its leader has it."""
    if joint.name in moving:
        return 0.0
    if joint.name in wishes.held:
        return wishes.held[joint.name]
    if joint.mimic is not None and joint.mimic[0] in tree.joints:
        leader, factor, shift = joint.mimic
        return factor * _held_at(tree, tree.joints[leader], moving, wishes) + shift
    if joint.kind == "continuous" or joint.lower is None or joint.upper is None:
        return 0.0
    return min(max(0.0, joint.lower), joint.upper)


def _said_of_held(joint: UrdfJoint, value: float) -> str:
    unit = "m" if joint.kind == "prismatic" else "rad"
    said = f"joint '{joint.name}' is held at {value:g} {unit}"
    if joint.kind == "continuous" or joint.lower is None or joint.upper is None:
        return said
    if joint.lower - _BESIDE <= value <= joint.upper + _BESIDE:
        return said
    hint = "" if joint.kind == "prismatic" else ", degrees?"
    return f"{said}, beyond its limits {[_short(joint.lower), _short(joint.upper)]} {unit}{hint}"


def _joints(
    chain: Sequence[UrdfJoint], poses: dict[str, np.ndarray], wishes: Wishes, told: list[str]
) -> list[dict[str, Any]]:
    joints = []
    for joint in chain:
        axis = poses[joint.child][:3, :3] @ joint.axis
        k = int(np.argmax(np.abs(axis)))
        along = ("-" if axis[k] < 0.0 else "") + "xyz"[k]
        off = float(np.arctan2(np.linalg.norm(np.delete(axis, k)), abs(axis[k])))
        if 1e-5 < off <= _PARALLEL_RAD:
            told.append(f"joint '{joint.name}': its axis was turned by {1e3 * off:.2g} mrad onto {along}")
        low, high = _range(joint, told)
        joints.append(
            {
                "name": joint.name,
                "axis": along if off <= _PARALLEL_RAD else _rounded(axis),
                "q": (_short(low), _short(high)),
                "dq_max": joint.velocity,
                "ddq_max": wishes.ddq_max,
                "dddq_max": wishes.dddq_max,
                "tau_max": joint.effort,
            }
        )
    return joints


def _range(joint: UrdfJoint, told: list[str]) -> tuple[float, float]:
    """Position limits [rad]: the hard ones, or the soft ones where these are narrower."""
    if joint.kind == "continuous":
        low, high = -2.0 * np.pi, 2.0 * np.pi
        told.append(f"joint '{joint.name}' turns without end in the URDF; here ±2π")
    else:
        low, high = joint.lower or 0.0, joint.upper or 0.0
    if joint.soft is None:
        return low, high
    within = max(low, joint.soft[0]), min(high, joint.soft[1])
    if within == (low, high) or within[0] >= within[1]:
        return low, high
    told.append(
        f"joint '{joint.name}' keeps the soft limits of its <safety_controller>, {list(map(_short, within))} rad; its "
        f"stops are at {[_short(low), _short(high)]} rad"
    )
    return within


class _Bodies:
    """The bodies of the arm: one per joint and the base, in frames parallel to the base's at zero.

    Mounts are what they carry rigidly and has a mass of its own; they keep the URDF's frames.
    """

    def __init__(self, tree: UrdfTree, poses: dict[str, np.ndarray], names: Sequence[str]) -> None:
        self._tree, self._poses, self.names = tree, poses, list(names)
        self._of: dict[str, str] = {}  # the body that carries a link
        for link in poses:
            way = [j.child for j in tree.way_to(link)]
            self._of[link] = next((c for c in reversed(way) if c in names), names[0])

    def step(self, parent: str, child: str) -> list[float]:
        """Where a body's frame is in its parent's, at zero [m]."""
        return _rounded(self._poses[child][:3, 3] - self._poses[parent][:3, 3])

    def carrier(self, link: str) -> str:
        """The body that a link moves with."""
        return self._of[link]

    def members(self, body: str) -> list[str]:
        """All links that a body carries rigidly, itself first."""
        return [link for link in self._of if self._of[link] == body]

    def is_mount(self, link: str) -> bool:
        """Whether a link is a rigid attachment of its own: it has a mass and a shape, and what carries it a mass."""
        solid = self._stands_alone(link) and bool(self._tree.links[link].solids)
        return solid and link not in self.names and self._stands_alone(self._of[link])

    def place(self, link: str) -> tuple[str, np.ndarray]:
        """The body or mount that a link belongs to, and the link's pose in it (4, 4)."""
        way = [j.child for j in self._tree.way_to(link)]
        body = self._of[link]
        for above in reversed(way[way.index(body) + 1 :] if body in way else way):
            if above in self._poses and self.is_mount(above):
                return above, np.linalg.inv(self._poses[above]) @ self._poses[link]
        X = self._poses[link].copy()
        X[:3, 3] -= self._poses[body][:3, 3]
        return body, X

    def links(self, told: list[str]) -> list[dict[str, Any]]:
        """Mass properties of bodies and mounts."""
        problems, found = [], []
        for body in self.names:
            for link in (body, *filter(self.is_mount, self.members(body))):
                try:
                    found.append(_link(link, possible(link, self._whole(body, link), told)))
                    told += self._points(body, link)
                except ArmDescriptionError as error:
                    if body == self.names[0]:
                        told.append(f"{error}; 1 kg stands for it, as it does not move")
                        found.append(_link(link, _BASE_INERTIAL))
                    else:
                        problems.append(f"{error}; it moves: say it in its <inertial>")
        if problems:
            raise ArmDescriptionError(
                "this arm cannot be described:\n" + "\n".join(f"  {p}" for p in problems)
            )
        return found

    def _parts(self, body: str, link: str) -> list[tuple[str, Inertial | None, np.ndarray]]:
        """All that moves with a body or mount and is no mount of its own, with its pose in it (4, 4)."""
        placed = [(m, *self.place(m)) for m in self.members(body)]
        return [(m, self._tree.links[m].inertial, X) for m, place, X in placed if place == link]

    def _whole(self, body: str, link: str) -> Inertial | None:
        return together([(inertial, X) for _, inertial, X in self._parts(body, link)])

    def _points(self, body: str, link: str) -> list[str]:
        """What is told about the parts that have a mass and no inertia."""
        return [
            f"link '{part}' has a mass of {inertial.mass:g} kg and no inertia: it counts as a point"
            for part, inertial, _ in self._parts(body, link)
            if inertial is not None and not inertial.inertia.any()
        ]

    def _stands_alone(self, body: str) -> bool:
        """Whether a body's own mass can be written; a point without extent is a part of what carries it."""
        inertial = self._tree.links[body].inertial
        return body == self.names[0] or (inertial is not None and bool(inertial.inertia.any()))

    def mounts(self) -> list[dict[str, Any]]:
        """Rigid attachments with a mass, each in the frame that the URDF gives it."""
        return [
            {
                "parent": body,
                "child": link,
                "origin": self.step(body, link),
                "rpy": _rpy(self._poses[link][:3, :3]),
            }
            for body in self.names
            for link in self.members(body)
            if self.is_mount(link)
        ]

    def tool(self, tip: str, outwards: str, told: list[str]) -> dict[str, Any]:
        """The tool frame: that of the tip, turned so that its z axis is the given axis."""
        body, X = self.place(tip)
        X[:3, :3] = X[:3, :3] @ AXES[outwards]
        where = f"the frame of '{tip}'" + (
            "" if outwards == "z" else f", turned so that its {outwards} axis is z"
        )
        told.append(f"tool_tip is {where}; it must be the centre of the fingertip's end face, z outwards")
        way = (self._poses[tip] - self._poses[self.carrier(tip)])[:3, 3]  # from the last joint, all at zero
        z = self._poses[tip][:3, :3] @ AXES[outwards][:, 2]
        if way @ z < _OUTWARDS * np.linalg.norm(way):
            told.append(
                f"the z axis of tool_tip does not point the way in which '{tip}' lies from the last joint; name with "
                "--tip-axis the axis that does"
            )
        taken = [*self.names, *(m["child"] for m in self.mounts())]
        name = "tool_tip" if "tool_tip" not in taken else "tool_tip_frame"
        return {"name": name, "parent": body, "origin": _rounded(X[:3, 3]), "rpy": _rpy(X[:3, :3])}


def _link(name: str, inertial: Inertial) -> dict[str, Any]:
    moments, products = np.diag(inertial.inertia), inertial.inertia[[0, 0, 1], [1, 2, 2]]
    found = {"name": name, "mass": _short(inertial.mass), "com": _rounded(inertial.com)}
    if np.abs(products).max() > _NO_PRODUCT * moments.max():
        return {**found, "inertia": [_short(v) for v in moments], "products": [_short(v) for v in products]}
    a, b, c = (_short(v) for v in np.sort(moments))
    largest = int(np.argmax(moments))
    rounded = [_short(v) for v in moments]
    if a + b < c <= (a + b) * (1 + 1e-5):  # a plate, rounded
        rounded[largest] = a + b
    return {**found, "inertia": rounded}


def _shapes(
    tree: UrdfTree, bodies: _Bodies, urdf: Path, wishes: Wishes, told: list[str]
) -> list[dict[str, Any]]:
    shapes, problems, enclosed = [], [], 0
    fingers = set(wishes.fingers) or {n for n in tree.links if FINGER_PREFIX in n.lower()}
    touching = False
    for body in bodies.names:
        for link in bodies.members(body):
            place, X = bodies.place(link)
            solids = tree.links[link].solids
            touches = link in wishes.fingers or (
                link in fingers and not any(s.name.startswith(FINGER_PREFIX) for s in solids)
            )
            for k, solid in enumerate(solids):
                try:
                    pieces = shapes_of(solid, X, urdf, wishes.packages)
                except ArmDescriptionError as error:
                    problems.append(f"  link '{link}': {error}")
                    continue
                enclosed += solid.kind == "mesh"
                name = solid.name or f"{link}_{k}"
                if touches and not name.startswith(FINGER_PREFIX):
                    name = f"{FINGER_PREFIX}_{name}"
                touching |= name.startswith(FINGER_PREFIX)
                while any(s["name"].startswith(name) for s in shapes):
                    name += "_2"
                for piece, letter in zip(pieces, "abcd" if len(pieces) > 1 else ("",), strict=False):
                    numbers = {
                        key: _rounded(v) if isinstance(v, list) else v if isinstance(v, str) else _short(v)
                        for key, v in piece.items()
                    }
                    shapes.append({"link": place, "name": name + letter, **numbers})
    if problems:
        raise ArmDescriptionError("some shapes cannot be had:\n" + "\n".join(problems))
    if enclosed:
        told.append(
            f"{enclosed} meshes became the smallest boxes, cylinders and capsules along the axes that hold each"
        )
    if not touching:
        told.append(
            "no link may touch the object; name the fingertip's with --finger, or name its shapes finger_…"
        )
    return with_round_ends(shapes)


def _home(joints: Sequence[dict[str, Any]], wishes: Wishes) -> list[float]:
    if wishes.home:
        if len(wishes.home) != len(joints):
            raise ArmDescriptionError(
                f"--home has {len(wishes.home)} values; this arm has {len(joints)} joints: "
                + ", ".join(j["name"] for j in joints)
            )
        return list(wishes.home)
    return [0.0 if low < 0.0 < high else _short(0.5 * (low + high)) for low, high in (j["q"] for j in joints)]


def _arm_name(name: str) -> str:
    """A name that can be part of a key."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", name).lstrip("_.-") or "arm"


def _rpy(R: np.ndarray) -> list[float]:
    """Roll, pitch, yaw [rad] of a rotation (3, 3), about fixed axes."""
    level = float(np.hypot(R[0, 0], R[1, 0]))
    roll, yaw = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
    if level < 1e-9:  # straight up or down: only their sum or difference is known
        roll, yaw = np.arctan2(-R[1, 2], R[1, 1]), 0.0
    return [round(float(v), 12) + 0.0 for v in (roll, np.arctan2(-R[2, 0], level), yaw)]


def _rounded(values: Sequence[float] | np.ndarray) -> list[float]:
    return [round(float(v), _DIGITS) + 0.0 for v in values]


def _short(value: float) -> float:
    return float(f"{value:.7g}")
