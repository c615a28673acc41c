"""A motor and the link it drives through a spring or through play, along a recorded motion.

The motor moves as recorded, or its servo holds it in the simulation; or the link does, whose encoder is then behind
the gear. Where a link bounces between stiff flanks the
servo is what calms it: the motor gives way and takes the energy up, by less than the noise of an encoder. Behind the
recorded motion of a motor, which is no longer one that gives way, the same link bounces on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from s2r_host._native import behind_recorded_motor, hanging_link, under_servo
from s2r_host.gap.motion.known_noise import clear_up_to
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.servo import Servo, servo_of, ticks_of
from s2r_host.gap.motion.session import Session, lowpass
from s2r_host.gap.motion.states import filtered

PHASE = 0.1  # of the fastest motion, per step
LIGHTEST_MOTOR = 0.02  # of the inertia
# 1/s: effects beside the gear keep the motor from where the model has it, and change slowly.
FOLLOW = 2.0 * np.pi
CALM = 0.2  # of the rate at which following makes the loop swing: damping over inertia (Routh)
SHARP = 6  # order of a filter that leaves what it keeps as it is
TINY = 1e-9  # 1/s, 1/s²: where a linear motion changes its form


@dataclass(frozen=True)
class Gear:
    """What is between motor and link, in SI.

    Attributes:
        motor: Inertia on the motor's side.
        gap: Half width of the play; zero is a spring.
    """

    motor: float
    stiffness: float
    damping: float
    gap: float = 0.0


@dataclass(frozen=True)
class Hung:
    """What hangs on the motor of one joint.

    Attributes:
        load: Of the whole joint without what its bearings take, shape (time,) [N·m or N].
        slope: Change of that load with the position; ``bend`` the change of the slope.
        bearings: Viscous friction of the joint, which sits on the motor's side.
        friction: Dry friction there.
    """

    load: np.ndarray
    slope: np.ndarray
    bend: np.ndarray
    bearings: float
    friction: float


def link_inertia(s: Session, joint: int, motor: float) -> np.ndarray:
    """What is left of a joint's inertia on the link's side, never nothing, shape (time,)."""
    M = s.mass[:, joint]
    return np.maximum(M - motor, 0.05 * M)


def behind_motor(s: Session, joint: int, hung: Hung, gear: Gear) -> np.ndarray:
    """Transmitted effort beyond that of a rigid gear, the motor moving as recorded, shape (time,)."""
    load = hung.load - gear.motor * s.a[:, joint]
    return deflection(s.dt, link_inertia(s, joint, gear.motor), load, hung.slope, hung.bend, gear) - load


def before_spring(model: RigidModel, s: Session, joint: int, hung: Hung, gear: Gear) -> np.ndarray:
    """What a motor takes beyond a rigid gear where the link moves as recorded behind a spring, shape (time,).

    The spring is wound up by what the link is known to ask for, T = k δ + d δ̇; motor, bearings and dry friction move
    with the link and the windup. Only as fast as that link's acceleration is heard: beyond it T is the noise which the
    residual effort holds as well, and its second derivative would take that noise away.
    """
    rigid = hung.load - gear.motor * s.a[:, joint]
    passed = lowpass(rigid, clear_up_to(model, s, joint), s.dt, SHARP)
    windup = (
        filtered([1.0], [gear.damping, gear.stiffness], passed - passed[0], s.dt) + passed[0] / gear.stiffness
    )
    rate = np.gradient(windup, s.dt)
    turned = _friction(s, joint, hung, s.slip(joint) + rate) - _friction(s, joint, hung, s.slip(joint))
    return gear.motor * np.gradient(rate, s.dt) + turned


def with_servo(
    model: RigidModel, s: Session, joint: int, hung: Hung, gear: Gear, *, reads_link: bool = False
) -> np.ndarray | None:
    """The same, seen as the recording is, with the motor under its declared law; None where that is not known.

    The law is told the recorded commands. What else acts on the motor is found from the distance to where the encoder
    was, by an integral that is slow beside the gear. Where the encoder ``reads_link`` friction moves otherwise than
    what was recorded.
    """
    if not s.has_drive[joint]:
        return None
    key = ("servo", joint)  # asked for at every step of a search
    if key not in s.cache:
        s.cache[key] = servo_of(model, s, joint, ticks_of(s))
    servo: Servo | None = s.cache[key]
    if servo is None:
        return None
    M, q, a = s.mass[:, joint], s.q[:, joint], s.a[:, joint]
    motor = max(gear.motor, LIGHTEST_MOTOR * float(np.mean(M)))
    weight = hung.load - M * a - s.pushed[:, joint]
    low, high = model.effort_limits()
    at, effort, speed = under_servo(
        dt=s.dt, inertia=link_inertia(s, joint, motor), load=weight, slope=hung.slope, bend=hung.bend,
        stiffness=gear.stiffness, damping=gear.damping, gap=gear.gap, q=np.ascontiguousarray(q),
        speed=float(s.v[0, joint]), motor_inertia=motor, motor_damping=hung.bearings, friction=hung.friction,
        kp=servo.kp, kd=servo.kd, ki=servo.ki, low=float(low[joint]), high=float(high[joint]), ticks=servo.ticks,
        q_cmd=servo.q_cmd, dq_cmd=servo.dq_cmd, ahead=servo.ahead, integral=servo.integral(s, joint, 0),
        follow=min(FOLLOW, CALM * servo.kd / float(np.mean(M))), reads_link=reads_link, phase=PHASE,
    )  # fmt: skip
    if not np.all(np.isfinite(at)):
        return None
    seen = lowpass(at, float(s.motion_cut[joint]), s.dt)  # as the position of the recording
    behind = seen - q
    motion = CubicSpline(s.t, seen)
    rigid = M * motion(s.t, 2) + weight + (hung.slope + 0.5 * hung.bend * behind) * behind
    if not reads_link:
        return effort - rigid
    moves = lowpass(speed, float(s.motion_cut[joint]), s.dt)
    turned = _friction(s, joint, hung, moves) - _friction(s, joint, hung, motion(s.t, 1))
    return effort - rigid + turned


def _friction(s: Session, joint: int, hung: Hung, v: np.ndarray) -> np.ndarray:
    """Friction of the motor's side at speeds ``v`` as the recording is compared with it, shape (time,)."""
    return hung.bearings * v + hung.friction * np.tanh(v / s.v_eps[joint])


