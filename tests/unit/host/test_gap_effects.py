"""Every effect of the catalogue: its regressor recovers its own strength, and its simulator form agrees."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import IMPOSSIBLE, Context, StepState
from s2r_host.gap.effects.cable_spring import NO_SPRING
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.base_terms import BaseTerm
from s2r_host.gap.regression.nuisance import base_parameters
from s2r_host.gap.rig import write_model

NAMES = [
    "coulomb_friction",
    "viscous_friction",
    "stribeck",
    "presliding",
    "asymmetric_friction",
    "load_dependent_friction",
    "backlash",
    "joint_elasticity",
    "hysteresis",
    "armature",
    "motor_coupling",
    "payload",
    "gravity_tilt",
    "effort_scale",
    "saturation",
    "thermal_drift",
    "session_friction",
    "actuator_delay",
    "bandwidth",
    "clock_skew",
    "encoder_offset",
    "encoder_eccentricity",
    "cogging",
    "cable_spring",
    "spring_return",
    "detent",
    "soft_end_stop",
    "soft_close",
    "joint_play",
    "flexible_part",
    "contact_slip",
]


@pytest.fixture(scope="module")
def ctx(tmp_path_factory):
    """A pendulum moved by a sum of sines, effort as the model needs it, in two sessions with a side force."""
    model = RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml"))
    t = np.arange(0, 8, 0.002)
    sessions = []
    for k, phase in enumerate((0.3, 1.9)):
        q = 0.7 * np.sin(1.1 * t + phase) + 0.3 * np.sin(5.3 * t) + 0.1
        u = 3.0 * np.sin(q) + 0.5 * np.cos(3 * t)
        channels = {
            "q": {"elbow": q},
            "tau": {"elbow": u},
            "wrench": {"arm.fx": 2 * np.sin(7 * t), "arm.my": 0.3 * np.sin(4 * t)},
        }
        rec = Recording(f"r{k}", t, channels, Controller(), "commanded", "effort", f"s{k}", "", ())
        sessions.append(make_session(model, rec, k))
    context = Context(model, sessions)
    for s in sessions:
        context.residual[(s.index, 0)] = np.sin(23.0 * s.q[:, 0])
    return context


def test_the_catalogue_is_the_contracts(ctx):
    assert sorted(catalogue()) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_says_what_it_is(name):
    effect = catalogue()[name]
    assert effect.equation
    assert effect.signature
    assert effect.separating_motion
    assert all(other in NAMES for other in effect.confusable + effect.contains)


def terms(ctx, name):
    effect = catalogue()[name]
    joint = -1 if effect.scope == "model" else 0
    if not effect.applies(ctx, joint):
        pytest.skip(f"{name} cannot act on one joint")
    return effect, joint, effect.shapes(ctx, joint)


@pytest.mark.parametrize("name", NAMES)
def test_columns_are_finite_and_cover_the_recording(ctx, name):
    effect, joint, shapes = terms(ctx, name)
    assert shapes
    s = ctx.sessions[1]
    largest = 0.0
    for shape in (shapes[0], shapes[len(shapes) // 2], shapes[-1]):
        columns = effect.columns(ctx, s, joint, shape)
        parts = [*columns.linear, *([] if columns.fixed is None else [columns.fixed])]
        assert parts
        for x in parts:
            assert len(x) == len(s.t)
            assert np.all(np.isfinite(x))
        largest = max(largest, *(float(np.max(np.abs(x))) for x in parts))
    assert largest > 0


@pytest.mark.parametrize("name", NAMES)
def test_parameters_carry_units_and_numbers(ctx, name):
    effect, joint, shapes = terms(ctx, name)
    columns = effect.columns(ctx, ctx.sessions[0], joint, shapes[0])
    values = effect.parameters(ctx, joint, shapes[0], np.full(len(columns.linear), 0.2))
    assert values
    assert all(np.isfinite(v.value) and v.unit for v in values.values())


@pytest.mark.parametrize("name", NAMES)
def test_there_is_a_simulator_form(ctx, name):
    import mujoco

    effect, joint, shapes = terms(ctx, name)
    if name in ("clock_skew", "session_friction"):
        pytest.skip("acts on the record, not on the plant")
    shape = shapes[len(shapes) // 2]
    theta = np.full(len(effect.columns(ctx, ctx.sessions[0], joint, shape).linear), 0.2)
    if effect.sense(ctx, joint, shape, theta) is not None:
        return
    spec = mujoco.MjSpec.from_file(str(ctx.model.path))
    if effect.patch(ctx, spec, joint, shape, theta):
        model = spec.compile()
        assert model.nv >= 1
        return
    assert effect.runtime(ctx, joint, shape, theta, 0.001) is not None


INSTANT = [
    "stribeck", "asymmetric_friction", "cogging", "spring_return", "detent", "soft_end_stop", "soft_close",
    "saturation", "presliding", "hysteresis", "bandwidth", "actuator_delay", "cable_spring", "contact_slip",
]  # fmt: skip


@pytest.mark.parametrize("name", INSTANT)
def test_regressor_and_simulator_form_ask_for_the_same_effort(ctx, name):
    """Walk the runtime along the recording; force plus dry friction must equal the columns times coefficients."""
    effect, joint, shapes = terms(ctx, name)
    s = ctx.sessions[0]
    shape = shapes[len(shapes) // 2]
    columns = effect.columns(ctx, s, joint, shape)
    theta = np.linspace(0.3, 0.5, len(columns.linear))
    wanted = sum((th * c for th, c in zip(theta, columns.linear, strict=True)), np.zeros(len(s.t)))
    if columns.fixed is not None:
        wanted = wanted + columns.fixed
    runtime = effect.runtime(ctx, joint, shape, theta, s.dt)
    if runtime is None:
        pytest.skip("stock attribute")
    got = np.empty(len(s.t))
    for i in range(len(s.t)):
        force, dry = runtime(
            StepState(s.t[i], s.q[i], s.v[i], s.a[i], s.u[i] - s.pushed[i], s.pushed[i], s.load[i])
        )
        got[i] = force + dry * s.sign(0)[i]
    inside = slice(200, None)
    assert np.sqrt(np.mean((got - wanted)[inside] ** 2)) < 0.03 * np.std(wanted[inside]) + 1e-6


@pytest.mark.parametrize("name", ["actuator_delay", "bandwidth", "saturation"])
def test_a_drive_s_shortcomings_are_of_the_drive_and_not_of_what_pushes(ctx, name):
    """A hand that pushes is not late, and no drive clips it: with the drive silent there is nothing to explain."""
    s = replace(ctx.sessions[0], u=ctx.sessions[0].pushed.copy())
    effect, joint, shapes = terms(ctx, name)
    for shape in shapes:
        fixed = effect.columns(ctx, s, joint, shape).fixed
        assert fixed is not None
        assert np.max(np.abs(fixed)) < 1e-9 < np.max(np.abs(s.pushed))


def test_an_effort_scale_is_of_what_the_drive_gives(ctx):
    s = ctx.sessions[0]
    pushes = replace(s, pushed=s.load.copy())
    needed = catalogue()["effort_scale"].columns(ctx, pushes, 0, {}).linear[0]
    assert needed == pytest.approx(float(ctx.model.model.dof_frictionloss[0]) * s.sign(0))


def test_two_seeds_of_one_effect_are_distinguishable(ctx):
    effect = catalogue()["cogging"]
    orders = [shape["order"] for shape in effect.shapes(ctx, 0)]
    assert min(abs(o - 23.0) for o in orders) < 1.0


def test_an_effort_scale_beyond_what_a_gear_is_off_by_is_refused(ctx):
    scale = catalogue()["effort_scale"]
    assert scale.size_prior(ctx, 0, {}, np.array([0.3])) == 0.0
    for theta in (-0.9, 1.5):
        assert scale.size_prior(ctx, 0, {}, np.array([theta])) < -100.0


@pytest.mark.parametrize(("hardens", "bend"), [(0.0, []), (1.0, [0.0, 0.0])])
def test_a_loop_whose_spring_vanishes_is_no_cable(ctx, hardens, bend):
    cable, shape = catalogue()["cable_spring"], {"width": 0.1, "hardens": hardens}
    for stiffness, odds in ((0.0, NO_SPRING), (1.0, 0.0)):
        assert cable.size_prior(ctx, 0, shape, np.array([stiffness, 0.2, 0.5, *bend])) == odds


def test_a_single_stroke_cannot_show_warming(ctx):
    """Along one stroke warming and place are the same thing."""
    thermal, s = catalogue()["thermal_drift"], ctx.sessions[0]
    assert thermal.blocked(ctx, 0) is None
    one_way = replace(s, v=np.abs(s.v) + 1.0)
    assert "reversals" in thermal.blocked(Context(ctx.model, [one_way]), 0)


def test_what_follows_the_effort_at_once_is_no_warming(ctx):
    low, _ = catalogue()["thermal_drift"].bounds(ctx, 0)["T"]
    assert low >= 0.4


def test_friction_by_load_needs_a_joint_that_is_moved_both_ways(ctx):
    by_load, s = catalogue()["load_dependent_friction"], ctx.sessions[0]
    assert by_load.blocked(ctx, 0) is None
    pulled = replace(s, q=np.linspace(0.0, 1.0, len(s.t))[:, None], v=np.ones_like(s.v))
    assert "one way" in by_load.blocked(Context(ctx.model, [pulled]), 0)


def test_a_ripple_shows_a_period(ctx):
    """A sine of half a period is a slope: it would stand for whatever else pulls slowly along the travel."""
    cogging = catalogue()["cogging"]
    low, high = ctx.span(0)
    for periods, seen in ((0.6, False), (5.0, True)):
        odds = cogging.log_prior(ctx, 0, {"order": 2 * np.pi * periods / (high - low), "rub": 0.0})
        assert (odds > -100.0) is seen


def test_a_friction_that_hardly_changes_along_the_travel_is_dry_friction(ctx):
    """Of order zero it is the sign of the speed, and nothing else: it takes a good part of a period to change."""
    cogging = catalogue()["cogging"]
    low, high = ctx.span(0)
    for periods, seen in ((0.0, False), (0.3, False), (0.5, True)):
        odds = cogging.log_prior(ctx, 0, {"order": 2 * np.pi * periods / (high - low), "rub": 1.0})
        assert (odds > IMPOSSIBLE) is seen
    rubbing = [shape for shape in cogging.shapes(ctx, 0) if shape["rub"]]
    assert rubbing
    assert all(cogging.log_prior(ctx, 0, shape) > IMPOSSIBLE for shape in rubbing)


def test_grams_on_a_long_stick_are_no_load(ctx):
    """They are an inertia without weight, which a motor has."""
    payload = catalogue()["payload"]
    farthest = max(shape["reach"] for shape in payload.shapes(ctx, -1))
    low, high = payload.bounds(ctx, -1)["reach"]
    assert low < 1.0 < farthest < high <= 2.0 * farthest


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_how_far_a_zero_of_the_effort_is_off_counts_in_shares_of_the_effort(ctx, unit):
    offset = next(p for p in base_parameters(ctx.model) if p.name == "effort_offset")
    zero = BaseTerm("parameter:effort@elbow", [offset])
    in_unit = Context(ctx.model, [replace(s, u=unit * s.u) for s in ctx.sessions])
    share = float(np.std(in_unit.sessions[0].u[:, 0]))
    assert zero.size_prior(in_unit, -1, {}, np.array([0.001 * share])) > -0.1
    assert zero.size_prior(in_unit, -1, {}, np.array([0.1 * share])) == -8.0


def test_creeping_to_a_stop_is_no_presliding(ctx):
    low, high = ctx.span(0)
    least, most = catalogue()["presliding"].bounds(ctx, 0)["width"]
    assert least >= 2e-4 * (high - low)
    assert most == pytest.approx(0.05 * (high - low))


def test_a_motor_inertia_that_the_model_states_is_believed(tmp_path, ctx):
    elasticity = catalogue()["joint_elasticity"]
    stated = Context(RigidModel(write_model(tmp_path / "m.xml", armature=0.02)), ctx.sessions)
    share = 0.02 / float(np.mean(np.concatenate([s.mass[:, 0] for s in ctx.sessions])))
    assert elasticity.log_prior(stated, 0, {"motor": share}) == pytest.approx(0.0)
    assert elasticity.log_prior(stated, 0, {"motor": 0.0}) == -8.0
    assert elasticity.log_prior(ctx, 0, {"motor": 0.0}) == 0.0
    assert elasticity.bounds(stated, 0)["motor"][0] == 0.0


def test_a_limit_that_the_drive_runs_far_beyond_is_tried(ctx):
    """A controller that winds up asks for hundreds of times what arrives: its limit is no quantile of the effort."""
    limit, asked = 2.0, []
    for s in ctx.sessions:
        needed = s.load[:, 0] * limit / np.abs(s.load[:, 0]).max()
        wound = np.where(
            np.abs(needed) > 0.8 * limit, needed, 300.0 * np.sign(needed) * (1.0 + np.sin(s.t) ** 2)
        )
        asked.append(replace(s, u=wound[:, None], load=needed[:, None]))
    wound_up = Context(ctx.model, asked)
    tried = [shape["limit"] for shape in catalogue()["saturation"].shapes(wound_up, 0) if shape["v0"] == 0.0]
    assert min(abs(x - limit) for x in tried) < 0.1 * limit


RAIL_AND_HINGE = """<mujoco><worldbody><body><joint name="rail" type="slide" axis="1 0 0" damping="2" frictionloss="1"/>
<geom size="0.1"/><body pos="0 0 -0.3"><joint name="hinge" axis="0 1 0"/><geom size="0.1"/></body></body></worldbody>
</mujoco>"""


@pytest.mark.parametrize(
    ("name", "shape", "theta", "units"),
    [
        ("backlash", {"w": 0.01, "motor": 0.2, "f": 13.0, "zeta": 0.4}, [], ["m", "kg"]),
        ("thermal_drift", {"T": 9.0, "target": 1.0}, [1.0], ["N·s/m", "s"]),
        (
            "motor_coupling",
            {"other": 1.0, "mutual": 1.0, "own": 1.0},
            [1.0] * 4,
            ["kg·m", "N·s/rad", "kg", "N·s/m", "joint index"],
        ),
    ],
)
def test_numbers_of_a_slide_are_told_in_its_units(tmp_path, name, shape, theta, units):
    path = tmp_path / "model.xml"
    path.write_text(RAIL_AND_HINGE)
    model, t = RigidModel(path), np.arange(0, 4, 0.004)
    q = {"rail": 0.1 * np.sin(2.0 * t), "hinge": 0.3 * np.sin(3.0 * t)}
    s = make_session(model, Recording("r", t, {"q": q}, Controller(), "measured", "effort", "a", "", ()), 0)
    values = catalogue()[name].parameters(Context(model, [s]), 0, shape, np.array(theta))
    assert [value.unit for value in values.values()] == units


def test_a_cable_rests_where_it_pulls_back(ctx):
    middle = 0.5 * sum(ctx.span(0))
    # x² - 0.01 beside the middle of the travel: it pushes away at -0.1 and pulls back at 0.1.
    theta = np.array([0.0, -0.01, 1.0, 1.0, 0.0])
    found = catalogue()["cable_spring"].parameters(ctx, 0, {"width": 0.1, "hardens": 1.0}, theta)
    assert found["rest"].value == pytest.approx(middle + 0.1)
    assert found["stiffness"].value == pytest.approx(0.2)


def test_a_warming_has_one_unit_in_all_recordings(ctx):
    """Kelvins where every fitted recording has a temperature, else what the effort heats, in shares of its mean."""
    thermal, s = catalogue()["thermal_drift"], ctx.sessions[0]
    warm = np.linspace(20.0, 45.0, len(s.rec.t))
    measured = replace(s, rec=replace(s.rec, channels={**s.rec.channels, "temp": {"elbow": warm}}), cache={})
    for order in ([measured, s], [s, measured]):
        mixed = Context(ctx.model, order)
        assert "T" in thermal.refine(mixed, 0)
        assert np.max(thermal._warming(mixed, measured, 0, 2.0)) < 10.0
    both = Context(ctx.model, [measured])
    assert "T" not in thermal.refine(both, 0)
    assert thermal._warming(both, measured, 0, 2.0)[-1] == pytest.approx(25.0, rel=0.01)
    assert not np.any(thermal._warming(both, s, 0, 2.0))
