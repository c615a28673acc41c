"""A spring between motor and link."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.gap.effects.base import IMPOSSIBLE, Columns, Context, Effect, Shape, Value, free_name
from s2r_host.gap.effects.encoder_offset import load_bend, load_slope
from s2r_host.gap.motion.neutral import coincident_joint
from s2r_host.gap.motion.quantities import TRANSMITTED
from s2r_host.gap.motion.servo import servo_of
from s2r_host.gap.motion.session import Session
from s2r_host.gap.motion.states import filtered
from s2r_host.gap.motion.two_masses import Gear, Hung, before_spring, deflection, link_inertia, with_servo

SERVO = {"servo": 1.0}  # the motor is held by its declared law, inside the simulation
AT_LINK = {"at_link": 1.0}  # the encoder is behind the gear
# Log odds. Rare machines; without the law, what friction does around a rest passes for one by up to 25.
AT_LINK_ODDS, UNTOLD_ODDS = -2.0, -30.0
UNHEARD_HZ = 20.0  # of such a link at a held motor: stiffer, all that is seen of it are turns of the friction
FREQUENCIES_HZ = (1.5, 2.2, 3.2, 4.6, 6.5, 9.0, 12.5, 17.0, 24.0)
DAMPING = (0.02, 0.08, 0.25)
MOTOR_SHARES = (0.0, 0.15, 0.4)
MOST_MOTOR = 0.9  # of the inertia
STATED, FAR_MOTOR = 0.2, 8.0  # relative error of a motor inertia that a model states, log odds
PASSES = 2
TOUCHES = 0.1  # of a gap: as deep as flanks are pressed in where the link is taken to be on one of them
SOFT = 0.2  # change of gravity with the windup, at resonance, from which passes do not settle: integrated instead


class JointElasticity(Effect):
    """M d(dδ)/dt = T - L, T = -k δ - d dδ, effort = Jm ddq_motor + T; q is read at the motor, or at the link."""

    name = "joint_elasticity"
    model_error = {"stiffness": 0.12, "damping": 1.0}  # noqa: RUF012
    equation = "T = k (q_motor - q_link) + d (dq_motor - dq_link)"
    signature = "phase lag that grows with frequency, an antiresonance"
    separating_motion = "a chirp through the resonance; a static load at a held motor"
    confusable = ("actuator_delay", "backlash", "bandwidth")
    shows_over = TRANSMITTED

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Link frequency at a held motor, damping ratio, share of the inertia that is motor."""
        return [
            {"f": f, "zeta": z, "motor": m} | servo
            for servo in ({}, AT_LINK, SERVO, SERVO | AT_LINK)[: 4 if servo_known(ctx, joint) else 2]
            for m in motor_shares(ctx, joint)
            for f in FREQUENCIES_HZ
            for z in DAMPING
            if m > 0.0 or "at_link" not in servo
        ]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Frequency and damping on a log scale, motor share linear."""
        return {"f": ("log", 0.12), "zeta": ("log", 0.4), "motor": ("linear", 0.08)}

    def bounds(self, ctx: Context, joint: int) -> dict[str, tuple[float, float]]:
        """No spring so soft that only its damper is left, no motor lighter than nothing."""
        return {
            "f": (0.5 * FREQUENCIES_HZ[0], 2.0 * FREQUENCIES_HZ[-1]),
            "zeta": (0.003, 1.0),
            "motor": (0.0, MOST_MOTOR),
        }

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """A motor's inertia is known where the model states one; slow motions tell it from the spring in no way."""
        return motor_odds(ctx, joint, shape["motor"]) + encoder_odds(shape)

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Motor inertia plus transmitted effort, minus the rigid load."""
        between = gear(ctx, joint, shape)
        if "servo" in shape:
            return beside_servo(ctx, s, joint, between, at_link="at_link" in shape)
        if "at_link" in shape:
            return Columns([], fixed=before_spring(ctx.model, s, joint, hung(ctx, s, joint), between))
        motor, stiffness = between.motor, between.stiffness
        load = link_load(ctx, s, joint, motor)
        w = 2 * np.pi * shape["f"]
        # Held at the motor, T follows the link's rigid load through a second-order filter of unit gain.
        damping = 2 * shape["zeta"] * w
        slope, hangs = load_slope(ctx, s, joint)[:, joint], load
        if float(np.max(np.abs(slope))) > SOFT * stiffness * min(2.0 * shape["zeta"], 1.0):
            inertia = link_inertia(s, joint, motor)
            bend = load_bend(ctx, s, joint)
            with np.errstate(over="ignore", invalid="ignore"):
                T = deflection(s.dt, inertia, load, slope, bend, between)
            # A link that turned further than the joint travels has tipped over: the series in its windup ends there.
            low, high = ctx.span(joint)
            if np.all(np.abs(T) < stiffness * (high - low)):
                return felt(ctx, s, joint, between, T - load)
        for _ in range(PASSES):  # gravity pulls where the link is, not where the motor is
            windup = (filtered([w * w], [1.0, damping, w * w], hangs - hangs[0], s.dt) + hangs[0]) / stiffness
            hangs = load - slope * windup
        T = filtered([damping, w * w], [1.0, damping, w * w], hangs - hangs[0], s.dt) + hangs[0]
        return felt(ctx, s, joint, between, T - load)

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Stiffness, damping, motor inertia, at the mean inertia of the recordings."""
        name = ctx.model.joints[joint]
        unit, effort = ctx.model.unit(name), ctx.model.effort_unit(name)
        J = mean_inertia(ctx, joint)
        link = J * (1.0 - shape["motor"])
        w = 2 * np.pi * shape["f"]
        return {
            "stiffness": Value(
                link * w**2, f"{effort}/{unit}", shape_key="f", scale=2.0 * link * w * 2 * np.pi
            ),
            "damping": Value(
                2 * shape["zeta"] * w * link,
                ctx.model.damping_unit(name),
                shape_key="zeta",
                scale=2 * w * link,
            ),
            "motor_inertia": Value(
                J * shape["motor"], ctx.model.inertia_unit(name), shape_key="motor", scale=J
            ),
        }

    def patch(self, ctx: Context, spec: mujoco.MjSpec, joint: int, shape: Shape, theta: np.ndarray) -> bool:
        """A second, coincident joint with stiffness; the motor's inertia is armature of the first."""
        values = self.parameters(ctx, joint, shape, theta)
        flex = second_joint(ctx, spec, joint, values["motor_inertia"].value)
        flex.stiffness = [values["stiffness"].value, 0.0, 0.0]  # polynomials since MuJoCo 4
        flex.damping = [values["damping"].value, 0.0, 0.0]
        return True


