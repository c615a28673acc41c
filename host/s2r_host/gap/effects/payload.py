"""Something heavy at the end of the chain."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.gap.effects.base import (
    IMPOSSIBLE,
    Columns,
    Context,
    Effect,
    Shape,
    Value,
    free_name,
    small_is_odd,
)
from s2r_host.gap.motion.model import FEW_JOINTS, RigidModel
from s2r_host.gap.motion.quantities import LOAD
from s2r_host.gap.motion.session import Session

REACH = (0.5, 1.0, 1.5, 2.0)
FAR_REACH = (3.0, 5.0)  # what an arm holds may hang well beyond its last body
LEAST_REACH = 0.3
MOST_REACH = 1.5  # of the farthest reach tried: grams at the end of a long stick are an inertia, not a load
LEAST_ARM_M = 0.05
# Log odds of a free place, which also passes for what is wrong with the links' own masses.
ASIDE_ODDS = -200.0
AXES = ("x", "y", "z")
SIDE_M, PAIRS = 0.1, ((0, 1), (0, 2), (1, 2))
CORNERS = (
    (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1), (1, 1, 0), (1, 0, 1), (0, 1, 1),
)  # fmt: skip
NODES = (0.0, 1.0, 2.0)  # reaches at which a load is evaluated; a quadratic goes through three


class Payload(Effect):
    """A point mass m at p on one of the last bodies."""

    name = "payload"
    equation = "regressor of (m, m p) on all joints below the body"
    signature = "gravity and inertia residual on all distal joints together"
    separating_motion = "the same motion in two wrist orientations"
    confusable = ("effort_scale", "spring_return", "cable_spring", "armature")
    shows_over = LOAD
    scope = "model"

    def applies(self, ctx: Context, joint: int) -> bool:
        """Always."""
        return bool(leaves(ctx.model))

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Every last body, at several distances along its centre of mass; on arms also at places beside that line."""
        reach = _reaches(ctx)
        on_line = [{"body": float(b), "reach": x} for b in leaves(ctx.model) for x in reach]
        return on_line if len(ctx.model.joints) <= FEW_JOINTS else on_line + _places(ctx)

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Distance along the line, or the place."""
        return {"reach": ("log", 0.2)} | dict.fromkeys(AXES, ("linear", 0.3 * SIDE_M))

    def bounds(self, ctx: Context, joint: int) -> dict[str, tuple[float, float]]:
        """A load hangs from the body: near the joint a slow motion would ask for any mass, at a distance of nothing."""
        return {"reach": (LEAST_REACH, MOST_REACH * max(_reaches(ctx)))}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Load per added kilogram: weight and centre of mass go with the reach, inertia with its square.

        Beside that line, also per kilogram and metre along the body's axes, to first order from the place of the shape.
        """
        if "x" in shape:
            around = _around(ctx, s, int(shape["body"]), place_of(ctx, shape))
            return Columns.of_motion(around, (True, False, False, False))
        body, reach = int(shape["body"]), shape["reach"]
        near, middle, far = (_per_kilogram(ctx, s, body, x) for x in NODES)
        weights = ((reach - 1.0) * (reach - 2.0) / 2.0, reach * (2.0 - reach), reach * (reach - 1.0) / 2.0)
        return Columns.of_motion([weights[0] * near + weights[1] * middle + weights[2] * far], (True,))

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """Against a wrong number of the nominal model, and against grams so far away that they are none."""
        odds = 0.0
        if "x" in shape:
            near = np.linalg.norm(hangs_at(ctx, shape, theta)) < self._farthest(ctx, shape)
            odds = ASIDE_ODDS if near else IMPOSSIBLE
        return odds + small_is_odd(
            float(theta[0]) / max(float(ctx.model.model.body_mass[int(shape["body"])]), 1e-9)
        )

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Mass, and distance along the body's centre of mass or place in the body's frame."""
        distance = float(np.linalg.norm(arm(ctx.model, int(shape["body"]))))
        if "x" in shape:
            at, per_kg = hangs_at(ctx, shape, theta), 1.0 / max(float(theta[0]), 1e-9)
            moved = at - place_of(ctx, shape)
            return {"mass": Value(float(theta[0]), "kg", (1.0, 0.0, 0.0, 0.0))} | {
                axis: Value(float(at[i]), "m", (-moved[i] * per_kg, *(per_kg * (k == i) for k in range(3))))
                for i, axis in enumerate(AXES)
            }
        return {
            "mass": Value(float(theta[0]), "kg", (1.0,)),
            "distance": Value(shape["reach"] * distance, "m", shape_key="reach", scale=distance),
        }

    def patch(self, ctx: Context, spec: mujoco.MjSpec, joint: int, shape: Shape, theta: np.ndarray) -> bool:
        """A small extra body."""
        body = int(shape["body"])
        parent = spec.body(ctx.model.body_name(body))
        name = free_name("gap_payload", spec.bodies)
        extra = parent.add_body(name=name, pos=hangs_at(ctx, shape, theta))
        extra.mass, extra.inertia, extra.explicitinertial = float(theta[0]), np.full(3, 1e-8), 1
        extra.ipos = np.zeros(3)  # not given, MuJoCo takes the place twice, and writes no weight to the file
        return True

    def _farthest(self, ctx: Context, shape: Shape) -> float:
        _, high = self.bounds(ctx, -1)["reach"]
        return high * max(float(np.linalg.norm(arm(ctx.model, int(shape["body"])))), LEAST_ARM_M)


def place_of(ctx: Context, shape: Shape) -> np.ndarray:
    """Where a shape has its load [m], in the body's frame, shape (3,)."""
    if "x" in shape:
        return np.array([shape[axis] for axis in AXES])
    return shape["reach"] * arm(ctx.model, int(shape["body"]))


