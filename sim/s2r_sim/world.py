"""One hidden world: object, true arm, true camera. Drawn from a seed, kept in a file, committed to by a salted hash.

Whoever runs the stand-in publishes the commitment first and the file after the run: nobody can have looked, and nobody
can change the world afterwards.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from pathlib import Path

import numpy as np
from pydantic import (
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    ValidationError,
    model_validator,
)

from s2r_protocol.arms import ArmDescription
from s2r_protocol.whole_file import write_whole
from s2r_sim.errors import WorldFileError
from s2r_sim.geometry import rotation_from_vector
from s2r_sim.objects.catalogue import ObjectSpec, kind_named
from s2r_sim.objects.effects import JointEffects
from s2r_sim.objects.parameters import Parameters, absent, uniform

SCHEMA = 1
LEAST_TILT = 1e-6  # of a camera's axis off the vertical [rad]

# Coulomb and viscous friction per joint [N·m, N·m·s/rad], fitted on a public 20 s, 1 kHz log of a real xMate arm with
# joint torque sensors (YanjunLIU-ac/Dynamic_Parameter_Identification_for_Rokae_xMate). bench_arm_friction.py holds them
# against the log, which hardly tells viscous friction: 0.05 stands where it has none, and joint 2 may have none.
MEASURED_COULOMB_Nm = (0.59, 0.68, 0.48, 0.59, 0.43, 0.41, 0.63)
MEASURED_VISCOUS_Nms_rad = (0.47, 0.35, 0.05, 0.45, 0.05, 0.05, 0.05)
# Of other arms, in shares of the torque limit [1 and s/rad]: what those values are of the xMate's.
_COULOMB_SHARE = (0.005, 0.022)
_VISCOUS_SHARE = (0.0005, 0.0046)
# What a gear winds up by under the joint's torque limit [rad]: the xMate's joints of 102 and 29 N·m then have 11,300 to
# 30,000 and 3,200 to 8,500 N·m/rad: harmonic drives of sizes 20 to 25 and 14 to 17 (Harmonic Drive LLC, CSF/CSG
# catalogue, torsional stiffness K1 at ratio 50).
_WIND_UP = (0.0034, 0.009)
_RELAXATION_S = (0.0003, 0.001)


class Gears(Parameters):
    """Springs between the motors, where encoders and brakes sit, and the links.

    Attributes:
        stiffness_Nm_rad: Of each joint's gear.
        relaxation_s: Damping over stiffness, the same for all.
    """

    stiffness_Nm_rad: tuple[PositiveFloat, ...]
    relaxation_s: NonNegativeFloat


class ArmTruth(Parameters):
    """How the real arm differs from its description; tuples have one entry per joint or its link.

    Attributes:
        coulomb_Nm, viscous_Nms_rad: Joint friction.
        link_mass_scale: True over nominal mass of link i+1.
        gears: That give way; None: they are rigid.
    """

    coulomb_Nm: tuple[NonNegativeFloat, ...]
    viscous_Nms_rad: tuple[NonNegativeFloat, ...]
    link_mass_scale: tuple[PositiveFloat, ...]
    gears: Gears | None = Field(default=None, exclude_if=absent)


class CameraTruth(Parameters):
    """Where the camera really is, and how far the calibration is off.

    Attributes:
        position_m: In the arm base frame.
        target_m: Point on the optical axis.
        roll_rad: About the optical axis; 0 keeps the image's x axis horizontal.
        hand_eye_m, hand_eye_rad: Error of the reported pose, in the camera frame (translation, rotation vector).
        seed: Of the dot pattern and the noise.
    """

    position_m: tuple[float, float, float]
    target_m: tuple[float, float, float]
    roll_rad: float
    hand_eye_m: tuple[float, float, float]
    hand_eye_rad: tuple[float, float, float]
    seed: NonNegativeInt

    @model_validator(mode="after")
    def _looks_aside(self) -> CameraTruth:
        """Roll is counted from the level, which a view straight up or down does not have."""
        x, y, z = np.abs(np.subtract(self.target_m, self.position_m)).tolist()
        if max(x, y) <= LEAST_TILT * z:
            raise ValueError("target_m is at, right above or right below position_m; move it aside by a hair")
        return self

    @property
    def X_base_camera_true(self) -> np.ndarray:
        """True pose of the left infrared camera (OpenCV axes) in the arm base frame, shape (4, 4)."""
        z = np.subtract(self.target_m, self.position_m)
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        X = np.eye(4)
        X[:3, :3] = np.column_stack([x, np.cross(z, x), z]) @ rotation_from_vector((0.0, 0.0, self.roll_rad))
        X[:3, 3] = self.position_m
        return X

    @property
    def X_base_camera_reported(self) -> np.ndarray:
        """The pose a calibration would report, shape (4, 4)."""
        error = np.eye(4)
        error[:3, :3] = rotation_from_vector(self.hand_eye_rad)
        error[:3, 3] = self.hand_eye_m
        return self.X_base_camera_true @ error


class WorldSpec(Parameters):
    """All that is hidden from the host.

    Attributes:
        salt: Random text that keeps the commitment from being guessed.
        seed: The world was drawn from; None for one written by hand.
        effects: Of the object's joint, beyond Coulomb and viscous friction.
    """

    schema_version: int = SCHEMA
    salt: str
    seed: int | None = None
    object: ObjectSpec
    effects: JointEffects = JointEffects()
    arm: ArmTruth
    camera: CameraTruth

    @model_validator(mode="after")
    def _known_schema(self) -> WorldSpec:
        if self.schema_version != SCHEMA:
            raise ValueError(f"schema_version {self.schema_version} is not {SCHEMA}")
        return self

    def to_json(self) -> str:
        """The world as JSON text, keys sorted; the commitment is made over exactly these bytes."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True, indent=1) + "\n"

    @property
    def commitment(self) -> str:
        """SHA-256 (hex) of salt and world."""
        return hashlib.sha256(self.salt.encode() + b"\n" + self.to_json().encode()).hexdigest()

    def save(self, path: Path) -> None:
        """Write the world file."""
        write_whole(path, self.to_json())


