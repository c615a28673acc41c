"""What the rest of the project knows about an arm: names, limits, models, hashes."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import yaml

from s2r_protocol.arms.mjcf import to_mjcf
from s2r_protocol.arms.source import ArmDescriptionError, ArmSource, read_source
from s2r_protocol.arms.urdf import to_urdf

SOURCE_FILE = "arm.yaml"
_SHIPPED = Path(__file__).parent


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits per joint, each an array of shape (dof,), in the arm's joint order.

    Attributes:
        q_min, q_max: Position [rad].
        dq_max: Speed [rad/s].
        ddq_max: Acceleration [rad/s²].
        dddq_max: Jerk [rad/s³].
        tau_max: Torque [N·m].
    """

    q_min: np.ndarray
    q_max: np.ndarray
    dq_max: np.ndarray
    ddq_max: np.ndarray
    dddq_max: np.ndarray
    tau_max: np.ndarray

    def as_dict(self) -> dict[str, list[float]]:
        """Plain lists, for files and for the native core."""
        names = ("q_min", "q_max", "dq_max", "ddq_max", "dddq_max", "tau_max")
        return {name: getattr(self, name).tolist() for name in names}


@dataclass(frozen=True, eq=False)
class ArmDescription:
    """One arm with its rigid tool. Frames: the world frame is the base frame, z up.

    Attributes:
        source: Everything ``arm.yaml`` says.
        directory: Where it was read from.
    """

    source: ArmSource
    directory: Path

    @property
    def name(self) -> str:
        """Short name, also part of the Zenoh keys."""
        return self.source.name

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.source.joints)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in the arm's order."""
        return tuple(j.name for j in self.source.joints)

    @property
    def tool_frame(self) -> str:
        """URDF frame and MJCF site at the fingertip, z out of the gripper."""
        return self.source.tool.name

    @cached_property
    def limits(self) -> JointLimits:
        """Joint limits as arrays of shape (dof,)."""
        joints = self.source.joints
        return JointLimits(
            q_min=np.array([j.q[0] for j in joints]),
            q_max=np.array([j.q[1] for j in joints]),
            dq_max=np.array([j.dq_max for j in joints]),
            ddq_max=np.array([j.ddq_max for j in joints]),
            dddq_max=np.array([j.dddq_max for j in joints]),
            tau_max=np.array([j.tau_max for j in joints]),
        )

    @cached_property
    def q_home(self) -> np.ndarray:
        """Home pose [rad], shape (dof,)."""
        return np.array(self.source.q_home)

    @cached_property
    def urdf(self) -> str:
        """The arm as URDF text."""
        return to_urdf(self.source)

    @cached_property
    def mjcf(self) -> str:
        """The arm as MJCF text: primitives, no actuators."""
        return to_mjcf(self.source)

    @cached_property
    def limits_yaml(self) -> str:
        """The limits as YAML text."""
        header = "# Generated from arm.yaml. SI units: rad, rad/s, rad/s2, rad/s3, N m.\n"
        body = {"joint_names": list(self.joint_names), **self.limits.as_dict()}
        return header + yaml.safe_dump(body, sort_keys=False, default_flow_style=None)

    @property
    def collision_exclude(self) -> tuple[tuple[str, str], ...]:
        """Link pairs never checked against each other: declared ones and rigid or jointed neighbours."""
        neighbours = tuple((c.parent, c.child) for c in (*self.source.joints, *self.source.mounts))
        return neighbours + self.source.collision_exclude

    @cached_property
    def model_hash(self) -> bytes:
        """SHA-256 of kinematics, inertias and shapes, 32 bytes. Part of every handshake."""
        model = self.source.model_dump(mode="json", exclude={"q_home", "vendor"})
        for joint in model["joints"]:
            for key in ("q", "dq_max", "ddq_max", "dddq_max", "tau_max"):
                del joint[key]
        for link in model["links"]:
            if not any(link["products"]):  # as it was before an arm could have them
                del link["products"]
        return _digest(model)

    @cached_property
    def limit_hash(self) -> bytes:
        """SHA-256 of the limits, 32 bytes. Part of every handshake."""
        return _digest({"joint_names": self.joint_names, **self.limits.as_dict()})


def _digest(value: object) -> bytes:
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).digest()


def shipped_arms() -> list[str]:
    """Names of the arms that come with the package."""
    return sorted(p.parent.name for p in _SHIPPED.glob(f"*/{SOURCE_FILE}"))


def load_arm(name_or_directory: str | Path) -> ArmDescription:
    """Load a shipped arm by name, or any folder that holds an ``arm.yaml``.

    Raises:
        ArmDescriptionError: There is no such arm, or its description is incomplete.
    """
    shipped = _SHIPPED / str(name_or_directory)
    if str(name_or_directory) in shipped_arms():
        return ArmDescription(read_source(shipped / SOURCE_FILE), shipped)
    directory = Path(name_or_directory)
    if not directory.is_dir():
        raise ArmDescriptionError(
            f"no arm {str(name_or_directory)!r}: neither a folder nor one of the shipped arms "
            f"({', '.join(shipped_arms())})"
        )
    return ArmDescription(read_source(directory / SOURCE_FILE), directory)
