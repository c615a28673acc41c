"""Several joints: rows of one joint only, noise of one joint only, what acts between joints."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import Context
from s2r_host.gap.effects.payload import add_mass
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.regression.solution import Scored, Term
from s2r_host.gap.search.outside import _explains, outside
from s2r_host.gap.search.scan import share_taken
from s2r_host.gap.search.search import Search
from s2r_host.gap.simulation.replay import Live, build_twin
from s2r_host.gap.verdict.decide import decide
from s2r_host.gap.verdict.where import locate, with_named

ARM_XML = """<mujoco><worldbody><body name="a"><joint name="j1" axis="0 1 0" damping="0.2" frictionloss="0.5"/>
<inertial mass="4" pos="0.2 0 0.1" diaginertia="0.03 0.03 0.03"/>
<body name="b" pos="0.4 0 0"><joint name="j2" axis="0 1 0" damping="0.02" frictionloss="0.05"/>
<inertial mass="0.4" pos="0.1 0 0.02" diaginertia="0.002 0.002 0.002"/>
</body></body></worldbody></mujoco>"""
ARM_AND_DRAWER = """<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0" damping="0.2"/>
<inertial mass="2" pos="0.2 0 0" diaginertia="0.02 0.02 0.02"/></body>
<body name="drawer"><joint name="rail" type="slide" damping="1"/><inertial mass="3" pos="0 0 0" diaginertia="1 1 1"/>
</body></worldbody></mujoco>"""
DT, NOISE = 0.005, np.array([0.1, 0.005])


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "model.xml"
    path.write_text(ARM_XML)
    return RigidModel(path)


def recorded(model, index, phase, hidden):
    """Twelve seconds of both joints; ``hidden(v, a)`` is effort beyond the model's, shape (time, 2)."""
    rng = np.random.default_rng(index)
    t = np.arange(0, 12, DT)
    q = np.stack(
        [
            0.6 * np.sin(1.3 * t + phase) + 0.2 * np.sin(4.1 * t),
            0.7 * np.sin(2.1 * t + 1.0) + 0.2 * np.sin(5.7 * t + phase),
        ],
        axis=1,
    )
    v = np.gradient(q, DT, axis=0)
    a = np.gradient(v, DT, axis=0)
    dry = model.model.dof_frictionloss * np.tanh(v / 0.01)
    tau = model.inverse(q, v, a) + dry + hidden(v, a) + NOISE * rng.normal(size=q.shape)
    channels = {
        kind: {j: x[:, k] for k, j in enumerate(model.joints)} for kind, x in (("q", q), ("tau", tau))
    }
    return Recording(f"r{index}", t, channels, Controller(), "measured", "effort", "a", "", ())


def searched(model, hidden):
    fit, again, held = (
        make_session(model, recorded(model, k, p, hidden), k) for k, p in ((0, 0.0), (1, 0.0), (2, 1.0))
    )
    return Search(build_problem(model, [fit], [held], [again]))


@pytest.fixture(scope="module")
def rubbing(model):
    return searched(model, lambda v, a: np.array([0.0, 0.2]) * np.tanh(v / 0.01))


def test_rows_of_one_joint_weigh_as_much_as_all_rows_with_zeros(rubbing):
    fit = ~rubbing.problem.held
    base = rubbing.marginal([], fit, 3.0)
    for name in ("coulomb_friction", "clock_skew", "actuator_delay"):
        term = rubbing.seeds((name, 1))[0]
        C, fixed, positive, _ = rubbing.matrix(term)
        whole = base.weigh(C[fit], positive, None if fixed is None else fixed[fit])
        short, prior = rubbing.weigh(base, fit, term)
        assert short.log_evidence(3.0, prior) == pytest.approx(whole.log_evidence(3.0, prior), rel=1e-9)


def test_normal_equations_built_term_by_term_give_the_same_coefficients(rubbing):
    terms = [
        Term("coulomb_friction", 1),
        rubbing.seeds(("actuator_delay", 0))[2],
        Term("viscous_friction", 0),
    ]
    x, left = rubbing.fitted(terms, 3.0)
    again, B, y, _ = rubbing.solve(terms, 3.0)
    assert x == pytest.approx(again, rel=1e-6, abs=1e-9)
    assert left == pytest.approx(y - B @ again, abs=1e-6)


