"""What belongs in one answer set, how probable each of two alike is, and which friction is no more than a number."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.gap.effects import encoder_offset, gravity_tilt
from s2r_host.gap.effects.asymmetric_friction import EFFECT as ASYMMETRIC
from s2r_host.gap.effects.backlash import EFFECT as BACKLASH
from s2r_host.gap.effects.effort_scale import EFFECT as SCALE
from s2r_host.gap.effects.viscous_friction import EFFECT as VISCOUS
from s2r_host.gap.motion.law import LawFinding
from s2r_host.gap.regression.solution import Scored, Term
from s2r_host.gap.search.search import Search
from s2r_host.gap.search.shapes import Shapes
from s2r_host.gap.verdict.decision import Decision
from s2r_host.gap.verdict.naming import CEILING, Named, slot_probabilities
from s2r_host.gap.verdict.other_equations import add_law
from s2r_host.gap.verdict.parameters_off import off_entries
from s2r_host.gap.verdict.rejected import without_answered

ROTARY = SimpleNamespace(model=SimpleNamespace(joints=["elbow"], unit=lambda joint: "rad"))


def slot(*gains):
    return [Scored(Term(name, 0), gain, gain, 0.5, np.zeros(0)) for name, gain in gains]


def probabilities(*gains):
    search = SimpleNamespace(effects={name: SimpleNamespace(contains=()) for name, _ in gains})
    found = slot_probabilities(search, slot(*gains))  # pyright: ignore[reportArgumentType]
    return {key[0]: p for key, p in found.items()}


def test_a_lead_over_an_effect_declared_alike_counts_less():
    alike = probabilities(("actuator_delay", 32.0), ("bandwidth", 30.0))["actuator_delay"]
    other = probabilities(("actuator_delay", 32.0), ("cogging", 30.0))["actuator_delay"]
    assert 0.5 * CEILING < alike < 0.7
    assert other > 0.8
    even = probabilities(("gravity_tilt", 32.0), ("encoder_offset", 32.0))
    assert even["gravity_tilt"] == pytest.approx(even["encoder_offset"])


@pytest.mark.parametrize(("angle", "tilted"), [(0.01, True), (0.04, True), (0.15, False), (-0.3, False)])
def test_a_base_is_level_to_degrees_and_a_zero_is_off_by_a_tooth(angle, tilted):
    theta = np.array([angle])
    tilt = gravity_tilt.EFFECT.size_prior(ROTARY, -1, {}, theta)  # pyright: ignore[reportArgumentType]
    zero = encoder_offset.EFFECT.size_prior(ROTARY, 0, {}, theta)  # pyright: ignore[reportArgumentType]
    assert (tilt > zero) is tilted
    assert abs(tilt - zero) < 8.0  # so near that the set holds both


@pytest.mark.parametrize(
    ("theta", "differs"),
    [
        ([0.004, 0.001, 0.08, 0.11], False),
        ([0.04, 0.001, 0.08, 0.11], True),
        ([0.004, -0.03, 0.08, 0.11], True),
        ([0.02, 0.0, -0.02, 0.0], True),  # all of it in one direction
        ([0.0, 0.3, 0.5, -0.2], False),  # would drive the joint one way, with more than it has to overcome
        ([0.0, 0.02, 0.5, 0.0], True),  # so little below nothing may be an error
    ],
)
def test_friction_alike_both_ways_or_that_drives_is_not_asymmetric(theta, differs):
    shape: dict[str, float] = {"dry": 1.0, "viscous": 1.0}
    said = ASYMMETRIC.size_prior(frictionless(top=1.5), 0, shape, np.array(theta))
    assert said == (0.0 if differs else -np.inf)


@pytest.mark.parametrize(("slope", "possible"), [(-0.05, True), (-0.4, False), (0.2, True)])
def test_friction_that_drives_is_not_viscous(slope, possible):
    ctx = frictionless(top=1.5)
    ctx.model.model.dof_damping[0], ctx.model.model.dof_frictionloss[0] = 0.1, 0.3
    said = VISCOUS.size_prior(ctx, 0, {}, np.array([slope]))
    assert said == (0.0 if possible else -np.inf)


def frictionless(top: float) -> Any:
    """Recordings up to a top speed on a joint whose model has no friction."""
    model = SimpleNamespace(dof_damping=[0.0], dof_frictionloss=[0.0])
    session = SimpleNamespace(v=np.array([[0.0], [-top], [0.5 * top]]))
    return SimpleNamespace(model=SimpleNamespace(model=model), sessions=[session])


@pytest.mark.parametrize(("damping", "number"), [(0.0, False), (0.3, True)])
def test_friction_is_a_number_only_where_the_model_has_some(damping, number):
    model = SimpleNamespace(dof_damping=np.array([damping]), dof_frictionloss=np.array([0.2]))
    search = SimpleNamespace(problem=SimpleNamespace(ctx=SimpleNamespace(model=SimpleNamespace(model=model))))
    assert Search.a_number(search, Term("viscous_friction", 0)) is number  # pyright: ignore[reportArgumentType]
    assert Search.a_number(search, Term("coulomb_friction", 0))  # pyright: ignore[reportArgumentType]
    assert not Search.a_number(search, Term("stribeck", 0))  # pyright: ignore[reportArgumentType]


def test_a_wrong_number_says_what_else_it_could_be():
    table = {"scale": {"value": 0.97, "unit": "1", "interval90": [0.95, 0.99], "identifiable": True}}
    search = SimpleNamespace(effects={"effort_scale": SCALE})

    def entry(also):
        named = Named(
            Term("effort_scale", 0), "effort_scale", "elbow", 0.9, also, "", table, np.array([0.03])
        )
        return off_entries(SimpleNamespace(), search, named)[0]  # pyright: ignore[reportArgumentType]

    assert entry(["payload"])["could_also_be"] == ["payload"]
    assert entry(["payload"])["to"] == 0.97
    assert "could_also_be" not in entry([])
    assert "could_also_be" not in entry(["effort_scale"])  # its own name is no rival


def test_a_lag_that_the_law_shows_may_be_a_delay_where_both_come_close():
    """A drive is neither a pure delay nor a pure lag: a lead of a hundredth of all evidence is the equations' error."""
    problem = SimpleNamespace(ctx=SimpleNamespace(model=SimpleNamespace(joints=["elbow"])))
    table = {
        "time_constant": {"value": 0.005, "unit": "s", "interval90": [0.004, 0.006], "identifiable": True}
    }
    for rival, also in ((1904.0, ["actuator_delay"]), (1700.0, [])):
        gains = {"actuator_delay": rival, "controller_gain": 1910.0, "clock_skew": 268.0}
        decision = Decision("nothing_missing", SimpleNamespace())  # pyright: ignore[reportArgumentType]
        add_law(problem, LawFinding("bandwidth", 0, 1920.0, 0.9, table, {"T": 0.005}, gains), decision)  # pyright: ignore[reportArgumentType]
        assert decision.verdict == "physics_missing"
        assert decision.effects[0].could_also_be == also