def load_world(path: Path) -> WorldSpec:
    """Read a world file.

    Raises:
        WorldFileError: It cannot be read, or a field is missing, unknown or impossible.
    """
    try:
        return WorldSpec.model_validate_json(path.read_bytes())
    except OSError as error:
        raise WorldFileError(f"world file {path}: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "file"
        raise WorldFileError(
            f"world file {path}: {where}: {first['msg']} ({error.error_count()} in all)"
        ) from error


def draw_world(
    seed: int, kind: str = "drawer", salt: str | None = None, arm: ArmDescription | None = None
) -> WorldSpec:
    """Draw a hidden world. The same seed gives the same world; the salt is fresh unless given.

    Object and camera do not depend on the arm.

    Args:
        seed: Of everything but the salt.
        kind: Of object.
        salt: Text that keeps the commitment from being guessed.
        arm: Whose joints get friction and links their true masses; None: the xMate3Pro, whose friction was measured.

    Raises:
        WorldFileError: Unknown kind of object.
    """
    rng_object, rng_arm, rng_camera = np.random.default_rng([seed, SCHEMA]).spawn(3)
    return WorldSpec(
        salt=salt if salt is not None else secrets.token_hex(16),
        seed=seed,
        object=kind_named(kind).draw(rng_object),
        arm=_draw_measured_arm(rng_arm)
        if arm is None or arm.name == "xmate3pro"
        else _draw_arm(rng_arm, arm),
        camera=_draw_camera(rng_camera),
    )


def _draw_arm(rng: np.random.Generator, arm: ArmDescription) -> ArmTruth:
    tau_max = arm.limits.tau_max
    return ArmTruth(
        coulomb_Nm=tuple(round(t * uniform(rng, *_COULOMB_SHARE), 6) for t in tau_max),
        viscous_Nms_rad=tuple(round(t * uniform(rng, *_VISCOUS_SHARE), 6) for t in tau_max),
        link_mass_scale=tuple(uniform(rng, 0.98, 1.15) for _ in tau_max),
    )


def _draw_measured_arm(rng: np.random.Generator) -> ArmTruth:
    return ArmTruth(
        coulomb_Nm=tuple(round(c * uniform(rng, 0.8, 1.2), 6) for c in MEASURED_COULOMB_Nm),
        viscous_Nms_rad=tuple(round(c * uniform(rng, 0.5, 1.5), 6) for c in MEASURED_VISCOUS_Nms_rad),
        link_mass_scale=tuple(uniform(rng, 0.98, 1.15) for _ in MEASURED_COULOMB_Nm),
    )


def draw_gears(rng: np.random.Generator, arm: ArmDescription) -> Gears:
    """Draw gears that give way as harmonic drives do: a class of figures, for no log tells those of the xMate."""
    return Gears(
        stiffness_Nm_rad=tuple(round(t / rng.uniform(*_WIND_UP), 1) for t in arm.limits.tau_max.tolist()),
        relaxation_s=uniform(rng, *_RELAXATION_S),
    )


def _draw_camera(rng: np.random.Generator) -> CameraTruth:
    """Beside the base on the right, 0.7 to 0.9 m from the object, looking down 25 to 35 degrees."""

    def near(center: tuple[float, float, float], spread: float) -> tuple[float, float, float]:
        x, y, z = (round(c + uniform(rng, -spread, spread), 6) for c in center)
        return x, y, z

    def within(radius: float) -> tuple[float, float, float]:
        direction = rng.normal(size=3)
        x, y, z = direction / np.linalg.norm(direction) * rng.uniform(0.2, 1.0) * radius
        return round(float(x), 7), round(float(y), 7), round(float(z), 7)

    return CameraTruth(
        position_m=near((0.02, -0.48, 0.56), 0.03),
        target_m=near((0.58, 0.0, 0.13), 0.02),
        roll_rad=uniform(rng, -0.02, 0.02),
        hand_eye_m=within(0.002),
        hand_eye_rad=within(float(np.deg2rad(0.2))),
        seed=int(rng.integers(2**31)),
    )
