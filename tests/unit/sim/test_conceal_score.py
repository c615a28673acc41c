"""The scorer on verdicts made by hand."""

import numpy as np
import pytest

from s2r_conceal.score import (
    calibration_error,
    confusion,
    coverage,
    every_stated,
    reliability,
    table,
    where_asked,
    wilson,
)
from s2r_conceal.score_case import score_case
from s2r_conceal.score_files import left_out, markdown
from s2r_conceal.score_parameters import true_values

T = np.arange(0.0, 10.0, 0.01)
COGGING = {"amplitude": {"value": 0.1, "unit": "N·m"}, "order": {"value": 20.0, "unit": "1/rad"}}
TRACKS = {"fit": {"t": T, "q.elbow": T / 10.0, "dq.elbow": np.ones_like(T)}}


def _effect(name="backlash", same_as=(), target=3.0, joint="elbow", parameters=None):
    return {
        "name": name,
        "joint": joint,
        "same_as": list(same_as),
        "target": target,
        "clear": True,
        "parameters": parameters or {"half_width": {"value": 0.004, "unit": "rad"}},
        "regime": {"recording": "fit", "t": [[2.0, 4.0]], "q": [0.2, 0.4], "dq": [1, 1], "words": ""},
    }


def _truth(group="single", effects=None, variant="", expected=("physics_missing",)):
    return {
        "group": group,
        "variant": variant,
        "expected": list(expected),
        "effects": [_effect()] if effects is None else effects,
        "holdout": {"oracle": 1e-4, "believed": 1e-3, "per_joint_oracle": [1e-4]},
        "stable": True,
    }


def _named(*names, verdict="physics_missing", where=None, **extra):
    entries = [
        {"name": n, "joint": "elbow", "probability": 0.9 - 0.1 * k, "could_also_be": [], "parameters": {}}
        for k, n in enumerate(names)
    ]
    gap = {"verdict": verdict, "effects": entries, "where": where or [], "wall_s": 5.0} | extra
    return {"exit_code": 7, "wall_s": 6.0, "gap": gap}


def _score(truth, verdict):
    return score_case("case-0001", truth, verdict, TRACKS)


def test_the_right_name_on_the_right_joint_counts():
    s = _score(_truth(), _named("backlash"))
    assert (s.top1, s.in_set, s.set_size, s.joint_right, s.right_verdict, s.extra) == (
        True,
        True,
        1,
        True,
        True,
        0,
    )
    assert s.probability == pytest.approx(0.9)
    assert s.wall_s == 5.0


def test_a_wrong_name_counts_as_wrong():
    s = _score(_truth(), _named("cogging"))
    assert (s.top1, s.in_set, s.extra) == (False, False, 1)


def test_the_more_probable_name_is_the_first_whatever_the_order():
    verdict = _named("cogging", "backlash")
    verdict["gap"]["effects"].reverse()
    assert _score(_truth(), verdict).named == ("cogging", "backlash")


def test_could_also_be_puts_the_truth_into_the_set_but_not_first():
    verdict = _named("presliding")
    verdict["gap"]["effects"][0]["could_also_be"] = ["backlash"]
    s = _score(_truth(), verdict)
    assert (s.top1, s.in_set, s.set_size) == (False, True, 2)


def test_a_declared_class_is_counted_apart():
    truth = _truth(effects=[_effect("gravity_tilt", same_as=["encoder_offset"])])
    s = _score(truth, _named("encoder_offset"))
    assert (s.top1, s.top1_or_class) == (False, True)


def test_payload_is_right_under_the_parameter_list():
    truth = _truth(effects=[_effect("payload", parameters={"mass": {"value": 1.0, "unit": "kg"}})])
    verdict = _named(verdict="parameter_off", parameters_off=[{"name": "payload_mass", "body": "hand"}])
    s = _score(truth, verdict)
    assert (s.top1, s.right_verdict) == (True, True)


def test_viscous_friction_is_not_right_under_the_parameter_list():
    truth = _truth(effects=[_effect("viscous_friction")])
    verdict = _named(verdict="parameter_off", parameters_off=[{"name": "viscous_friction"}])
    assert _score(truth, verdict).top1 is False


