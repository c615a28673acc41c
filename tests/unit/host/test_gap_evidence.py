"""What the evidence decides: parts that must agree, friction that thins with heat, drift from fitted friction."""

import numpy as np
import pytest
from scipy.signal import lfilter

from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import Context
from s2r_host.gap.effects.thermal_drift import ALL
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.regression.seeds import fill_residuals
from s2r_host.gap.regression.solution import Scored, Term
from s2r_host.gap.rig import write_model
from s2r_host.gap.search.consistency import disagreement
from s2r_host.gap.search.search import Search
from s2r_host.gap.search.wrong_number import turned_not_shifted, with_number
from s2r_host.gap.verdict.decide import decide
from s2r_host.gap.verdict.decision import LEFTOVER_LIMIT

DT, FRICTION, DAMPING = 0.004, 0.3, 0.2
NOISE = 0.02


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml", FRICTION, DAMPING))


def recorded(model, index, phase, hidden, seen=lambda q: q, session="a", late=0.0):
    """Effort the model needs for a motion, slow noise, and ``hidden(t, q, v, a)``; asked for ``late`` s before."""
    rng = np.random.default_rng(index)
    t = np.arange(0, 20, DT)
    q = 0.8 * np.sin(1.7 * t + phase) + 0.3 * np.sin(5.3 * t + 2.0 * phase) + 0.08 * np.sin(13.0 * t + phase)
    v = np.gradient(q, DT)
    a = np.gradient(v, DT)
    u = (
        model.inverse(q[:, None], v[:, None], a[:, None])[:, 0]
        + FRICTION * np.tanh(v / 0.01)
        + hidden(t, q, v, a)
    )
    noise = np.asarray(lfilter([0.2], [1.0, -0.9], rng.normal(size=len(t))))
    u = np.interp(t + late, t, u) + NOISE * noise / np.std(noise)
    channels = {"q": {"elbow": seen(q)}, "tau": {"elbow": u}, "temp": {"elbow": warmth(t)}}
    rec = Recording(f"r{index}", t, channels, Controller(), "commanded", "effort", session, "", ())
    return make_session(model, rec, index)


def warmth(t):
    return 25.0 + 30.0 * (1.0 - np.exp(-t / 8.0))


def searched(model, hidden, other="a", **how):
    fit, again = (recorded(model, k, 0.0, hidden, **how) for k in (0, 1))
    held = recorded(model, 2, 1.0, hidden, session=other, **how)
    problem = build_problem(model, [fit], [held], [again])
    fill_residuals(problem)
    return problem, Search(problem)


def nothing(t, q, v, a):
    return np.zeros_like(t)


def eccentric_of(search):
    return search.finish([Term("encoder_eccentricity", 0, (("order", 2.0),))], [[]], [])


def test_the_parts_of_a_real_eccentricity_agree(model):
    problem, search = searched(model, nothing, seen=lambda q: q - 0.02 * np.sin(2.0 * q + 0.5))
    assert disagreement(problem, search, eccentric_of(search)) is None


def test_an_inertia_that_changes_with_the_pose_lacks_the_weight_of_an_eccentricity(model):
    def posed(t, q, v, a):
        return 0.02 * (np.sin(q - 0.3) ** 2 * a + 0.5 * np.sin(2.0 * (q - 0.3)) * v**2)

    problem, search = searched(model, posed)
    said = disagreement(problem, search, eccentric_of(search))
    assert said is not None
    assert "encoder_eccentricity" in said


def test_friction_that_thins_with_temperature_is_named_with_its_coefficient(model):
    def thinner(t, q, v, a):
        return (np.exp(-0.03 * (warmth(t) - 25.0)) - 1.0) * (FRICTION * np.tanh(v / 0.01) + DAMPING * v)

    problem, search = searched(model, thinner)
    said = decide(problem, search)
    assert [e.name for e in said.effects] == ["thermal_drift"]
    assert said.effects[0].parameters["per_kelvin"]["value"] == pytest.approx(0.03, rel=0.1)


