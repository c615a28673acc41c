"""Something heavy at the end of the chain."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Shape, Value, free_name, small_is_odd
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session

REACH = (0.5, 1.0, 1.5, 2.0)
FAR_REACH = (3.0, 5.0)  # what an arm holds may hang well beyond its last body
LEAST_REACH = 0.3
MOST_REACH = 1.5  # of the farthest reach tried: grams at the end of a long stick are an inertia, not a load
NODES = (0.0, 1.0, 2.0)  # reaches at which a load is evaluated; a quadratic goes through three


class Payload(Effect):
    """A point mass m at p on one of the last bodies."""

    name = "payload"
    equation = "regressor of (m, m p) on all joints below the body"
    signature = "gravity and inertia residual on all distal joints together"
    separating_motion = "the same motion in two wrist orientations"
    confusable = ("effort_scale", "spring_return", "cable_spring", "armature")
    scope = "model"

    def applies(self, ctx: Context, joint: int) -> bool:
        """Always."""
        return bool(leaves(ctx.model))

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Every last body, at several distances along its centre of mass."""
        reach = _reaches(ctx)
        return [{"body": float(b), "reach": x} for b in leaves(ctx.model) for x in reach]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Distance."""
        return {"reach": ("log", 0.2)}

    def bounds(self, ctx: Context, joint: int) -> dict[str, tuple[float, float]]:
        """A load hangs from the body: near the joint a slow motion would ask for any mass, at a distance of nothing."""
        return {"reach": (LEAST_REACH, MOST_REACH * max(_reaches(ctx)))}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Load per added kilogram: weight and centre of mass go with the reach, inertia with its square."""
        body, reach = int(shape["body"]), shape["reach"]
        near, middle, far = (_per_kilogram(ctx, s, body, x) for x in NODES)
        weights = ((reach - 1.0) * (reach - 2.0) / 2.0, reach * (2.0 - reach), reach * (reach - 1.0) / 2.0)
        return Columns.of_motion([weights[0] * near + weights[1] * middle + weights[2] * far], (True,))

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """Against a wrong number of the nominal model."""
        return small_is_odd(float(theta[0]) / max(float(ctx.model.model.body_mass[int(shape["body"])]), 1e-9))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Mass and distance along the body's centre of mass."""
        distance = float(np.linalg.norm(arm(ctx.model, int(shape["body"]))))
        return {
            "mass": Value(float(theta[0]), "kg", (1.0,)),
            "distance": Value(shape["reach"] * distance, "m", shape_key="reach", scale=distance),
        }

    def patch(self, ctx: Context, spec: mujoco.MjSpec, joint: int, shape: Shape, theta: np.ndarray) -> bool:
        """A small extra body."""
        body = int(shape["body"])
        parent = spec.body(ctx.model.body_name(body))
        name = free_name("gap_payload", spec.bodies)
        extra = parent.add_body(name=name, pos=shape["reach"] * arm(ctx.model, body))
        extra.mass, extra.inertia, extra.explicitinertial = float(theta[0]), np.full(3, 1e-8), 1
        extra.ipos = np.zeros(3)  # not given, MuJoCo takes the place twice, and writes no weight to the file
        return True


def _reaches(ctx: Context) -> tuple[float, ...]:
    """Distances of a load tried first, in distances of the body's own centre of mass."""
    return REACH if len(ctx.model.joints) == 1 else REACH + FAR_REACH


def _per_kilogram(ctx: Context, s: Session, body: int, reach: float) -> np.ndarray:
    """Change of the load per kilogram added at a reach along a body's arm, shape (time, joint)."""
    key = ("payload", body, reach)
    if key not in s.cache:
        m = max(0.05 * float(ctx.model.model.body_mass[body]), 1e-4)
        p = reach * arm(ctx.model, body)
        v = ctx.model.variant(lambda model: add_mass(model, body, m, p))
        s.cache[key] = (ctx.model.inverse(s.q, s.v, s.a, v) - s.load) / m
    return s.cache[key]


def leaves(model: RigidModel) -> list[int]:
    """Moved bodies with mass that have no moved child with mass."""
    m = model.model
    moved = model.jointed_bodies()
    return [b for b in moved if not any(int(m.body_parentid[c]) == b for c in moved)]


def arm(model: RigidModel, body: int) -> np.ndarray:
    """Where along the body a load would hang: its centre of mass, or a tenth of a metre when that is the origin."""
    p = np.array(model.model.body_ipos[body])
    return p if np.linalg.norm(p) > 1e-4 else np.array([0.0, 0.0, 0.1])


def add_mass(m: mujoco.MjModel, body: int, mass: float, p: np.ndarray) -> None:
    """Add a point mass to a body: new mass, centre, and inertia about it (parallel axes)."""
    old = float(m.body_mass[body])
    c0 = np.array(m.body_ipos[body])
    c = (old * c0 + mass * p) / (old + mass)
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, m.body_iquat[body])
    R = R.reshape(3, 3)
    inertia = R @ np.diag(m.body_inertia[body]) @ R.T + old * _steiner(c0 - c) + mass * _steiner(p - c)
    values, vectors = np.linalg.eigh(inertia)
    if np.linalg.det(vectors) < 0:
        vectors[:, 0] *= -1.0
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, vectors.flatten())
    m.body_mass[body], m.body_ipos[body], m.body_inertia[body], m.body_iquat[body] = (
        old + mass,
        c,
        values,
        quat,
    )


def _steiner(r: np.ndarray) -> np.ndarray:
    return float(r @ r) * np.eye(3) - np.outer(r, r)


EFFECT = Payload()