def test_a_name_under_another_verdict_does_not_count():
    s = _score(_truth(), _named("backlash", verdict="unknown"))
    assert (s.top1, s.right_verdict) == (False, False)


@pytest.mark.parametrize(
    ("verdict", "names", "alarm"),
    [
        ("nothing_missing", (), False),
        ("parameter_off", (), False),
        ("insufficient", (), False),
        ("physics_missing", ("backlash",), True),
        ("physics_missing", ("payload",), False),
        ("unknown", (), True),
    ],
)
def test_false_alarms_on_clean_cases(verdict, names, alarm):
    truth = _truth("clean", [], "plain", ["nothing_missing"])
    assert _score(truth, _named(*names, verdict=verdict)).false_alarm is alarm


def test_a_catalogue_name_for_an_unknown_effect_is_a_wrong_name():
    truth = _truth("unknown", [_effect("push")], expected=["unknown"])
    assert _score(truth, _named("cogging")).wrong_name is True
    there = _named(verdict="unknown", where=[{"joint": "elbow"}])
    s = _score(truth, there)
    assert (s.wrong_name, s.right_verdict, s.joint_right) == (False, True, True)


def test_pairs_need_both_names_and_count_invented_ones():
    truth = _truth("pairs", [_effect("backlash"), _effect("cogging", parameters=COGGING)])
    assert _score(truth, _named("cogging", "backlash")).all_named is True
    s = _score(truth, _named("cogging", "detent"))
    assert (s.all_named, s.extra) == (False, 1)


def test_a_name_of_the_class_is_not_both_named():
    known = {"displacement": {"value": 0.01, "unit": "rad"}}
    second = _effect("presliding", same_as=["hysteresis"], parameters=known)
    truth = _truth("pairs", [_effect("backlash"), second])
    s = _score(truth, _named("backlash", "hysteresis"))
    assert (s.all_named_exactly, s.all_named) == (False, True)
    assert _score(truth, _named("backlash", "presliding")).all_named_exactly is True
    lines = {line.name: line.value for line in table([s])}
    assert (lines["pairs: both named"], lines["pairs: both named or in their classes"]) == (0.0, 1.0)


def test_regime_overlap_compares_time_intervals():
    where = [{"joint": "elbow", "regime": {"t": [[3.0, 5.0]]}}]
    assert _score(_truth(), _named("backlash", where=where)).iou == pytest.approx(1.0 / 3.0, abs=0.01)


def test_regime_overlap_falls_back_on_the_box_in_position_and_speed():
    where = [{"joint": "elbow", "regime": {"t": [], "q": [0.2, 0.4], "dq": None}}]
    assert _score(_truth(), _named("backlash", where=where)).iou == pytest.approx(1.0, abs=0.02)


def test_regime_overlap_is_zero_when_nothing_or_another_joint_is_stated():
    assert _score(_truth(), _named("backlash")).iou == 0.0
    other = [{"joint": "wrist", "regime": {"t": [[2.0, 4.0]]}}]
    assert _score(_truth(), _named("backlash", where=other)).iou == 0.0


def test_oracle_ratio_is_the_share_of_the_gain_that_was_reached():
    verdict = _named("backlash", fit={"holdout_before": 1.1e-3, "holdout_after": 2.0e-4})
    assert _score(_truth(), verdict).oracle_ratio == pytest.approx(0.9)


def test_oracle_ratio_is_left_out_where_there_is_nothing_to_gain():
    verdict = _named("backlash", fit={"holdout_before": 1.2e-4, "holdout_after": 1.1e-4})
    assert _score(_truth(), verdict).oracle_ratio is None


def _arm(after, **fit):
    """Seven joints, one of them 1 mrad off before; its noise is ten times that of the others."""
    oracles = [2e-5] * 6 + [2e-4]
    truth = _truth()
    truth["holdout"] = {"oracle": max(oracles), "believed": 1e-3, "per_joint_oracle": oracles}
    names = [f"joint{k}" for k in range(7)]
    before, now = [*oracles[:6], 1e-3], [*oracles[:6], after]
    stated = {
        n: {"holdout_before": b, "holdout_after": a} for n, b, a in zip(names, before, now, strict=True)
    }
    rms = {
        f"holdout_{when}": float(np.sqrt(np.mean(np.square(x))))
        for when, x in (("before", before), ("after", now))
    }
    tracks = {"fit": {"t": T, **{f"q.{n}": T for n in names}}}
    verdict = _named("backlash", fit=rms | {"closed_loop": True, "per_joint": stated} | fit)
    return score_case("case-0001", truth, verdict, tracks).oracle_ratio


