"""Drawing the cases: which machine, which hidden effects, which mask, which decoy; strengths come later."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from s2r_conceal.effects.table import EFFECTS, KNOWN, UNKNOWN
from s2r_conceal.errors import DrawError
from s2r_conceal.masks import KINDS, Mask, draw_mask, for_arm
from s2r_conceal.motions import DURATION_S, derivatives, poor, rich
from s2r_conceal.parameters import Controller, Heating, Machine, Motion, Scale, Sensing
from s2r_conceal.plant import Active
from s2r_conceal.rigs import Rig, rig_named

ROLES = ("fit", "repeat", "holdout")
STRENGTHS = (1.5, 3.0, 10.0)
GROUPS = ("single", "clean", "unknown", "pairs", "triples", "masked", "insufficient", "wrong_log")
CLEAN_VARIANTS = ("plain", "parameter_off", "in_model")
INSUFFICIENT_VARIANTS = ("still", "one_way", "crawl")
MASKED_VARIANTS = ("high_gain", "no_effort")
WRONG_LOGS = ("other_robot", "degrees", "swapped_joints")
IN_MODEL = ("armature", "payload", "gravity_tilt", "spring_return", "saturation", "coulomb_friction")
BARE_SHARE, BARE_ARMATURE = 0.4, 0.2
PARAMETERS = ("mass", "com", "inertia", "armature", "viscous", "coulomb", "controller_gain")


Plan = tuple[str, tuple[str, ...], float]  # variant, effect names, strength


@dataclass(eq=False)
class Case:
    """One case before and while its strengths are set.

    Attributes:
        seed: What its noise and row choice derive from.
        machine: The true machine without effects; ``told`` the one in the model file.
        effects: Hidden effects, sizes still open until calibration.
        in_model: Effects that are in the machine and in the model file alike.
        targets: Wanted strength per effect, in repeatability floors.
        expected: Verdicts (or ``refused``) that are right.
    """

    seed: tuple[int, ...]
    rig: Rig
    group: str
    variant: str
    machine: Machine
    told: Machine
    controller: Controller
    told_controller: Controller
    motions: dict[str, Motion]
    sensing: Sensing
    heating: Heating
    scales: list[Scale]
    mask: Mask
    sessions: dict[str, str]
    effects: list[Active] = field(default_factory=list)
    in_model: list[Active] = field(default_factory=list)
    targets: list[float] = field(default_factory=list)
    parameters_off: list[dict[str, float | str]] = field(default_factory=list)
    expected: tuple[str, ...] = ()
    plan: Plan = ("", (), 0.0)

    def effects_for(self, role: str) -> tuple[Active, ...]:
        """Effects at work in the recording of that role."""
        return tuple(_for_role(active, role) for active in [*self.effects, *self.in_model])


def _for_role(active: Active, role: str) -> Active:
    change = EFFECTS[active.name].for_role
    return active if change is None else replace(active, values=change(active.values, role))


def possible(rig: Rig) -> tuple[str, ...]:
    """Catalogue names that this rig can show."""
    return tuple(n for n in KNOWN if EFFECTS[n].min_joints <= rig.joints)


def draw_cases(
    seed: int, rig_name: str, counts: dict[str, int], duration_s: float = DURATION_S
) -> list[Case]:
    """All cases of a set in shuffled order.

    Args:
        seed: Any integer; the same seed gives the same cases.
        rig_name: See ``rigs``.
        counts: Group → number of cases.
        duration_s: Length of every recording [s].

    Raises:
        DrawError: Unknown group or rig, or a negative number.
    """
    rig = rig_named(rig_name)
    for group, count in counts.items():
        if group not in GROUPS or count < 0:
            raise DrawError(f"cases '{group}={count}': the groups are {', '.join(GROUPS)}, numbers from 0")
    rng = np.random.default_rng([seed, 11])
    plans = [(group, plan) for group in GROUPS for plan in _plans(rng, rig, group, counts.get(group, 0))]
    order = rng.permutation(len(plans))
    seeds = [(seed, 23, int(k)) for k in order]
    return [_draw(rig, s, plans[s[2]][0], plans[s[2]][1], duration_s) for s in seeds]


def redraw(case: Case, attempt: int) -> Case:
    """Another machine, motion and shape for the same plan: the first could not carry the wanted strength."""
    return _draw(case.rig, (*case.seed[:3], attempt), case.group, case.plan, case.scales[0].duration_s)


def _plans(rng: np.random.Generator, rig: Rig, group: str, count: int) -> Iterator[Plan]:
    """(variant, effect names, strength) of each case of a group, evenly spread."""
    names = possible(rig)
    match group:
        case "single" | "masked":
            combos = list(itertools.product(names, STRENGTHS if group == "single" else (3.0, 10.0)))
            picks = _cycle(rng, combos, count)
            variants = ("",) if group == "single" else MASKED_VARIANTS
            yield from ((variants[k % len(variants)], (name,), s) for k, (name, s) in enumerate(picks))
        case "unknown":
            combos = list(itertools.product(UNKNOWN, (3.0, 10.0)))
            yield from (("", (name,), s) for name, s in _cycle(rng, combos, count))
        case "pairs" | "triples":
            size = 2 if group == "pairs" else 3
            yield from (
                ("", _together(rng, names, size), float(rng.choice([4.0, 10.0]))) for _ in range(count)
            )
        case "clean":
            yield from ((CLEAN_VARIANTS[k % 3], _decoy(rng, k), 6.0) for k in range(count))
        case "insufficient":
            yield from ((INSUFFICIENT_VARIANTS[k % 3], (str(rng.choice(names)),), 0.7) for k in range(count))
        case _:
            # Another arm of the same make differs by its masses only, which is no wrong log.
            kinds = {1: WRONG_LOGS[:2], 2: WRONG_LOGS}.get(rig.joints, WRONG_LOGS[1:])
            yield from ((kinds[k % len(kinds)], (), 0.0) for k in range(count))


def _cycle(rng: np.random.Generator, items: list, count: int) -> list:
    """``count`` items, every one used before any is used again."""
    picked: list = []
    while len(picked) < count:
        picked += [items[i] for i in rng.permutation(len(items))]
    return picked[:count]


def _decoy(rng: np.random.Generator, k: int) -> tuple[str, ...]:
    return (str(rng.choice(IN_MODEL)),) if CLEAN_VARIANTS[k % 3] == "in_model" else ()


def _together(rng: np.random.Generator, names: tuple[str, ...], size: int) -> tuple[str, ...]:
    """Names that are not declared to look alike, and at most one compliant transmission."""
    transmissions = {"backlash", "joint_elasticity"}
    while True:
        picked = tuple(str(n) for n in rng.choice(names, size, replace=False))
        alike = any(b in EFFECTS[a].same_as for a in picked for b in picked)
        if not alike and len(transmissions & set(picked)) < 2:
            return picked


# -- one case ------------------------------------------------------------------------------------------


def _draw(rig: Rig, seed: tuple[int, ...], group: str, plan: Plan, duration_s: float) -> Case:
    variant, names, strength = plan
    rng = np.random.default_rng(seed)
    mask = _mask_for(rng, group, variant, names)
    if rig.joints > 1:
        mask = for_arm(np.random.default_rng((*seed, 7)), mask)
    if variant == "parameter_off" or group == "wrong_log":
        mask = replace(mask, no_law=False)
    machine = _friction_or_none(rng, rig.draw(rng), names)
    controller = _controller(rng, rig, machine, mask)
    told = misjudged(rng, machine, mask.nominal_error if group != "clean" else 1e-3)
    paths = _paths(rng, rig, group, variant, duration_s)
    feed_forward = float(
        rng.choice([0.0, 0.0, 1.0] if rig.joints == 1 else [1.0, 1.0, 1.0])
    )  # arms do not sag
    motions = {role: _motion(rig, told, q, feed_forward) for role, q in paths.items()}
    scales = _scales(rig, machine, controller, paths["fit"], duration_s)
    case = Case(
        seed=seed,
        rig=rig,
        group=group,
        variant=variant,
        machine=machine,
        told=told,
        controller=controller,
        told_controller=controller,
        motions=motions,
        sensing=_sensing(rng, scales, mask),
        heating=_heating(rng, scales),
        scales=scales,
        mask=mask,
        sessions=_sessions(rng, names),
        expected=_expected(group, variant),
        plan=plan,
    )
    joints = [_place(rng, rig, name) for name in names]
    actives = [_open_effect(rng, name, j, scales[j]) for name, j in zip(names, joints, strict=True)]
    if group == "clean" and variant == "in_model":
        case.in_model = [_for_model(active) for active in actives]
    else:
        case.effects = actives
    case.targets = [strength] * len(actives)
    if group == "clean" and variant == "parameter_off":
        _set_parameter_off(rng, case)
    if variant == "other_robot":
        case.told = misjudged(rng, rig.draw(rng), 0.01)
    return case


def _place(rng: np.random.Generator, rig: Rig, name: str) -> int:
    """The joint an effect sits on: a load hangs on the last one, the base carries the first one."""
    drawn = int(
        rng.integers(1 if name == "motor_coupling" else 0, rig.joints)
    )  # a joint and the one before it
    return {"payload": rig.joints - 1, "gravity_tilt": 0}.get(name, drawn)


def _mask_for(rng: np.random.Generator, group: str, variant: str, names: tuple[str, ...]) -> Mask:
    if group == "masked":
        mask = draw_mask(rng, ("high_gain",))
        return replace(mask, no_effort=variant == "no_effort")
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


def _friction_or_none(rng: np.random.Generator, machine: Machine, names: tuple[str, ...]) -> Machine:
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


def _controller(rng: np.random.Generator, rig: Rig, machine: Machine, mask: Mask) -> Controller:
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


def _paths(
    rng: np.random.Generator, rig: Rig, group: str, variant: str, duration_s: float
) -> dict[str, np.ndarray]:
    centre, half = rig.stroke(rng)

    def path() -> np.ndarray:
        if group == "insufficient":
            return np.stack([poor(rng, variant, duration_s) for _ in range(rig.joints)], axis=1)
        return np.stack([rich(rng, duration_s) for _ in range(rig.joints)], axis=1)

    fit = centre + half * path()
    return {"fit": fit, "repeat": fit, "holdout": centre + half * path()}


def _motion(rig: Rig, told: Machine, q_cmd: np.ndarray, feed_forward: float) -> Motion:
    dq_cmd, ddq_cmd = derivatives(q_cmd)
    tau_ff = feed_forward * rig.inverse_dynamics(told, q_cmd, dq_cmd, ddq_cmd)
    return Motion(q_cmd=q_cmd, dq_cmd=dq_cmd, tau_ff=tau_ff)


def _scales(
    rig: Rig, machine: Machine, controller: Controller, q: np.ndarray, duration_s: float
) -> list[Scale]:
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


def _sensing(rng: np.random.Generator, scales: list[Scale], mask: Mask) -> Sensing:
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


def _heating(rng: np.random.Generator, scales: list[Scale]) -> Heating:
    return Heating(
        rise_K=rng.uniform(15.0, 45.0, len(scales)),
        u_typical=np.array([c.torque for c in scales]),
        time_s=rng.uniform(6.0, 25.0),
    )


def _sessions(rng: np.random.Generator, names: tuple[str, ...]) -> dict[str, str]:
    """Half of the held-out recordings come from another session; all of them where the session matters."""
    other = "session_friction" in names or rng.random() < 0.5
    return {"fit": "A", "repeat": "A", "holdout": "B" if other else "A"}


def _expected(group: str, variant: str) -> tuple[str, ...]:
    match group, variant:
        case "clean", "parameter_off":
            return ("parameter_off",)
        case "clean", _:
            return ("nothing_missing",)
        case "unknown", _:
            return ("unknown",)
        case "insufficient", _:
            return ("insufficient",)
        case "masked", "no_effort":
            return ("insufficient",)
        case "wrong_log", _:
            return ("refused", "unknown")
        case _:
            return ("physics_missing",)


def _open_effect(rng: np.random.Generator, name: str, joint: int, scale: Scale) -> Active:
    """An effect with its shape drawn and its size in the middle of what is plausible."""
    effect = EFFECTS[name]
    shape = effect.draw(rng, scale)
    low, high = effect.sizes(scale, shape)
    middle = float(np.sqrt(low * high)) if low > 0.0 else 0.5 * (low + high)
    return Active(name, joint, shape | {effect.size: middle})


def _for_model(active: Active) -> Active:
    """What the model file can say exactly: no speed slope of a clip."""
    if active.name == "saturation":
        return replace(active, values=active.values | {"no_load_speed": 1e9})
    return active


def _set_parameter_off(rng: np.random.Generator, case: Case) -> None:
    """One wrong value in the model file or in the stated controller; its size is set by calibration."""
    usable = [
        p
        for p in PARAMETERS
        if p not in ("viscous", "coulomb", "armature") or getattr(case.machine, p)[0] > 0.0
    ]
    case.parameters_off = [
        {
            "name": str(rng.choice(usable)),
            "joint": int(rng.integers(case.rig.joints)),
            "relative": float(rng.choice([-1.0, 1.0])) * 0.1,
        }
    ]
    case.targets = [float(rng.choice([4.0, 10.0]))]


def with_parameters_off(case: Case) -> tuple[Machine, Controller]:
    """The stated machine and controller after ``parameters_off`` of the case."""
    told, controller = case.told, case.controller
    for entry in case.parameters_off:
        name, j, factor = str(entry["name"]), int(entry["joint"]), 1.0 + float(entry["relative"])
        if name == "controller_gain":
            kp = controller.kp.copy()
            kp[j] *= factor
            controller = replace(controller, kp=kp)
        else:
            value = getattr(told, name).copy()
            value[j] = value[j] * factor
            told = replace(told, **{name: value})
    return told, controller