def hangs_at(ctx: Context, shape: Shape, theta: np.ndarray) -> np.ndarray:
    """Where the load hangs [m], in the body's frame, shape (3,)."""
    place = place_of(ctx, shape)
    return place if len(theta) == 1 or theta[0] <= 0.0 else place + theta[1:] / theta[0]


def _reaches(ctx: Context) -> tuple[float, ...]:
    """Distances of a load tried first, in distances of the body's own centre of mass."""
    return REACH if len(ctx.model.joints) == 1 else REACH + FAR_REACH


def _places(ctx: Context) -> list[dict[str, float]]:
    """Places at and around the centre of mass of every last body: the joints of an arm tell where a load hangs."""
    return [
        {"body": float(b)} | dict(zip(AXES, (ctx.model.model.body_ipos[b] + off).tolist(), strict=True))
        for b in leaves(ctx.model)
        for off in SIDE_M * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    ]


def _per_kilogram(ctx: Context, s: Session, body: int, reach: float) -> np.ndarray:
    """Change of the load per kilogram added at a reach along a body's arm, shape (time, joint)."""
    key = ("payload", body, reach)
    if key not in s.cache:
        s.cache[key] = _added(ctx, s, body, reach * arm(ctx.model, body))
    return s.cache[key]


def _around(ctx: Context, s: Session, body: int, place: np.ndarray) -> list[np.ndarray]:
    """Change of the load per kilogram at a place, and of that per metre along the body's axes: four columns.

    A mass adds weight, first and second moments: the change is a quadratic of its place, which ten places tell.
    """
    key = ("payload around", body)
    if key not in s.cache:
        at_origin, *rest = (_added(ctx, s, body, SIDE_M * np.array(corner)) for corner in CORNERS)
        ahead, back, across = rest[:3], rest[3:6], dict(zip(PAIRS, rest[6:], strict=True))
        slope = [(x - y) / (2.0 * SIDE_M) for x, y in zip(ahead, back, strict=True)]
        bend = {(i, i): (ahead[i] + back[i] - 2.0 * at_origin) / SIDE_M**2 for i in range(3)}
        for (i, j), both in across.items():
            bend[i, j] = bend[j, i] = (both - ahead[i] - ahead[j] + at_origin) / SIDE_M**2
        s.cache[key] = at_origin, slope, bend
    here, slope, bend = s.cache[key]
    turned = [slope[i] + sum(bend[i, j] * place[j] for j in range(3)) for i in range(3)]
    return [here + sum(0.5 * place[i] * (slope[i] + turned[i]) for i in range(3)), *turned]


def _added(ctx: Context, s: Session, body: int, place: np.ndarray) -> np.ndarray:
    """Change of the load per kilogram added at a place in the body's frame, shape (time, joint)."""
    m = max(0.05 * float(ctx.model.model.body_mass[body]), 1e-4)
    v = ctx.model.variant(lambda model: add_mass(model, body, m, place))
    return (ctx.model.inverse(s.q, s.v, s.a, v) - s.load) / m


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
