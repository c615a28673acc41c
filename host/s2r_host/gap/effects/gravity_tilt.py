"""Base not level: gravity points elsewhere."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Shape, Value, turned
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.quantities import POSITION
from s2r_host.gap.motion.session import Session

STEP = 1e-2
LEVEL = 0.05  # rad to which a base is put up


class GravityTilt(Effect):
    """g = R(tilt) g0."""

    name = "gravity_tilt"
    equation = "g = R(rx, ry) g0"
    signature = "sine and cosine of the absolute pose on the first joints"
    separating_motion = "first joint at 0 and at 90 degrees"
    confusable = ("encoder_offset", "payload", "cable_spring")
    shows_over = POSITION
    scope = "model"

    def applies(self, ctx: Context, joint: int) -> bool:
        """Needs gravity."""
        return float(np.linalg.norm(ctx.model.model.opt.gravity)) > 1e-6

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Derivative of the load by the two tilt angles; a direction without influence is left out."""
        both = tilted_loads(ctx.model, s)
        return Columns.of_motion([both[axis] for axis in self._axes(ctx)])

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """A base is put up level to a few degrees."""
        return turned(float(np.linalg.norm(theta)), LEVEL)

    def _axes(self, ctx: Context) -> list[int]:
        s = ctx.sessions[0]
        sizes = [float(np.sqrt(np.mean(load**2))) for load in tilted_loads(ctx.model, s)]
        return [axis for axis in range(2) if sizes[axis] > 1e-3 * max(sizes)] or [0]

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Tilt angles; a single joint sees only one of them."""
        found = {}
        for i, axis in enumerate(self._axes(ctx)):
            gradient = [0.0] * len(theta)
            gradient[i] = 1.0
            found[f"tilt_{'xy'[axis]}"] = Value(float(theta[i]), "rad", tuple(gradient))
        return found

    def patch(self, ctx: Context, spec: mujoco.MjSpec, joint: int, shape: Shape, theta: np.ndarray) -> bool:
        """Stock option ``gravity``."""
        g = np.array(ctx.model.model.opt.gravity)
        strength = float(np.linalg.norm(g))
        directions = tilt_directions(ctx.model.model)
        for value, axis in zip(theta, self._axes(ctx), strict=True):
            g = g + float(value) * strength * directions[axis]
        spec.option.gravity = g / np.linalg.norm(g) * strength
        return True


def tilted_loads(model: RigidModel, s: Session) -> list[np.ndarray]:
    """How the load of every joint changes with the tilt of the base about two level axes, [N·m/rad], (time, dof) each.

    Nothing where there is no gravity.
    """
    strength = float(np.linalg.norm(model.model.opt.gravity))
    if strength == 0.0:
        return []
    for axis, across in enumerate(tilt_directions(model.model)):

        def change(m: mujoco.MjModel, across: np.ndarray = across) -> None:
            m.opt.gravity[:] = m.opt.gravity + STEP * strength * across

        if ("tilt", axis) not in s.cache:
            s.cache["tilt", axis] = (model.inverse(s.q, s.v, s.a, model.variant(change)) - s.load) / STEP
    return [s.cache["tilt", axis] for axis in range(2)]


def tilt_directions(m: mujoco.MjModel) -> np.ndarray:
    """Two unit vectors across gravity, shape (2, 3); x and y for gravity along -z."""
    down = np.array(m.opt.gravity) / np.linalg.norm(m.opt.gravity)
    first = np.array([1.0, 0.0, 0.0]) if abs(down[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = first - down * (first @ down)
    first /= np.linalg.norm(first)
    second = np.cross(-down, first)
    return np.stack([first, second])


EFFECT = GravityTilt()