def beside_servo(ctx: Context, s: Session, joint: int, between: Gear, *, at_link: bool = False) -> Columns:
    """What a gear adds with the motor under its declared law; nothing where that is not known or does not hold it.

    Where the encoder is ``at_link`` the other joints feel what they would feel of a rigid gear.
    """
    found = with_servo(ctx.model, s, joint, hung(ctx, s, joint), between, reads_link=at_link)
    missing = np.zeros(len(s.t)) if found is None else found
    return Columns([], fixed=missing) if at_link else felt(ctx, s, joint, between, missing)


def felt(ctx: Context, s: Session, joint: int, between: Gear, missing: np.ndarray) -> Columns:
    """What a link asks for that swings behind its motor, whose position was recorded.

    Args:
        ctx: Model and recordings.
        s: A recording.
        joint: The joint of motor and link.
        between: The gear between them.
        missing: Effort of the link that the recorded motion does not show, shape (time,). The other joints feel its
            acceleration through the inertia that they share with it, and its weight where it really is: all of that
            where the position is read at the motor, none where it is read at the link, which the data decide.
    """
    if len(ctx.model.joints) == 1:
        return Columns([], fixed=missing)
    shared, slope = shared_inertia(ctx, s, joint), load_slope(ctx, s, joint)
    passed = link_load(ctx, s, joint, between.motor) + missing
    behind = -passed / between.stiffness
    if between.gap > 0.0:
        behind -= between.gap * np.clip(passed / (TOUCHES * between.gap * between.stiffness), -1.0, 1.0)
    swings = (missing - slope[:, joint] * behind) / link_inertia(s, joint, between.motor)
    others = swings[:, None] * shared + behind[:, None] * slope
    others[:, joint] = 0.0
    return Columns([others], (True,), fixed=missing)