def test_friction_on_a_light_wrist_is_found_beside_a_noisy_shoulder(rubbing):
    decision = decide(rubbing.problem, rubbing)
    assert [(e.name, e.joint) for e in decision.effects] == [("coulomb_friction", "j2")]
    assert decision.effects[0].theta[0] == pytest.approx(0.2, rel=0.15)


def test_a_load_is_told_at_the_joint_that_moves_it(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(ARM_AND_DRAWER)
    both = RigidModel(path)
    heavier = both.variant(lambda m: add_mass(m, both.model.body("arm").id, 1.0, np.array([0.3, 0.0, 0.0])))
    sessions = []
    for index, phase in enumerate((0.0, 0.0, 1.0)):
        rec = recorded(both, index, phase, lambda v, a: 0.0 * v)
        s = make_session(both, rec, index)
        load = both.inverse(s.q, s.v, s.a, heavier) - s.load
        tau = {j: x + load[:, k] for k, (j, x) in enumerate(rec.channels["tau"].items())}
        sessions.append(make_session(both, replace(rec, channels=rec.channels | {"tau": tau}), index))
    fit, again, held = sessions
    search = Search(build_problem(both, [fit], [held], [again]))
    decision = decide(search.problem, search)
    assert [(e.name, e.joint) for e in decision.effects] == [("payload", "hinge")]


def test_a_joint_at_its_noise_is_not_searched(rubbing):
    assert rubbing.quiet([]) == {0}
    assert {s.term.joint for s in rubbing.scan([], 3.0)[0]} <= {-1, 1}
    assert rubbing.quiet([Term("coulomb_friction", 1)]) == set()


def test_the_share_of_a_term_counts_on_its_own_joint():
    without, with_it = {0: 1e4, 1: 10.0}, {0: 1e4, 1: 4.0}
    assert share_taken(Term("cogging", 1), without, with_it) == pytest.approx(0.6)
    assert share_taken(Term("payload", -1), without, with_it) == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("joint", "gain", "share", "number", "named"),
    [
        (0, 138.0, 0.96, 3.0, True),
        (
            1,
            138.0,
            0.96,
            3.0,
            False,
        ),  # on the joint that has a name already, the floor holds what that leaves over
        (0, 15.0, 0.96, 3.0, False),
        (0, 138.0, 0.30, 3.0, False),
        (0, 138.0, 0.96, 130.0, False),
    ],
)
def test_under_a_guessed_floor_another_joint_s_effect_has_to_beat_every_wrong_number(
    rubbing, monkeypatch, joint, gain, share, number, named
):
    search = Search(replace(rubbing.problem, floor_source="estimated"))
    scanned = [
        Scored(Term("detent", joint), gain, gain, share, np.zeros(0)),
        Scored(Term("parameter:mass@a", -1), number, number, 0.1, np.zeros(0)),
    ]
    monkeypatch.setattr(search, "scan_profiled", lambda _: (scanned, 3.0))
    assert search.stands_out([Term("coulomb_friction", 1)], [[]]) == named
    assert not search.stands_out([Term("payload", -1)], [[]])  # acts on every joint


def test_motors_that_turn_together_are_felt_by_both(model):
    search = searched(model, lambda v, a: 0.012 * a[:, ::-1] + 0.01 * v[:, ::-1])
    solution = search.run()
    first = solution.terms[0]
    assert (first.effect, first.joint, dict(first.shape)["mutual"]) == ("motor_coupling", 1, 1.0)
    assert solution.theta[0][0] == pytest.approx(0.012, rel=0.1)
    twin = build_twin(
        model, search.problem.ctx, [Live(first.effect, first.joint, dict(first.shape), solution.theta[0])]
    )
    assert {live.joint for live in twin.live} == {0, 1}


def test_a_motor_that_another_joint_turns_along_is_named_at_that_joint_with_what_it_feels_alone(model):
    rotor, gear, drag = 0.02, 0.7, 0.02

    def hidden(v, a):
        """Of T = J (dq_2 + c dq_1)² / 2, the motor's own inertia and drag at joint 2 left out."""
        of_first = (
            rotor * gear * a[:, 1] + rotor * gear**2 * a[:, 0] + drag * gear * (v[:, 1] + gear * v[:, 0])
        )
        return np.stack([of_first, rotor * gear * a[:, 0] + drag * gear * v[:, 0]], axis=1)

    search = searched(model, hidden)
    decision = decide(search.problem, search)
    assert [(e.name, e.joint) for e in decision.effects] == [("motor_coupling", "j1")]
    found = {name: p["value"] for name, p in decision.effects[0].parameters.items()}
    assert found["inertia"] == pytest.approx(rotor * gear, rel=0.05)
    assert found["own_inertia"] == pytest.approx(rotor * gear**2, rel=0.3)
    assert not decision.parameters_off