def test_thinning_friction_brings_what_the_model_lacks(model, tmp_path):
    bare = RigidModel(write_model(tmp_path / "bare.xml", friction=0.0, damping=DAMPING))
    shape = {"T": 20.0, "target": ALL, "k": 0.03}
    effect = catalogue()["thermal_drift"]
    theta = np.array([0.5, -0.2])
    assert effect.brings(Context(model, []), 0, shape, theta) == {}
    assert effect.brings(Context(bare, []), 0, shape, theta) == {"coulomb_friction": (1.0,)}


@pytest.mark.parametrize(("half", "brought"), [(0.3, set()), (-0.1, {"coulomb_friction"})])
def test_what_both_directions_have_is_friction_of_its_own(tmp_path, half, brought):
    bare = RigidModel(write_model(tmp_path / "bare.xml", friction=0.0, damping=DAMPING))
    theta = np.array([half, 0.05, 0.3, 0.2])
    found = catalogue()["asymmetric_friction"].brings(
        Context(bare, []), 0, {"dry": 1.0, "viscous": 1.0}, theta
    )
    assert found == dict.fromkeys(brought, (1.0, 0.0, 1.0, 0.0))


WIDTH = 0.02  # rad over which a bristle bends


def bends(t, q, v, a):
    """Dry friction that builds up over a small displacement, in place of the step at a reversal (Dahl)."""
    z = np.zeros_like(q)
    for i, step in enumerate(np.diff(q), start=1):
        end = np.sign(step)
        z[i] = end + (z[i - 1] - end) * np.exp(-abs(step) / WIDTH)
    return FRICTION * (z - np.tanh(v / 0.01))


@pytest.mark.parametrize("lacking", [False, True])
def test_friction_that_builds_up_brings_the_friction_that_a_model_lacks(model, tmp_path, lacking):
    rubs = RigidModel(write_model(tmp_path / "model.xml", 0.0, DAMPING)) if lacking else model
    problem, search = searched(rubs, bends)
    said = {e.name: e for e in decide(problem, search).effects}
    assert set(said) == {"presliding", *(["coulomb_friction"] if lacking else [])}
    if lacking:
        assert said["coulomb_friction"].parameters["level"]["value"] == pytest.approx(FRICTION, rel=0.05)


@pytest.mark.parametrize("lacking", [False, True])
def test_a_hump_at_low_speed_brings_the_dry_friction_that_a_model_lacks(model, tmp_path, lacking):
    def hump(t, q, v, a):
        return 0.25 * np.exp(-((v / 0.3) ** 2)) * np.tanh(v / 0.01)

    rubs = RigidModel(write_model(tmp_path / "model.xml", 0.0, DAMPING)) if lacking else model
    problem, search = searched(rubs, hump)
    said = {e.name: e for e in decide(problem, search).effects}
    assert set(said) == {"stribeck", *(["coulomb_friction"] if lacking else [])}
    if lacking:
        assert said["coulomb_friction"].parameters["level"]["value"] == pytest.approx(FRICTION, rel=0.05)


def test_thinning_is_named_where_friction_that_the_model_lacks_does_not_thin(tmp_path):
    """Of what the model lacks nothing thins, so that part of the thinning is zero; the thinning is not."""
    dry = RigidModel(write_model(tmp_path / "model.xml", FRICTION, 0.0))

    def hidden(t, q, v, a):
        warm = warmth(t) - 25.0
        return (np.exp(-0.04 * warm) - 1.0) * FRICTION * np.tanh(v / 0.01) + (0.1 + 0.003 * warm) * v

    said = decide(*searched(dry, hidden))
    assert {e.name for e in said.effects} == {"thermal_drift", "viscous_friction"}
    assert np.array_equal(next(e.theta for e in said.effects if e.name == "thermal_drift"), [0.0])


def test_a_turned_zero_beside_an_effect_is_no_mere_offset_of_the_effort(model):
    """On the sine of a load a turn is almost a constant: where it says clearly more than one, it is named."""
    problem, search = searched(model, bends, seen=lambda q: q - 0.01)
    names = [e.name for e in decide(problem, search).effects]
    assert "presliding" in names
    assert {"encoder_offset", "gravity_tilt"} & set(names)