def deflection(
    dt: float, inertia: np.ndarray, load: np.ndarray, slope: np.ndarray, bend: np.ndarray, gear: Gear
) -> np.ndarray:
    """Transmitted effort of a link that hangs on a motor whose motion was recorded.

    Link minus motor angle δ obeys M δ̈ = T - L with T = -k dz(δ) - d δ̇ in contact; dz is the dead zone of the gap, whose
    flanks do not pull. L is the load the link would put on a rigid transmission, plus its change with δ: gravity pulls
    where the link is.

    Args:
        dt: Time between rows [s].
        inertia: Of the link, shape (time,).
        load: Rigid load of the link, shape (time,).
        slope: Change of that load with the link's position, shape (time,); ``bend`` the change of that.
        gear: Stiffness, damping, gap.

    Returns:
        T, shape (time,).
    """
    if gear.gap == 0.0:
        return _hanging_link(dt, inertia, load, slope, bend, gear.stiffness, gear.damping)
    return behind_recorded_motor(
        dt=dt, inertia=inertia, load=load, slope=slope, bend=bend, stiffness=gear.stiffness, damping=gear.damping,
        gap=gear.gap, phase=PHASE,
    )  # fmt: skip


def _hanging_link(
    dt: float, inertia: np.ndarray, load: np.ndarray, slope: np.ndarray, bend: np.ndarray, k: float, d: float
) -> np.ndarray:
    """The same without a gap: each row in one step, however stiff and damped the spring is, shape (time,).

    Between two rows the equation is linear, M δ̈ + d δ̇ + (k + slope) δ = -L, up to the small ``bend``, which is taken at
    the middle of the step: its exact solution needs no steps shorter than a row (exponential integrator; Hochbruck and
    Ostermann, Acta Numerica 19, 2010).
    """
    half, stiffness = 0.5 * d / inertia, (k + slope) / inertia
    stiffness = np.where(np.abs(stiffness) < TINY, TINY, stiffness)
    root = np.sqrt(half**2 - stiffness + 0j)
    root = np.where(np.abs(root) < TINY, TINY, root)
    slow, fast = np.exp((root - half) * dt), np.exp((-root - half) * dt)
    even, odd = (0.5 * (slow + fast)).real, (0.5 * (slow - fast) / root).real
    stays = even + half * odd
    steps = (
        stays,
        odd,
        -stiffness * odd,
        even - half * odd,
        (1.0 - stays) / stiffness / inertia,
        odd / inertia,
    )
    return hanging_link(dt=dt, steps=np.stack(steps), load=load, bend=bend, stiffness=k, damping=d)
