"""Explanations that cannot be, and explanations of one part of a record only, are no answers."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.gap.effects.base import IMPOSSIBLE
from s2r_host.gap.regression.base_terms import FAR, MULTIPLE, BaseTerm
from s2r_host.gap.verdict import decide, parameters_off
from s2r_host.gap.verdict.decide import _of_no_size, impossible, possible, unnamed_force_beside
from s2r_host.gap.verdict.decision import EXPLAINED_CLOSE, Decision, too_much_left
from s2r_host.gap.verdict.parameters_off import _of_one_part, _within_declared, base_entries


def entry(name, to, deviation, place="arm"):
    return {
        "name": name,
        "joint": place,
        "from": 1.0,
        "to": to,
        "unit": "kg",
        "interval90": [to - deviation, to + deviation],
    }


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ([entry("armature", -3.5, 0.1)], "it would take armature of 'arm' to be -3.5 kg, which cannot be"),
        ([entry("armature", -0.05, 0.1)], None),  # zero is within its interval
        ([entry("effort_offset", -3.5, 0.1)], None),  # may have either sign
        ([entry("mass", 3.5, 0.1), entry("damping", -1.0, 0.2)], "damping"),
    ],
)
def test_a_size_below_zero_is_impossible(entries, said):
    decision: Any = SimpleNamespace(parameters_off=entries, effects=[])
    problem: Any = None
    found = impossible(problem, decision)
    assert found is None if said is None else said in found


def test_what_cannot_be_is_not_listed_beside_an_unknown_effect():
    heavy, doubtful, offset = (
        entry("mass", 3.5, 0.1),
        entry("armature", -0.05, 0.1),
        entry("com_x", -1.0, 0.1),
    )
    assert possible([entry("inertia", -0.14, 0.03), heavy, doubtful, offset]) == [heavy, doubtful, offset]


@pytest.mark.parametrize(
    ("moved", "deviation", "to", "interval"),
    [
        (-1.1, 0.2, 0.0, (0.0, 0.23)),  # a little below zero: none of it
        (-0.8, 0.2, 0.2, (0.0, 0.53)),
        (-2.0, 0.2, -1.0, (-1.33, -0.67)),  # impossible, and told as it is
    ],
)
def test_a_damping_that_is_gone_is_told_as_none(moved, deviation, to, interval):
    damping: Any = SimpleNamespace(
        name="damping", place="arm", on_joint=True, nominal=1.0, size=1.0, unit="N·m·s/rad"
    )
    problem: Any = SimpleNamespace(base=[damping])
    solution: Any = SimpleNamespace(base=np.array([moved]), base_deviation=np.array([deviation]))
    (found,) = base_entries(problem, solution)
    assert found["to"] == pytest.approx(to)
    assert found["interval90"] == pytest.approx(list(interval), abs=0.005)


@pytest.mark.parametrize(("level", "fits"), [(-0.5, True), (-1.5, False), (0.8, True)])
def test_more_friction_than_the_model_has_cannot_be_taken_away(level, fits):
    model = SimpleNamespace(model=SimpleNamespace(dof_frictionloss=[1.0], dof_damping=[0.0]))
    problem: Any = SimpleNamespace(ctx=SimpleNamespace(model=model))
    named = SimpleNamespace(
        name="coulomb_friction",
        joint="arm",
        term=SimpleNamespace(joint=0),
        parameters={"level": {"value": level, "interval90": [level - 0.1, level + 0.1]}},
    )
    decision: Any = SimpleNamespace(parameters_off=[], effects=[named])
    assert (impossible(problem, decision) is None) == fits


@pytest.mark.parametrize(("move", "odds"), [(0.5, -FAR), (1.5, -FAR - MULTIPLE), (-1.5, IMPOSSIBLE)])
def test_a_body_is_rarely_off_by_a_multiple_of_its_inertia(move, odds):
    member: Any = SimpleNamespace(name="inertia", nominal=0.02, size=0.02)
    ctx: Any = None
    assert BaseTerm("parameter:inertia@arm", [member]).size_prior(ctx, -1, {}, np.array([move])) == odds


@pytest.mark.parametrize(
    ("left", "by_names", "said"), [(0, 0, True), (0, 1, False), (None, 0, False), (0, None, False)]
)
def test_a_push_that_names_leave_over_is_still_a_push(monkeypatch, left, by_names, said):
    found = {"numbers": left, "names": by_names}
    touched = {k: None if j is None else SimpleNamespace(joint=j) for k, j in found.items()}
    monkeypatch.setattr(decide, "bursts", lambda _, rows: touched[rows])
    search: Any = SimpleNamespace(finish=lambda *_: SimpleNamespace(unexplained="numbers"))
    decision: Any = SimpleNamespace(solution=SimpleNamespace(unexplained="names"))
    problem: Any = None
    assert unnamed_force_beside(problem, search, decision) is said


def solved(fit, held):
    """Does a change of the misfit on fit and on held-out rows count as one of the fitted part only?"""
    rows = np.arange(200) >= 140
    problem: Any = SimpleNamespace(held=rows)
    search: Any = SimpleNamespace(finish=lambda *_: SimpleNamespace(unexplained=np.ones(200)))
    solution: Any = SimpleNamespace(unexplained=np.where(rows, held, fit))
    return _of_one_part(problem, search, solution)


@pytest.mark.parametrize(("fit", "held", "only"), [(0.5, 1.01, True), (0.5, 0.9, False), (0.99, 1.01, False)])
def test_what_is_not_there_in_the_rows_held_out_explains_one_part(fit, held, only):
    assert solved(fit, held) == only


@pytest.mark.parametrize(
    ("sigmas", "left", "noise"),
    [([0.4, 0.3], 0.5, True), ([0.4, 0.3], 1.2, False), ([0.4, 0.0], 0.5, False)],
)
def test_what_the_recordings_say_they_are_off_by_is_no_unknown_effect(monkeypatch, sigmas, left, noise):
    monkeypatch.setattr(parameters_off, "leftover", lambda *_: left)
    sessions = [SimpleNamespace(rec=SimpleNamespace(effort_sigma={"arm": x} if x else {})) for x in sigmas]
    ctx = SimpleNamespace(model=SimpleNamespace(joints=("arm",)), sessions=sessions)
    problem: Any = SimpleNamespace(joints=[0], ctx=ctx)
    solution: Any = SimpleNamespace(unexplained=None)
    assert _within_declared(problem, solution) == noise


@pytest.mark.parametrize(
    ("explained", "too_much"), [(EXPLAINED_CLOSE + 0.1, False), (EXPLAINED_CLOSE - 0.1, True)]
)
def test_a_leftover_at_the_floor_that_comes_back_leaves_too_much_only_where_little_is_explained(
    explained, too_much
):
    terms = [SimpleNamespace(effect="viscous_friction"), SimpleNamespace(effect="joint_elasticity")]
    problem: Any = SimpleNamespace(floor_source="repeat", floor_doubt=1.0, ctx=SimpleNamespace(sessions=[]))
    search: Any = SimpleNamespace(
        comes_back=lambda _: True, completed=0,
        effects={t.effect: SimpleNamespace(explained_least=1.0) for t in terms},
    )  # fmt: skip
    decision: Any = SimpleNamespace(leftover=1.2, explained=explained, solution=SimpleNamespace(terms=terms))
    assert too_much_left(problem, search, decision) == too_much


@pytest.mark.parametrize(
    ("left", "explained", "verdict"), [(2.4, -0.5, "nothing_missing"), (1.0, 0.9, "parameter_off")]
)
def test_a_number_that_leaves_what_all_of_them_do_not_is_not_the_one(monkeypatch, left, explained, verdict):
    problem: Any = SimpleNamespace(
        floor_source="estimated", floor_doubt=1.0, ctx=SimpleNamespace(sessions=[])
    )
    search: Any = SimpleNamespace(comes_back=lambda _: False, completed=0, effects={})
    solution: Any = SimpleNamespace(terms=[])
    one = Decision("parameter_off", solution, leftover=left, explained=explained)
    monkeypatch.setattr(decide, "parameters_only", lambda *_: one)
    assert decide._one_number(problem, search, Decision("nothing_missing", solution)).verdict == verdict


@pytest.mark.parametrize(
    ("name", "intervals", "none"),
    [
        ("effort_scale", [[0.98, 1.02]], True),
        ("effort_scale", [[1.01, 1.05]], False),
        ("gravity_tilt", [[-0.01, 0.02], [0.01, 0.03]], False),
        ("gravity_tilt", [[-0.01, 0.02], [-0.01, 0.03]], True),
        ("viscous_friction", [[-0.1, 0.1]], False),
    ],
)
def test_a_scale_that_may_as_well_be_one_is_not_named(name, intervals, none):
    tables = {str(k): {"interval90": ends} for k, ends in enumerate(intervals)}
    named: Any = SimpleNamespace(name=name, parameters=tables)
    assert _of_no_size(named) == none