def test_a_number_is_told_from_an_offset_only_above_a_floor_that_was_measured(model):
    problem, search = searched(model, bends, seen=lambda q: q - 0.01)
    solution = search.run()
    assert [t.effect for t in solution.terms] == ["presliding"]
    assert list(with_number(problem, search, solution))
    problem.floor_source = "estimated"
    assert not list(with_number(problem, search, solution))


def test_a_number_beside_an_effect_is_asked_for_at_every_trust_in_the_others(model):
    """The best by the rows fitted may predict held-out ones worse than the next, which is then the answer."""
    problem, search = searched(model, bends, seen=lambda q: q - 0.01)
    solution = search.run()
    found = list(with_number(problem, search, solution))
    turned = [x.terms[-1].effect for _, x in found]
    assert len(turned) > 1
    assert set(turned) <= {"encoder_offset", "gravity_tilt"}
    assert search.looseness == 1.0


def test_an_offset_of_the_effort_beside_an_effect_turns_nothing(model):
    problem, search = searched(model, lambda *motion: bends(*motion) + 0.03)
    assert [e.name for e in decide(problem, search).effects] == ["presliding"]


def test_a_model_with_wrong_damping_is_no_new_session(model):
    problem, search = searched(model, lambda t, q, v, a: -0.05 * DAMPING * v, other="b")
    assert problem.drift
    said = decide(problem, search)
    assert "session_friction" not in [e.name for e in said.effects]


def test_another_session_with_more_friction_is_named(model):
    def rubs(t, q, v, a):
        return 0.2 * (FRICTION * np.tanh(v / 0.01) + DAMPING * v)

    fit, again = (recorded(model, k, 0.0, nothing) for k in (0, 1))
    held = recorded(model, 2, 1.0, rubs, session="b")
    problem = build_problem(model, [fit], [held], [again])
    fill_residuals(problem)
    said = decide(problem, Search(problem))
    assert [e.name for e in said.effects] == ["session_friction"]
    assert said.effects[0].parameters["factor"]["value"] == pytest.approx(1.2, abs=0.03)


def test_a_small_delay_is_named_although_other_numbers_could_make_up_for_it(model):
    problem, search = searched(model, nothing, late=0.012)
    said = decide(problem, search)
    assert said.verdict == "physics_missing"
    assert said.effects[0].name in ("actuator_delay", "bandwidth", "clock_skew")


def test_what_predicts_worse_than_nothing_comes_last_and_gains_nothing():
    fits_only = Scored(Term("actuator_delay", 0), 50.0, 160.0, -0.7, np.zeros(0))
    predicts = Scored(Term("stribeck", 0), 40.0, 150.0, 0.45, np.zeros(0))
    first, last = Search._refuted_last([fits_only, predicts])
    assert first is predicts
    assert last.gain == 0.0
    assert first.gain == 150.0


def test_rivals_for_a_place_keep_their_distance_when_its_gain_is_weighed_anew():
    class Later(Search):
        completed = 1

        def __init__(self):
            pass

        def noise_level(self, terms):
            return 1.0

        def gain_of(self, chosen, i, noise):
            return 60.0

    own, rival = (
        Scored(Term(n, 0), g, g, 0.4, np.zeros(0))
        for n, g in (("coulomb_friction", 900.0), ("stribeck", 893.0))
    )
    _, slots = Later()._prune_completed([own.term], [[own, rival]])
    assert [s.gain for s in slots[0]] == [60.0, 53.0]


def test_friction_that_grows_with_warming_is_no_warming(model):
    _, search = searched(model, lambda t, q, v, a: 0.02 * t * np.tanh(v / 0.01))
    found = [s.term.effect for s in search.scan_profiled([])[0] if s.gain > 0.0]
    assert "thermal_drift" not in found
    _, search = searched(model, lambda t, q, v, a: -0.01 * t * np.tanh(v / 0.01))
    assert search.scan_profiled([])[0][0].term.effect == "thermal_drift"


