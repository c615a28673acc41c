"""The setting of one case: machine as it is and as the model has it, loop, motion, mask, sensors, heat, sessions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_conceal.effects.table import EFFECTS
from s2r_conceal.masks import KINDS, Mask, draw_mask
from s2r_conceal.motions import derivatives, poor, rich
from s2r_conceal.parameters import Controller, Heating, Machine, Motion, Scale, Sensing
from s2r_conceal.rigs import Rig

BARE_SHARE, BARE_ARMATURE = 0.4, 0.2
CLEAN_WITHOUT_EFFORT = (
    0.15  # of the clean cases without a wrong value: a tenth of all, about as many as hide something
)


def mask_for(rng: np.random.Generator, group: str, variant: str, names: tuple[str, ...]) -> Mask:
    """What distorts the recordings of a case, drawn so that it fits its group."""
    without = variant == "no_effort"
    if group == "clean" and variant != "parameter_off":
        without = rng.random() < CLEAN_WITHOUT_EFFORT
    if group == "masked" or without:  # clean ones without effort are recorded as those that hide something
        return replace(draw_mask(rng, ("high_gain",)), no_effort=without)
    if group == "wrong_log":
        return draw_mask(rng, ())
    kinds = tuple(str(k) for k in rng.choice(KINDS, int(rng.integers(0, 3)), replace=False))
    kinds = kinds if rng.random() < 0.6 else ()
    if "high_gain" in kinds:  # a stiff loop cannot live on a coarse encoder
        kinds = tuple(k for k in kinds if k != "coarse_encoder")
    if group == "clean":
        kinds = tuple(k for k in kinds if k != "nominals")
    if group == "insufficient":
        kinds = ()
    mask = draw_mask(rng, kinds)
    return replace(mask, with_temperature=True) if "thermal_drift" in names else mask


def friction_or_none(rng: np.random.Generator, machine: Machine, names: tuple[str, ...]) -> Machine:
    """A quarter of the machines lack Coulomb or viscous friction altogether, so that its absence tells nothing.

    A good part of the arms are as descriptions come: no friction on any joint and hardly any motor inertia.
    """
    needs = {need for name in names for need in EFFECTS[name].needs}
    if len(machine.mass) > 2 and not needs and rng.random() < BARE_SHARE:
        nothing = np.zeros_like(machine.coulomb)
        light = (
            BARE_ARMATURE * machine.armature
        )  # none at all: loops ring where two axes of the arm fall together
        return replace(machine, coulomb=nothing, viscous=nothing, armature=light)
    coulomb, viscous = machine.coulomb, machine.viscous
    if "coulomb_friction" in names or (rng.random() < 0.25 and "coulomb" not in needs):
        coulomb = np.zeros_like(coulomb)
    if "viscous_friction" in names or (rng.random() < 0.25 and "viscous" not in needs):
        viscous = np.zeros_like(viscous)
    return replace(machine, coulomb=coulomb, viscous=viscous)


def misjudged(rng: np.random.Generator, machine: Machine, error: float) -> Machine:
    """The machine as a model file has it: every value off by up to ``error``, friction by four times that."""

    def off(shape: tuple[int, ...], factor: float = 1.0) -> np.ndarray:
        return 1.0 + factor * error * rng.uniform(-1.0, 1.0, shape)

    n = len(machine.mass)
    return replace(
        machine,
        mass=machine.mass * off((n,)),
        com=machine.com * off((n, 1)),
        inertia=machine.inertia * off((n, 1, 1)),
        armature=machine.armature * off((n,)),
        viscous=machine.viscous * off((n,), 4.0),
        coulomb=machine.coulomb * off((n,), 4.0),
    )


def draw_controller(rng: np.random.Generator, rig: Rig, machine: Machine, mask: Mask) -> Controller:
    """Gains for a bandwidth of 2 to 6 Hz, or of a stiff loop with integral action."""
    q, _ = rig.stroke(np.random.default_rng(0))
    inertia = np.diag(rig.dynamics([machine]).mass_matrix(q[None])[0]) + machine.armature
    bandwidth = 2 * np.pi * (rng.uniform(22.0, 32.0) if mask.high_gain else rng.uniform(2.0, 6.0))
    kp = inertia * bandwidth**2
    kd = 2.0 * rng.uniform(0.7, 1.1) * inertia * bandwidth
    ki = kp * rng.uniform(4.0, 12.0) if mask.high_gain else np.zeros_like(kp)
    return Controller(kp=_tidy(kp), kd=_tidy(kd), ki=_tidy(ki))


def _tidy(values: np.ndarray) -> np.ndarray:
    """Three digits, as gains are set by people."""
    return np.array([float(f"{v:.3g}") for v in values])


def draw_paths(
    rng: np.random.Generator, rig: Rig, group: str, variant: str, duration_s: float
) -> dict[str, np.ndarray]:
    """Commanded positions of each recording, shape (ticks, joints); the repeat is the fit's path again."""
    centre, half = rig.stroke(rng)

    def path() -> np.ndarray:
        if group == "insufficient":
            return np.stack([poor(rng, variant, duration_s) for _ in range(rig.joints)], axis=1)
        return np.stack([rich(rng, duration_s) for _ in range(rig.joints)], axis=1)

    fit = centre + half * path()
    return {"fit": fit, "repeat": fit, "holdout": centre + half * path()}


