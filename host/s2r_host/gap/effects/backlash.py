"""Backlash: a dead zone between motor and link, which carries either an inertia or only friction.

With inertia behind the gap the hidden link is integrated. With friction alone (a damper, a brake band, a light part)
no inertia is needed: the link stays until the gap is crossed and the contact's spring pulls as hard as the friction;
the transmitted force is a dead zone of a stop operator.
"""

from __future__ import annotations

from itertools import product

import mujoco
import numpy as np

from s2r_host.gap.effects.base import (
    Columns,
    Context,
    Effect,
    Runtime,
    Shape,
    StepState,
    Value,
    as_written,
)
from s2r_host.gap.effects.joint_elasticity import (
    AT_LINK,
    SERVO,
    beside_servo,
    encoder_odds,
    felt,
    gear,
    hung,
    mean_inertia,
    motor_odds,
    motor_shares,
    second_joint,
    servo_known,
)
from s2r_host.gap.motion.quantities import SINCE_TURN, TRANSMITTED, Quantity
from s2r_host.gap.motion.session import Session
from s2r_host.gap.motion.states import stop_operator
from s2r_host.gap.motion.two_masses import behind_motor

NARROWEST, WIDEST = (0.0001, 0.0006), 0.05  # half widths tried, as shares of the travel
RESOLVED, WIDTH_RATIO = 20.0, 0.193  # encoder steps in a width that shows; logarithm of the next by the last
LOOSE_SHARES = (0.25, 0.4, 0.55, 0.7, 0.85)  # free part of the travel between both friction forces
# Link frequency in contact, and its damping ratio: behind a recorded motor nothing but damped contacts can be followed.
CONTACTS_HZ, FLANKS_HZ, REBOUNDS = (13.0, 24.0), (9.0, 13.0, 18.0, 25.0, 35.0), (0.06, 0.3)
NO_REBOUND = 2.0  # damping ratio of the flanks; beyond it only the steps of the integration get smaller
LOOSE_ODDS = -3.0  # a joint whose load is friction alone is the rarer machine


