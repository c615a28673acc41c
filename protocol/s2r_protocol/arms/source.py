"""Reading ``arm.yaml``, the one source of an arm: links, joints, shapes, limits, home pose."""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from s2r_protocol.exits import UsageError

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

Vector3 = tuple[float, float, float]
SHORTEST_ROD_M = 1e-3
FINGER_PREFIX = "finger"  # of the names of shapes that are meant to touch the part
WORLD = "world"  # MuJoCo's name for what nothing carries
NAMED_AXES: dict[str, Vector3] = {
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
}
_UNIT_LENGTH = 1e-3  # what a direction written with three digits is off
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class ArmDescriptionError(UsageError):
    """An arm description is missing, incomplete or contradicts itself."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Link(_Strict):
    """A rigid body: mass [kg], centre of mass [m] and moments of inertia about it [kg m²], axes as the link's.

    ``products`` are those of inertia, xy, xz and yz [kg m²]; without them the link's axes are principal ones.
    """

    name: str
    mass: Positive
    com: Vector3
    inertia: tuple[Positive, Positive, Positive]
    products: Vector3 = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _inertia_is_possible(self) -> Link:
        principal = (
            tuple(float(v) for v in np.linalg.eigvalsh(self.tensor)) if any(self.products) else self.inertia
        )
        a, b, c = sorted(principal)
        if a + b < c * (1 - 1e-9) or a <= 0.0:
            raise ValueError(
                f"link '{self.name}': principal inertias {principal} violate the triangle inequality; "
                "no body has them"
            )
        return self

    @property
    def tensor(self) -> np.ndarray:
        """Inertia about the centre of mass (3, 3) [kg m²]."""
        xy, xz, yz = self.products
        return np.diag(self.inertia) + np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])


class Joint(_Strict):
    """A revolute joint; ``origin`` [m] is the child's frame in the parent's, axes parallel at zero.

    ``axis`` is one of the frame's, which may count backwards (-z), or a direction of length 1 in it.
    """

    name: str
    parent: str
    child: str
    axis: Literal["x", "y", "z", "-x", "-y", "-z"] | Vector3
    origin: Vector3
    q: tuple[float, float]
    dq_max: Positive
    ddq_max: Positive
    dddq_max: Positive
    tau_max: Positive

    @model_validator(mode="after")
    def _range_is_open(self) -> Joint:
        if not self.q[0] < self.q[1]:
            raise ValueError(f"joint '{self.name}': q_min {self.q[0]} is not below q_max {self.q[1]}")
        return self

    @field_validator("axis", mode="before")
    @classmethod
    def _axis_is_a_direction(cls, axis: Any) -> Any:
        if isinstance(axis, str) and axis in NAMED_AXES:
            return axis
        if not isinstance(axis, list | tuple) or [type(v) in (int, float) for v in axis] != [True] * 3:
            raise ValueError(
                f"axis is {axis!r}, expected one of {', '.join(NAMED_AXES)} or a direction of length 1, [x, y, z]"
            )
        length = math.hypot(*axis)
        if not abs(length - 1.0) <= _UNIT_LENGTH:
            raise ValueError(f"axis {list(axis)} has length {length:.4g}, a direction has length 1")
        return axis

    @property
    def direction(self) -> Vector3:
        """The axis in the frame of parent and child at zero."""
        return NAMED_AXES[self.axis] if isinstance(self.axis, str) else self.axis


class Mount(_Strict):
    """A rigid attachment: ``origin`` [m] and roll-pitch-yaw [rad] of the child in its parent."""

    parent: str
    child: str
    origin: Vector3
    rpy: Vector3


class Tool(_Strict):
    """The tool frame, fixed in a link."""

    name: str
    parent: str
    origin: Vector3
    rpy: Vector3


class Rod(_Strict):
    """A capsule (round ends) or cylinder (flat ends) around the segment a-b [m]."""

    link: str
    name: str
    type: Literal["capsule", "cylinder"]
    a: Vector3
    b: Vector3
    radius: Positive

    @model_validator(mode="after")
    def _ends_are_apart(self) -> Rod:
        length_m = math.dist(self.a, self.b)
        if length_m < SHORTEST_ROD_M:  # MuJoCo cannot tell its direction
            raise ValueError(
                f"shape '{self.name}': a and b are {length_m:g} m apart, at least {SHORTEST_ROD_M:g} m are needed; "
                "a ball is a capsule of that length"
            )
        return self


class Box(_Strict):
    """A box with half extents [m], axes as the link's."""

    link: str
    name: str
    type: Literal["box"]
    center: Vector3
    half: tuple[Positive, Positive, Positive]


Shape = Annotated[Rod | Box, Field(discriminator="type")]