def test_the_effort_of_a_joint_in_another_s_is_cross_talk_and_no_effect(model):
    search = searched(model, lambda v, a: 0.0 * a)
    efforts = {b.session.index: b.session.u[:, 0] for b in search.problem.blocks if b.joint == 1}
    search.problem.y += search.problem.whiten({k: 0.02 * u for k, u in efforts.items()}, 1)
    imitation = search.finish([Term("viscous_friction", 1)], [], [])
    said = outside(search.problem, search, imitation, strained=False)
    assert said is not None
    assert said.startswith("2.0% of the effort of 'j1' in that of 'j2'")


@pytest.mark.parametrize(("source", "said"), [("repeat", True), ("estimated", False)])
def test_under_a_guessed_floor_cross_talk_has_to_explain_as_much_as_the_name(rubbing, source, said):
    """What is below a floor that was guessed far too high is not yet explained."""
    floor = {j: 1e3 * x for j, x in rubbing.problem.floor.items()}
    problem = replace(rubbing.problem, floor=floor, floor_source=source)
    cause, named, nothing = (share * problem.raw for share in (0.5, 0.2, 1.0))
    assert _explains(problem, 1, cause, named, nothing, likely=True) == said


def test_friction_is_no_cross_talk(rubbing):
    named = rubbing.finish([Term("coulomb_friction", 1)], [], [])
    assert outside(rubbing.problem, rubbing, named, strained=True) is None


def test_drag_of_a_fluid_is_not_viscous_friction_and_more(model):
    search = searched(model, lambda v, a: np.array([0.0, 0.04]) * v * np.abs(v))
    imitation = search.finish([Term("viscous_friction", 1), search.seeds(("stribeck", 1))[0]], [], [])
    said = outside(search.problem, search, imitation, strained=False)
    assert said is not None
    assert "drag of a fluid" in said


@pytest.mark.parametrize("order", [1, 3])
def test_an_inertia_that_changes_with_the_pose_is_not_what_imitates_it(model, order):
    sessions = []
    for index, phase in enumerate((0.0, 0.0, 1.0)):
        rec = recorded(model, index, phase, lambda v, a: 0.0 * v)
        s = make_session(model, rec, index)
        q, v, a = s.q[:, 1], s.v[:, 1], s.a[:, 1]
        extra = 0.004 * (a * (1.0 + np.cos(order * q)) - 0.5 * order * np.sin(order * q) * v**2)
        tau = rec.channels["tau"] | {"j2": rec.channels["tau"]["j2"] + extra}
        sessions.append(make_session(model, replace(rec, channels=rec.channels | {"tau": tau}), index))
    fit, again, held = sessions
    search = Search(build_problem(model, [fit], [held], [again]))
    imitation = search.finish([Term("armature", 1), search.seeds(("encoder_eccentricity", 1))[0]], [], [])
    said = outside(search.problem, search, imitation, strained=False)
    assert said is not None
    assert "an inertia that changes with the pose" in said


def test_a_motor_s_inertia_beside_a_number_is_no_inertia_that_changes_with_the_pose(model):
    """A constant inertia is what the catalogue knows; the pose has to explain what it leaves over."""
    search = searched(model, lambda v, a: np.array([0.0, 0.01]) * a)
    named = search.finish([Term("armature", 1), Term("effort_scale", 1)], [], [])
    assert outside(search.problem, search, named, strained=True) is None


def test_a_motor_s_inertia_beside_a_detent_is_no_inertia_that_changes_with_the_pose(model):
    sessions = []
    for index, phase in enumerate((0.0, 0.0, 1.0)):
        rec = recorded(model, index, phase, lambda v, a: np.array([0.0, 0.004]) * a)
        s = make_session(model, rec, index)
        tau = rec.channels["tau"] | {"j2": rec.channels["tau"]["j2"] + 0.05 * np.sin(6.0 * s.q[:, 1])}
        sessions.append(make_session(model, replace(rec, channels=rec.channels | {"tau": tau}), index))
    fit, again, held = sessions
    search = Search(build_problem(model, [fit], [held], [again]))
    solution = search.run()
    assert {t.effect for t in solution.terms if t.joint == 1} & {"cogging", "detent"}
    assert outside(search.problem, search, solution, strained=True) is None