class Backlash(Effect):
    """T = -k dz(δ, w): nothing is transmitted while |q_link - q_motor| < w; q is read at the motor, or at the link."""

    name = "backlash"
    model_error = {"half_width": 0.1}  # noqa: RUF012
    equation = "T = k dz(q_motor - q_link, w)"
    signature = "after each reversal of the load the effort vanishes for a constant travel, then an impact"
    separating_motion = "reversals with and without preload"
    confusable = ("presliding", "hysteresis", "joint_elasticity")
    shows_over = TRANSMITTED
    costly = True
    explained_least = 0.5  # impacts are chaotic: no model follows each of them

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """The load has to change sign, or the gap is never crossed."""
        load = np.concatenate([s.load[:, joint] for s in ctx.sessions])
        both = min(np.mean(load > 0), np.mean(load < 0))
        return None if both > 0.005 else "the load never changes sign: the gap is never crossed"

    def shown_over(self, shape: Shape) -> Quantity:
        """Play that holds friction shows behind each reversal, other play where the load changes its sign."""
        return SINCE_TURN if "loose" in shape else self.shows_over

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Half widths up to 5 % of the travel, from 0.01 % of it, or from 0.06 % where nothing tells such small ones.

        They are told by an encoder that resolves them, or by the declared law of the motor.
        """
        low, high = ctx.span(joint)
        step = max(float(s.q_lsb[joint]) for s in ctx.sessions)
        reaches = [r for r in (high - low) * np.geomspace(0.002, 0.3, 16) if r > 4.0 * step]
        loose = [
            {"reach": float(r), "loose": x} for r in reaches for x in LOOSE_SHARES if ctx.turns(joint) >= 2
        ]
        seeds = [(w, f, 0.4, {}) for w in _widths(RESOLVED * step / (high - low)) for f in CONTACTS_HZ]
        if servo_known(ctx, joint):
            seeds += [(w, f, z, SERVO) for w in _widths(0.0) for f in FLANKS_HZ for z in REBOUNDS]
            rarer = (_widths(0.0)[::2], FLANKS_HZ[1::2], REBOUNDS)
            seeds += [(w, f, z, SERVO | AT_LINK) for w, f, z in product(*rarer)]
        return loose + [
            {"w": float((high - low) * w), "motor": m, "f": f, "zeta": z} | servo
            for m in motor_shares(ctx, joint)
            for w, f, z, servo in seeds
        ]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Width on a log scale, motor share linear."""
        return {
            "w": ("log", 0.24), "motor": ("linear", 0.1), "f": ("log", 0.24), "zeta": ("log", 0.48),
            "reach": ("log", 0.15), "loose": ("linear", 0.08),
        }  # fmt: skip

    def bounds(self, ctx: Context, joint: int) -> dict[str, tuple[float, float]]:
        """Less than a fifth of free travel is presliding; flanks damped twice critically do not rebound any more."""
        return {"loose": (0.2, 0.95), "zeta": (0.0, NO_REBOUND)}

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """Friction alone behind the gap is rarer than an inertia; a motor's is known where the model states one."""
        if "loose" in shape:
            return LOOSE_ODDS
        return motor_odds(ctx, joint, shape["motor"]) + encoder_odds(shape)

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Motor inertia plus transmitted effort, minus the rigid load; or friction behind the gap."""
        if "loose" in shape:
            pull = behind_gap(stop_operator(s, joint, shape["reach"]), shape["loose"])
            if float(ctx.model.model.dof_frictionloss[joint]) > 0.0:
                return Columns([pull, s.sign(joint)], (True, False))
            return Columns([pull], (True,))
        between = gear(ctx, joint, shape, shape["w"])
        if "servo" in shape:
            return beside_servo(ctx, s, joint, between, at_link="at_link" in shape)
        return felt(ctx, s, joint, between, behind_motor(s, joint, hung(ctx, s, joint), between))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Half width and motor inertia."""
        name = ctx.model.joints[joint]
        if "loose" in shape:
            free = shape["reach"] * shape["loose"]
            return {
                "half_width": Value(free, ctx.model.unit(name), shape_key="loose", scale=shape["reach"]),
                "friction_behind": Value(
                    float(theta[0]), ctx.model.effort_unit(name), (1.0, 0.0)[: len(theta)]
                ),
                "contact_travel": Value(
                    shape["reach"] - free, ctx.model.unit(name), shape_key="reach", scale=1.0 - shape["loose"]
                ),
            }
        J = mean_inertia(ctx, joint)
        return {
            "half_width": Value(shape["w"], ctx.model.unit(name), shape_key="w"),
            "motor_inertia": Value(
                J * shape["motor"], ctx.model.inertia_unit(name), shape_key="motor", scale=J
            ),
        }

    def patch(self, ctx: Context, spec: mujoco.MjSpec, joint: int, shape: Shape, theta: np.ndarray) -> bool:
        """A second, coincident joint with a range of ±w; friction behind the gap has no stock form."""
        if "loose" in shape:
            return False
        flex = second_joint(ctx, spec, joint, shape["motor"] * mean_inertia(ctx, joint))
        half = as_written(spec, flex, shape["w"])
        flex.range = [-half, half]
        flex.limited = 1
        flex.solref_limit = [0.004, 0.7]
        return True

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Friction behind the gap as force; the friction the model puts before it is taken back."""
        reach, loose, level = shape["reach"], shape["loose"], float(theta[0])
        before = float(theta[1]) if len(theta) > 1 else 0.0
        z = 0.0
        last: float | None = None

        def step(state: StepState) -> tuple[float, float]:
            nonlocal z, last
            q = float(state.q[joint])
            z = min(1.0, max(-1.0, z + (0.0 if last is None else q - last) / reach))
            last = q
            return level * float(behind_gap(np.asarray(z), loose)), before

        return step


def behind_gap(z: np.ndarray, loose: float) -> np.ndarray:
    """Share of the friction that reaches the motor when the slip is ``z`` and the gap takes ``loose`` of it."""
    return np.sign(z) * np.maximum(np.abs(z) - loose, 0.0) / (1.0 - loose)


def _widths(narrowest: float) -> np.ndarray:
    """Half widths as shares of the travel, from about ``narrowest``."""
    least = float(np.clip(narrowest, *NARROWEST))
    return np.geomspace(least, WIDEST, 1 + int(np.ceil(np.log(WIDEST / least) / WIDTH_RATIO)))


EFFECT = Backlash()