def test_the_oracle_ratio_of_an_arm_is_that_of_the_joint_that_was_off_most():
    assert _arm(after=2e-4) == pytest.approx(1.0)
    assert _arm(after=5e-4) == pytest.approx(0.625)


def test_predictions_without_the_loop_have_no_oracle_ratio():
    assert _arm(after=2e-4, closed_loop=False) is None


def test_a_mean_over_joints_alone_has_no_oracle_ratio():
    assert _arm(after=2e-4, per_joint={}) is None


def test_refusals_count_by_exit_code():
    truth = _truth("wrong_log", [], "degrees", ["refused", "unknown"])
    assert _score(truth, {"exit_code": 4, "wall_s": 1.0, "gap": None}).right_verdict is True


def test_no_answer_is_an_answer_of_its_own():
    s = _score(_truth(), {"exit_code": 1, "wall_s": 1.0, "gap": None})
    assert (s.answered, s.right_verdict, s.top1) == ("none", False, False)


def test_intervals_are_compared_with_the_truth():
    verdict = _named("backlash")
    verdict["gap"]["effects"][0]["parameters"] = {
        "half_width": {"value": 0.0041, "interval90": [0.0036, 0.0043]},
        "width": {"value": 0.0100, "interval90": [0.0095, 0.0105]},
        "stiffness": {"value": 1.0, "interval90": [0.9, 1.1]},
    }
    s = _score(_truth(), verdict)
    assert [(i.parameter, i.inside) for i in s.intervals] == [("half_width", True), ("width", False)]
    assert coverage([s]).value == 0.5


def test_parameters_that_are_not_identifiable_are_not_held_against_the_tool():
    verdict = _named("backlash")
    stated = {"value": 1.0, "interval90": [0.9, 1.1], "identifiable": False}
    verdict["gap"]["effects"][0]["parameters"] = {"half_width": stated}
    assert _score(_truth(), verdict).intervals == []


def test_converted_parameters_mean_the_same_quantity():
    soft = {
        "name": "joint_elasticity",
        "parameters": {"compliance": {"value": 0.002}, "damping": {"value": 1.0}},
    }
    assert true_values(soft)["stiffness"] == pytest.approx(500.0)
    scale = {
        "name": "effort_scale",
        "parameters": {"deviation": {"value": 0.1}, "direction": {"value": -1.0}},
    }
    assert true_values(scale)["scale"] == pytest.approx(0.9)


def test_calibration_error_of_a_boastful_tool():
    scores = [_score(_truth(), _named(name)) for name in ("backlash", "cogging", "cogging", "cogging")]
    assert reliability(every_stated(scores)) == [(pytest.approx(0.9), 0.25, 4)]
    assert calibration_error("", every_stated(scores)).value == pytest.approx(0.65)


def test_a_name_stated_where_nothing_is_to_be_named_counts_as_wrong():
    hidden = [_score(_truth(), _named("backlash"))] * 2
    wrong = [
        _score(_truth("clean", [], "plain", ["nothing_missing"]), _named("backlash")),
        _score(_truth("unknown", [_effect("vibration")], "", ["unknown"]), _named("backlash")),
        _score(_truth("insufficient", [_effect()], "still", ["insufficient"]), _named("backlash")),
        _score(_truth("wrong_log", [], "degrees", ["refused", "unknown"]), _named("backlash")),
    ]
    silent = [_score(_truth("clean", [], "plain", ["nothing_missing"]), _named(verdict="nothing_missing"))]
    lines = {line.name: line for line in table([*hidden, *wrong, *silent])}
    every = lines["calibration error of every stated first name"]
    asked = lines["calibration error where a catalogue effect is to be named"]
    assert (every.value, every.count) == (pytest.approx(0.9 - 2 / 6), 6)
    assert (asked.value, asked.count) == (pytest.approx(0.1), 2)
    assert [len(where_asked(some)) for some in (hidden, wrong)] == [2, 0]