def motion_along(rig: Rig, told: Machine, q_cmd: np.ndarray, feed_forward: float) -> Motion:
    """What the controller is told along a path, with a share of the stated model's effort fed forward."""
    dq_cmd, ddq_cmd = derivatives(q_cmd)
    tau_ff = feed_forward * rig.inverse_dynamics(told, q_cmd, dq_cmd, ddq_cmd)
    return Motion(q_cmd=q_cmd, dq_cmd=dq_cmd, tau_ff=tau_ff)


def scales_of(
    rig: Rig, machine: Machine, controller: Controller, q: np.ndarray, duration_s: float
) -> list[Scale]:
    """How large things are on each joint along a path."""
    q, dq, ddq = q[::10], *(d[::10] for d in derivatives(q))
    torque = rig.inverse_dynamics(machine, q, dq, ddq)
    still = np.zeros_like(q)
    gravity = np.abs(rig.inverse_dynamics(machine, q, still, still)).max(axis=0)
    mid = rig.dynamics([machine]).mass_matrix(q[:1])[0]
    inertia = np.diag(mid) + machine.armature
    rms = np.sqrt((torque**2).mean(axis=0))
    floor_torque = 0.2 * rms.max()  # joints about a vertical axis carry no gravity
    return [
        Scale(
            torque=float(max(rms[j], floor_torque)),
            gravity=float(max(gravity[j], 0.2 * gravity.max())),
            inertia=float(inertia[j]),
            armature=float(machine.armature[j]),
            coulomb=float(machine.coulomb[j]),
            viscous=float(machine.viscous[j]),
            speed=float(max(np.sqrt((dq[:, j] ** 2).mean()), 0.3)),
            speed_max=float(max(np.abs(dq[:, j]).max(), 1.0)),
            torque_max=float(np.abs(torque[:, j]).max()),
            q_lo=float(q[:, j].min()),
            q_hi=float(q[:, j].max()),
            bandwidth=float(np.sqrt(controller.kp[j] / inertia[j])),
            duration_s=duration_s,
        )
        for j in range(rig.joints)
    ]


def draw_sensing(rng: np.random.Generator, scales: list[Scale], mask: Mask) -> Sensing:
    """Encoders, speeds, efforts and disturbances in proportion to each joint."""
    torque = np.array([c.torque for c in scales])
    stiff = 0.05 if mask.high_gain else 1.0  # a stiff loop needs, and has, a finer encoder
    fine = rng.uniform(2e-5, 2e-4) * stiff
    lsb = np.full(len(scales), fine * (rng.uniform(10.0, 30.0) if mask.coarse_encoder else 1.0))
    return Sensing(
        lsb=lsb,
        q_noise=0.3 * lsb,
        dq_noise=np.full(len(scales), rng.uniform(5e-4, 3e-3) * stiff),
        tau_noise=torque * rng.uniform(2e-3, 8e-3),
        process=torque * rng.uniform(2e-3, 1e-2),
        process_s=rng.uniform(0.03, 0.2),
    )


def draw_heating(rng: np.random.Generator, scales: list[Scale]) -> Heating:
    """How fast and how far the motors warm up."""
    return Heating(
        rise_K=rng.uniform(15.0, 45.0, len(scales)),
        u_typical=np.array([c.torque for c in scales]),
        time_s=rng.uniform(6.0, 25.0),
    )


def draw_sessions(rng: np.random.Generator, names: tuple[str, ...]) -> dict[str, str]:
    """Half of the held-out recordings come from another session; all of them where the session matters."""
    other = "session_friction" in names or rng.random() < 0.5
    return {"fit": "A", "repeat": "A", "holdout": "B" if other else "A"}