@pytest.mark.parametrize(("share", "clear"), [(0.05, False), (0.2, True)])
def test_a_delay_beside_an_effect_has_to_predict(model, share, clear):
    _, search = searched(model, lambda t, q, v, a: 0.0 * t)
    first = Scored(Term("load_dependent_friction", 0), 200.0, 200.0, 0.5, np.zeros(0))
    late, rub = (
        Scored(Term(n, 0), 24.0, 24.0, share, np.zeros(0)) for n in ("clock_skew", "coulomb_friction")
    )
    assert search.clear(late, [[first]]) == clear
    assert search.clear(late, [])
    assert search.clear(rub, [[first]])


@pytest.mark.parametrize(("least", "clear"), [(1.0, True), (0.5, False)])
def test_beside_a_chaotic_effect_a_second_one_has_to_explain_about_as_much(model, monkeypatch, least, clear):
    _, search = searched(model, lambda t, q, v, a: 0.0 * t)
    first = Scored(Term("backlash", 0), 100.0, 100.0, 0.5, np.zeros(0))
    monkeypatch.setattr(type(search.effects["backlash"]), "explained_least", least)
    small, large = (Scored(Term("coulomb_friction", 0), g, g, 0.05, np.zeros(0)) for g in (40.0, 90.0))
    assert search.clear(small, [[first]]) == clear
    assert search.clear(large, [[first]])
    rich = [
        Scored(Term(n, 0), g, g, 0.1, np.zeros(0))
        for n, g in (("presliding", 810.0), ("coulomb_friction", 800.0))
    ]
    search._charge_containers(rich, [first.term])
    assert (rich[0].gain > rich[1].gain) == clear


def test_many_numbers_that_follow_the_friction_of_one_recording_do_not_hide_the_one_that_is_off(model):
    """They fit better together than a mass that is off, and predict the recording held out worse."""

    def heavier(t, q, v, a):
        return 0.02 * model.inverse(q[:, None], v[:, None], a[:, None])[:, 0]

    def rubs_less(t, q, v, a):
        return heavier(t, q, v, a) - 0.1 * FRICTION * np.tanh(v / 0.01)

    fit, again = (recorded(model, k, 0.0, rubs_less) for k in (0, 1))
    problem = build_problem(model, [fit], [recorded(model, 2, 1.0, heavier)], [again])
    fill_residuals(problem)
    said = decide(problem, Search(problem))
    assert said.verdict == "parameter_off"
    assert [p["name"] for p in said.parameters_off] == ["mass"]
    assert said.parameters_off[0]["to"] == pytest.approx(1.02 * said.parameters_off[0]["from"], rel=0.005)


def test_a_turn_that_stands_for_a_centre_of_mass_stays_behind_what_explains_more():
    def scored(effect, gain):
        return Scored(Term(effect, 0), gain, gain, 0.0, np.zeros(0))

    centre, friction, tilt = (
        scored("parameter:com_x@link", 9.0), scored("coulomb_friction", 8.5), scored("gravity_tilt", 5.3)
    )  # fmt: skip
    assert turned_not_shifted([centre, friction, tilt]) == [friction, tilt]
    assert turned_not_shifted([centre, tilt, friction]) == [tilt, friction]
    assert turned_not_shifted([centre, friction]) == [centre, friction]


@pytest.mark.parametrize(("more", "verdict"), [(1.0, "parameter_off"), (2.0, "physics_missing")])
def test_a_number_that_explains_nearly_all_stays_the_answer_though_something_small_is_left(
    model, more, verdict
):
    """A damping that is off, and a push that comes back in both runs: a fiftieth of its power."""

    def damped(t, q, v, a):
        return more * DAMPING * v + 0.06 * np.sin(4.0 * t + np.sin(0.9 * t))

    decision = decide(*searched(model, damped))
    assert decision.leftover > LEFTOVER_LIMIT
    assert decision.verdict == verdict
    named = [e.name for e in decision.effects] + [p["name"] for p in decision.parameters_off]
    assert named == ["damping" if verdict == "parameter_off" else "viscous_friction"]