@pytest.mark.parametrize(("step", "narrowest"), [(5e-6, 2e-4), (2e-4, 1.2e-3), (2e-5, 4e-4)])
def test_play_is_sought_as_narrow_as_the_encoder_resolves(monkeypatch, step, narrowest):
    """A radian to either side; at least 0.01 % of the travel, at most 0.06 % of it; with a known law from 0.01 %."""
    known = {"is": False}
    monkeypatch.setattr("s2r_host.gap.effects.backlash.servo_known", lambda ctx, joint: known["is"])
    session = SimpleNamespace(q_lsb=np.array([step]), mass=np.ones((3, 1)))
    model = SimpleNamespace(model=SimpleNamespace(dof_armature=np.array([0.2])))
    ctx = SimpleNamespace(
        sessions=[session], model=model, span=lambda joint: (-1.0, 1.0), turns=lambda joint: 0
    )
    for known["is"], least in ((False, narrowest), (True, 0.0002)):
        shapes = BACKLASH.shapes(ctx, 0)  # pyright: ignore[reportArgumentType]
        widths = sorted({s["w"] for s in shapes if ("servo" in s) == known["is"]})
        assert widths[0] == pytest.approx(least)
        assert widths[-1] == pytest.approx(0.1)
        assert max(np.diff(np.log(widths))) < 0.2


def test_flanks_are_damped_no_further_than_to_where_they_stop_rebounding():
    """A search that gains by damping alone ends: steps of the integration shrink with it, without limit."""
    search = SimpleNamespace(
        effects={"backlash": BACKLASH}, problem=SimpleNamespace(ctx=None), _seen=lambda term: None
    )
    start = Term("backlash", 0, (("f", 24.0), ("motor", 0.4), ("w", 0.01), ("zeta", 0.4)))
    found = Shapes._refine(search, (0.0, start), lambda term: dict(term.shape)["zeta"])  # pyright: ignore[reportArgumentType]
    assert dict(found[1].shape)["zeta"] == pytest.approx(2.0)


REJECTED = [
    {"name": name, "joint": joint, "holdout_gain": 0.0, "why": "no evidence"}
    for name in ("armature", "spring_return", "payload", "coulomb_friction", "cogging")
    for joint in ("shoulder", "elbow")
]


def _left(effects, off):
    return {(r["name"], r["joint"]) for r in without_answered(REJECTED, effects, off)}


def test_what_the_answer_names_or_holds_possible_is_not_rejected_beside_it():
    effects = [{"name": "cable_spring", "joint": "elbow", "could_also_be": ["spring_return"]}]
    off = [
        {"name": "armature", "joint": "shoulder"},
        {"name": "frictionloss", "joint": "elbow", "could_also_be": ["cogging"]},
    ]
    left = _left(effects, off)
    gone = {(r["name"], r["joint"]) for r in REJECTED} - left
    assert gone == {
        ("spring_return", "elbow"), ("armature", "shoulder"), ("coulomb_friction", "elbow"), ("cogging", "elbow"),
    }  # fmt: skip


def test_a_load_that_is_listed_as_a_number_is_rejected_at_no_joint():
    left = _left([], [{"name": "payload_mass", "body": "hand", "joint": "elbow"}])
    assert not {("payload", "shoulder"), ("payload", "elbow")} & left
    assert len(left) == len(REJECTED) - 2