def link_load(ctx: Context, s: Session, joint: int, motor: float) -> np.ndarray:
    """What the link alone asks of a rigid gear, bearings and the motor's inertia taken off, shape (time,)."""
    bearings = float(ctx.model.model.dof_damping[joint]) * s.v[:, joint]
    return s.load[:, joint] - bearings - np.minimum(motor, 0.95 * s.mass[:, joint]) * s.a[:, joint]


def shared_inertia(ctx: Context, s: Session, joint: int) -> np.ndarray:
    """Column of the inertia matrix along a recorded motion, shape (time, joint)."""
    key = ("shared inertia", joint)
    if key not in s.cache:
        a = s.a.copy()
        a[:, joint] += 1.0
        s.cache[key] = ctx.model.inverse(s.q, s.v, a) - s.load
    return s.cache[key]


def servo_known(ctx: Context, joint: int) -> bool:
    """Is the law that moved the joint known, in every recording with an effort of its drive?"""
    return all(servo_of(ctx.model, s, joint) is not None for s in ctx.sessions if s.has_drive[joint])


def motor_shares(ctx: Context, joint: int) -> list[float]:
    """Share of the joint's inertia that turns with the motor: the model's armature when it has one."""
    armature = float(ctx.model.model.dof_armature[joint])
    if armature > 0:
        return [armature / mean_inertia(ctx, joint)]
    return list(MOTOR_SHARES)


def motor_odds(ctx: Context, joint: int, share: float) -> float:
    """Log odds of a motor's share of the inertia: about as the model states it, where it does."""
    armature = float(ctx.model.model.dof_armature[joint])
    if armature == 0.0:
        return 0.0
    off = share * mean_inertia(ctx, joint) / armature - 1.0
    return -min(FAR_MOTOR, 0.5 * (off / STATED) ** 2)


def encoder_odds(shape: Shape) -> float:
    """Log odds of where the encoder of a gear sits: at its motor, mostly."""
    if "at_link" not in shape:
        return 0.0
    if "w" not in shape and shape["f"] > UNHEARD_HZ:
        return IMPOSSIBLE
    return AT_LINK_ODDS if "servo" in shape else UNTOLD_ODDS


def mean_inertia(ctx: Context, joint: int) -> float:
    """Mean of the inertia's diagonal over the recordings."""
    return float(np.mean(np.concatenate([s.mass[:, joint] for s in ctx.sessions])))


def hung(ctx: Context, s: Session, joint: int) -> Hung:
    """What hangs on the motor of a joint, as the nominal model has it."""
    m = ctx.model.model
    bearings = float(m.dof_damping[joint])
    return Hung(
        s.load[:, joint] - bearings * s.v[:, joint], np.ascontiguousarray(load_slope(ctx, s, joint)[:, joint]),
        load_bend(ctx, s, joint), bearings, float(m.dof_frictionloss[joint]),
    )  # fmt: skip


def gear(ctx: Context, joint: int, shape: Shape, gap: float = 0.0) -> Gear:
    """The gear of a shape: link frequency at a held motor, damping ratio, share of the inertia that is motor."""
    J = mean_inertia(ctx, joint)
    motor = float(np.clip(shape["motor"], 0.0, MOST_MOTOR)) * J
    link, w = max(J - motor, 1e-12), 2 * np.pi * shape["f"]
    return Gear(motor, link * w * w, 2 * shape["zeta"] * w * link, gap)


def second_joint(ctx: Context, spec: mujoco.MjSpec, joint: int, motor_inertia: float) -> mujoco.MjsJoint:
    """Add a coincident joint behind ``joint``; returns it. Motor-side quantities stay on the first one."""
    name = ctx.model.joints[joint]
    first = spec.joint(name)
    flex = coincident_joint(first, free_name(f"{name}_gap_flex", spec.joints))
    known = float(ctx.model.model.dof_armature[joint])
    if known == 0.0:
        first.armature = max(motor_inertia, 0.01 * mean_inertia(ctx, joint))
    return flex


EFFECT = JointElasticity()