def test_a_wrong_value_named_as_one_of_both_lists_is_neither_invented_nor_badly_stated():
    off = [{"name": "mass", "joint": "elbow", "relative": 0.1}]
    clean = _truth("clean", [], "parameter_off", ["parameter_off"]) | {"parameters_off": off}
    assert _score(clean, _named("payload")).name_right is True
    assert _score(clean, _named("backlash")).name_right is False
    found = _named("backlash", parameters_off=[{"name": "mass", "body": "link"}])
    assert _score(_truth() | {"parameters_off": off}, found).extra == 0
    assert _score(_truth(), found).extra == 1


def test_answers_without_effort_are_told_apart_by_what_positions_tell():
    def score(expected, verdict):
        return _score(_truth("masked", None, "no_effort", expected), verdict)

    scores = [
        score(["insufficient"], _named(verdict="insufficient")),
        score(["physics_missing", "insufficient"], _named(verdict="insufficient")),
        score(["physics_missing", "insufficient"], _named("backlash")),
        score(["insufficient", "physics_missing"], _named(verdict="nothing_missing")),
    ]
    lines = {line.name: line for line in table(scores)}
    for name, value, count in (
        ("masked, no effort: right verdict", 3 / 4, 4),
        ("masked, no effort, positions tell: first name right", 0.5, 2),
    ):
        assert (lines[name].value, lines[name].count) == (pytest.approx(value), count)


def test_the_table_counts_cases_and_shows_goals():
    scores = [
        _score(_truth(), _named("backlash")),
        _score(_truth(effects=[_effect(target=10.0)]), _named("cogging")),
        _score(_truth(effects=[_effect(target=1.5)]), _named("cogging")),
        _score(_truth("clean", [], "plain", ["nothing_missing"]), _named(verdict="nothing_missing")),
    ]
    lines = {line.name: line for line in table(scores)}
    assert (lines["single ≥ 3 ×: first name right"].value, lines["single ≥ 3 ×: first name right"].count) == (
        0.5,
        2,
    )
    assert lines["clean: false alarms"].value == 0.0
    assert lines["pairs: both named"].value is None
    assert "| pairs: both named | – |  | 0 | ≥ 0.85 |" in markdown(list(lines.values()), scores)
    assert confusion(scores)["backlash"] == {"backlash": 1, "cogging": 2}


def test_a_rate_comes_with_the_interval_its_count_allows():
    low, high = wilson(0.9, 50)
    assert (low, high) == pytest.approx((0.7864, 0.9565), abs=1e-4)
    assert wilson(0.0, 12)[0] == 0.0
    assert wilson(0.0, 12)[1] == pytest.approx(0.2425, abs=1e-3)


def test_a_wrong_number_holds_its_set_where_it_stands():
    truth = _truth(effects=[_effect("payload")])
    off = {"name": "effort_scale", "joint": "elbow", "from": 1.0, "to": 0.97}
    bare = _score(truth, _named(verdict="parameter_off", parameters_off=[off]))
    assert (bare.top1, bare.in_set, bare.set_size) == (False, False, 1)
    also = _score(
        truth, _named(verdict="parameter_off", parameters_off=[off | {"could_also_be": ["payload"]}])
    )
    assert (also.top1, also.in_set, also.set_size) == (False, True, 2)
    other = {"name": "mass", "body": "link", "could_also_be": ["backlash"]}  # a second entry adds nothing
    both = _score(truth, _named(verdict="parameter_off", parameters_off=[off, other]))
    assert (both.in_set, both.set_size) == (False, 1)


def test_cases_that_became_unstable_are_named_below_the_table():
    answers = {"case-0001": _truth(), "case-0002": _truth() | {"stable": False}}
    assert left_out(answers) == ("\nLeft out of 2 cases, as their simulation became unstable: case-0002.\n")
    assert left_out({"case-0001": _truth()}) == ""