@pytest.mark.parametrize(
    ("drag", "strained", "said"), [(0.04, True, True), (0.04, False, True), (0.0, False, False)]
)
def test_one_name_that_leaves_nothing_over_gives_way_only_to_a_clearly_better_drag(
    model, drag, strained, said
):
    def hidden(v, a):
        return np.array([0.0, drag]) * v * np.abs(v) + np.array([0.0, 0.05 if drag == 0.0 else 0.0]) * v

    search = searched(model, hidden)
    alone = search.finish([Term("viscous_friction", 1)], [], [])
    found = outside(search.problem, search, alone, strained=strained)
    assert (found is not None and "drag of a fluid" in found) == said


@pytest.mark.parametrize(("share", "said"), [(0.79, True), (0.81, False)])
def test_what_is_not_likely_has_to_leave_clearly_less(rubbing, share, said):
    cause, named, nothing = (x * rubbing.problem.raw for x in (np.sqrt(share * 0.1), np.sqrt(0.1), 1.0))
    assert _explains(rubbing.problem, 1, cause, named, nothing, likely=False) == said


def test_a_late_position_is_felt_by_every_joint(model):
    s = make_session(model, recorded(model, 0, 0.0, lambda v, a: 0.0 * v), 0)
    ctx = Context(model, [s])
    lag = 0.006
    said = catalogue()["clock_skew"].columns(ctx, s, 1, {"lag": lag}).fixed
    q, v, a = s.q.copy(), s.v.copy(), s.a.copy()
    for x in (q, v, a):
        x[:, 1] = np.interp(s.t + lag, s.t, x[:, 1])
    true = model.inverse(q, v, a) - s.load
    inner = slice(20, -20)
    assert np.max(np.abs(said[inner, 0])) > 0
    assert said[inner] == pytest.approx(true[inner], abs=0.03 * float(np.max(np.abs(true[inner]))))


def test_a_load_may_hang_far_beyond_the_hand_of_an_arm(model):
    s = make_session(model, recorded(model, 0, 0.0, lambda v, a: 0.0 * v), 0)
    reaches = {shape["reach"] for shape in catalogue()["payload"].shapes(Context(model, [s]), -1)}
    assert max(reaches) >= 5.0


def test_columns_of_terms_are_stored_for_their_joint_only(rubbing):
    stored = rubbing.stored(Term("coulomb_friction", 1))
    assert stored.joint == 1
    assert len(stored.C) == len(rubbing.rows_of[1]) < len(rubbing.problem.y)


def test_the_joint_of_what_was_named_comes_first(rubbing):
    problem = rubbing.problem
    decision = decide(problem, rubbing)
    shoulder_first = [
        replace(p, share=s) for p, s in zip(locate(problem, problem.raw), (0.1, 0.9), strict=False)
    ]
    places = with_named(problem, problem.raw, sorted(shoulder_first, key=lambda p: -p.share), decision)
    assert places[0].joint == "j2"
    only_shoulder = [p for p in places if p.joint == "j1"]
    assert [p.joint for p in with_named(problem, problem.raw, only_shoulder, decision)][-1] == "j2"


def test_one_wrong_number_of_an_arm_is_looked_for_although_loose_numbers_hide_it(rubbing, monkeypatch):
    monkeypatch.setattr("s2r_host.gap.verdict.decide.base_matters", lambda *_: False)
    monkeypatch.setattr(rubbing, "at_floor", lambda _: False)
    monkeypatch.setattr(rubbing, "comes_back", lambda _: False)
    monkeypatch.setattr(rubbing, "run", lambda look: rubbing.finish([], [], []))
    decision = decide(rubbing.problem, rubbing)
    assert [(e.name, e.joint) for e in decision.effects] == [("coulomb_friction", "j2")]


def test_what_a_heavier_link_does_is_no_noise_of_a_guessed_floor(model, tmp_path):
    (tmp_path / "heavy.xml").write_text(ARM_XML.replace('mass="0.4"', 'mass="1.2"'))
    heavy = RigidModel(tmp_path / "heavy.xml")
    as_stated, as_built = (
        build_problem(model, [make_session(model, recorded(m, 0, 0.0, lambda v, a: 0.0 * v), 0)], [], [])
        for m in (model, heavy)
    )
    for j in (0, 1):
        assert (
            as_built.floor[j] < 1.1 * as_stated.floor[j]
        )  # no shape of one joint's own motion follows it: 3 times