class ArmSource(_Strict):
    """Everything ``arm.yaml`` says. Joints form one chain from ``base``; mounts hang off it."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]  # part of the wire's keys
    vendor: str
    base: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    mounts: tuple[Mount, ...] = ()
    tool: Tool
    shapes: tuple[Shape, ...]
    collision_exclude: tuple[tuple[str, str], ...] = ()
    q_home: tuple[float, ...]

    @model_validator(mode="after")
    def _names_fit_together(self) -> ArmSource:
        links = [link.name for link in self.links]
        if WORLD in links:
            raise ValueError(
                f"no link may be called '{WORLD}', which is what the arm stands in; call it base"
            )
        _refuse_duplicates("link", links)
        _refuse_duplicates("joint", [j.name for j in self.joints])
        _refuse_duplicates("shape", [s.name for s in self.shapes])
        for what, used in (
            ("base", [self.base]),
            ("joints", [n for j in self.joints for n in (j.parent, j.child)]),
            ("mounts", [n for m in self.mounts for n in (m.parent, m.child)]),
            ("tool", [self.tool.parent]),
            ("shapes", [s.link for s in self.shapes]),
            ("collision_exclude", [n for pair in self.collision_exclude for n in pair]),
        ):
            unknown = sorted(set(used) - set(links))
            if unknown:
                raise ValueError(f"{what}: unknown link {unknown[0]!r}; this arm has {', '.join(links)}")
        _refuse_broken_chain(self)
        if len(self.q_home) != len(self.joints):
            raise ValueError(f"q_home has {len(self.q_home)} values for {len(self.joints)} joints")
        for joint, q in zip(self.joints, self.q_home, strict=True):
            if not joint.q[0] <= q <= joint.q[1]:
                raise ValueError(f"q_home: joint '{joint.name}' = {q} rad is outside {list(joint.q)} rad")
        return self

    def children_of(self, link: str) -> list[Joint | Mount]:
        """Joints and mounts that hang directly off a link, in file order."""
        return [c for c in (*self.joints, *self.mounts) if c.parent == link]

    def carried_by(self, link: str) -> frozenset[str]:
        """A link and all that is mounted on it: what moves as one body."""
        mounted = (self.carried_by(m.child) for m in self.mounts if m.parent == link)
        return frozenset({link}).union(*mounted)

    @property
    def standing(self) -> frozenset[str]:
        """Links that never move: the base and what is mounted on it, a pedestal or a second arm."""
        return self.carried_by(self.base)

    @property
    def hand(self) -> frozenset[str]:
        """Links of the gripper: what is mounted on the last link."""
        last = self.joints[-1].child
        return self.carried_by(last) - {last}

    def shapes_of(self, link: str) -> list[Rod | Box]:
        """Shapes of one link, in file order."""
        return [s for s in self.shapes if s.link == link]

    def link_named(self, name: str) -> Link:
        """The link with that name."""
        return next(link for link in self.links if link.name == name)


def _refuse_duplicates(what: str, names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{what} name {name!r} occurs {names.count(name)} times")


def _refuse_broken_chain(source: ArmSource) -> None:
    """Every link but the base has exactly one parent, and the joints follow each other."""
    parents = {link.name: 0 for link in source.links}
    for connection in (*source.joints, *source.mounts):
        parents[connection.child] += 1
    for name, count in parents.items():
        expected = 0 if name == source.base else 1
        if count != expected:
            raise ValueError(f"link '{name}' has {count} parents, expected {expected}")
    carried = source.base
    for joint in source.joints:
        if joint.parent != carried:
            raise ValueError(
                f"joint '{joint.name}' hangs off '{joint.parent}', expected '{carried}': joints form one chain"
            )
        carried = joint.child


def read_source(path: Path) -> ArmSource:
    """Read and check an ``arm.yaml``.

    Raises:
        ArmDescriptionError: The file is missing, not YAML, or incomplete; every problem is listed.
    """
    try:
        raw = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ArmDescriptionError(
            f"no arm description at {path}; a folder with an arm.yaml is needed"
        ) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ArmDescriptionError(f"{path} is not readable YAML: {error}") from error
    if not isinstance(raw, dict):
        raise ArmDescriptionError(
            f"{path} holds {type(raw).__name__}, expected the keys of an arm description"
        )
    try:
        return ArmSource.model_validate(raw)
    except ValidationError as error:
        raise ArmDescriptionError(
            f"{path} is not a complete arm description:\n{problems_in(error, raw)}"
        ) from error


def problems_in(error: ValidationError, raw: dict[str, Any]) -> str:
    """All that is wrong in the keys of an arm description, one line each."""
    return "\n".join(f"  {_where(e['loc'], raw)}: {_plain(e)}" for e in error.errors())


def _plain(error: ErrorDetails) -> str:
    """What is wrong with which value; our own checks name theirs."""
    kind, message = error["type"], error["msg"].removeprefix("Value error, ")
    if kind == "missing":
        return "is missing"
    if kind == "extra_forbidden":
        return "there is no such key"
    if kind in ("value_error", "union_tag_invalid"):
        return message
    return f"{message}, it is {textwrap.shorten(repr(error['input']), 60)}"


def _where(loc: tuple[int | str, ...], raw: dict[str, Any]) -> str:
    """``joints[2] (joint3).dq_max`` instead of pydantic's tuple."""
    text = ""
    node: Any = raw  # whatever the user wrote
    for part in loc:
        if isinstance(part, int):
            node = node[part] if isinstance(node, list) and part < len(node) else None
            name = node.get("name") if isinstance(node, dict) else None
            text += f"[{part}]" + (f" ({name})" if name else "")
        elif isinstance(node, dict) and part not in node and part in ("capsule", "cylinder", "box"):
            continue  # the discriminator of a union, no key of the file
        else:
            node = node.get(part) if isinstance(node, dict) else None
            text += f".{part}" if text else part
    return text or "arm"
