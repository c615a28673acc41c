"""Drawing the cases: which machine, which hidden effects, which mask, which decoy; strengths come later."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from s2r_conceal.effects.table import EFFECTS, altered_machine
from s2r_conceal.errors import DrawError
from s2r_conceal.masks import Mask, for_arm
from s2r_conceal.model_side import built_in, wrong_values
from s2r_conceal.motions import DURATION_S
from s2r_conceal.parameters import Controller, Heating, Machine, Motion, Scale, Sensing
from s2r_conceal.plans import GROUPS, Plan, expected_verdicts, plans_of
from s2r_conceal.plant import Active, Column
from s2r_conceal.rigs import Rig, rig_named
from s2r_conceal.setting import (
    draw_controller,
    draw_heating,
    draw_paths,
    draw_sensing,
    draw_sessions,
    friction_or_none,
    mask_for,
    misjudged,
    motion_along,
    scales_of,
)
from s2r_conceal.shapes import open_effect
from s2r_conceal.streams import Purpose, stream

ROLES = ("fit", "repeat", "holdout")


@dataclass(eq=False)
class Case:
    """One case before and while its strengths are set.

    Attributes:
        seed: Seed of the set, number of the case and attempt: what all its streams derive from.
        machine: The true machine without effects; ``told`` the one in the model file.
        effects: Hidden effects, sizes still open until calibration.
        in_model: Effects that are in the machine and in the model file alike.
        targets: Wanted strength per hidden effect, in repeatability floors.
        parameters_off: Wrong values of the model file or of the stated controller.
        expected: Verdicts (or ``refused``) that are right.
        feed_forward: Share of the stated model's effort that the controller adds.
    """

    seed: tuple[int, int, int]
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
    feed_forward: float = 0.0

    @property
    def effort(self) -> str:
        """Which of a trace's efforts is recorded."""
        return "tau_measured" if self.mask.measured_effort else "tau_commanded"

    def run(self, role: str, effects: Iterable[Active], noise: tuple[int, ...] | None = None) -> Column:
        """The recording of that role with these effects at work, to be simulated; without noise for None."""
        return Column(
            machine=self.machine,
            controller=self.controller,
            motion=self.motions[role],
            sensing=self.sensing,
            heating=self.heating,
            effects=tuple(_for_role(active, role) for active in effects),
            noise=noise,
        )


def _for_role(active: Active, role: str) -> Active:
    change = EFFECTS[active.name].for_role
    return active if change is None else replace(active, values=change(active.values, role))


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
    rng = stream(Purpose.PLANS, (seed,))
    plans = [(group, plan) for group in GROUPS for plan in plans_of(rng, rig, group, counts.get(group, 0))]
    order = rng.permutation(len(plans))
    return [_draw(rig, (seed, k, 0), plans[k][0], plans[k][1], duration_s) for k in order.tolist()]


def redraw(case: Case, attempt: int) -> Case:
    """Another machine, motion and shape for the same plan: the first could not carry the wanted strength."""
    return _draw(case.rig, (*case.seed[:2], attempt), case.group, case.plan, case.scales[0].duration_s)


# -- one case ------------------------------------------------------------------------------------------


def _draw(rig: Rig, seed: tuple[int, int, int], group: str, plan: Plan, duration_s: float) -> Case:
    variant, names, strength = plan
    rng = stream(Purpose.CASE, seed)
    mask = mask_for(rng, group, variant, names)
    if rig.joints > 1:
        mask = for_arm(stream(Purpose.ARM_LOG, seed), mask)
    if variant == "parameter_off" or group == "wrong_log":
        mask = replace(mask, no_law=False)
    machine = friction_or_none(rng, rig.draw(rng), names)
    controller = draw_controller(rng, rig, machine, mask)
    told = misjudged(rng, machine, mask.nominal_error if group != "clean" else 1e-3)
    paths = draw_paths(rng, rig, group, variant, duration_s)
    feed_forward = float(
        rng.choice([0.0, 0.0, 1.0] if rig.joints == 1 else [1.0, 1.0, 1.0])
    )  # arms do not sag
    motions = {role: motion_along(rig, told, q, feed_forward) for role, q in paths.items()}
    scales = scales_of(rig, machine, controller, paths["fit"], duration_s)
    sensing, heating = draw_sensing(rng, scales, mask), draw_heating(rng, scales)
    hidden = [open_effect(rng, name, scales) for name in names]
    other_robot = misjudged(rng, rig.draw(rng), 0.01) if variant == "other_robot" else None
    of_the_file = stream(Purpose.FILE, seed)
    return Case(
        seed=seed,
        rig=rig,
        group=group,
        variant=variant,
        machine=machine,
        told=other_robot or told,
        controller=controller,
        told_controller=controller,
        motions=motions,
        sensing=sensing,
        heating=heating,
        scales=scales,
        mask=mask,
        sessions=draw_sessions(rng, names),
        effects=hidden,
        in_model=built_in(of_the_file, group, variant, hidden, scales),
        targets=[strength] * len(hidden),
        parameters_off=wrong_values(of_the_file, group, variant, hidden, machine, mask),
        expected=expected_verdicts(group, variant),
        plan=plan,
        feed_forward=feed_forward,
    )


def feed_forward_of_the_file(case: Case) -> None:
    """Let the controller add the effort of the model as its file has it, with wrong values and what is built in.

    Fed forward from what the file would be without them, the noise-free column would give away that they are there.
    """
    if case.feed_forward and (case.parameters_off or case.in_model):
        told, paths = machine_of_the_file(case), {role: motion.q_cmd for role, motion in case.motions.items()}
        case.motions = {r: motion_along(case.rig, told, q, case.feed_forward) for r, q in paths.items()}


def machine_of_the_file(case: Case) -> Machine:
    """The machine of the model file: as believed, with wrong values, and with what of it is built in as a number."""
    told = altered_machine(case.rig, with_parameters_off(case)[0], case.in_model)
    coulomb = told.coulomb.copy()
    for active in case.in_model:
        if active.name == "coulomb_friction":
            coulomb[active.joint] += active.values["friction"]
    return replace(told, coulomb=coulomb)


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
