"""Arms whose description has no friction and wrong links; forces behind a gap; lines above the usual band."""

import numpy as np
import pytest

from s2r_host.gap.effects.backlash import behind_gap
from s2r_host.gap.effects.payload import add_mass
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import line_hz, make_session
from s2r_host.gap.motion.states import stop_operator
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.link_group import LINKS
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.search.complete import complete
from s2r_host.gap.search.search import Search

ARM_XML = """<mujoco><worldbody><body name="a"><joint name="j1" axis="0 0 1"{f}/>
<inertial mass="3" pos="0.1 0 0.1" diaginertia="0.02 0.02 0.02"/>
<body name="b" pos="0 0 0.2"><joint name="j2" axis="0 1 0"{f}/>
<inertial mass="{m}" pos="0.15 0 0.05" diaginertia="0.02 0.02 0.02"/>
<body name="c" pos="0.3 0 0"><joint name="j3" axis="0 1 0"{f}/>
<inertial mass="1" pos="0.1 0 0.02" diaginertia="0.005 0.005 0.005"/>
</body></body></body></worldbody></mujoco>"""
RUB = np.array([0.8, 0.0, 0.4])


def recorded(folder, seed, friction="", mass=2.0):
    """A 10 s recording of the arm with the friction of RUB, by plain inverse dynamics."""
    rng = np.random.default_rng(seed)
    (folder / "true.xml").write_text(ARM_XML.format(f=friction, m=mass))
    true = RigidModel(folder / "true.xml")
    t = np.arange(0, 10, 0.005)
    f = np.array([0.2, 0.5, 0.9])
    phase, size = rng.uniform(0, 6.28, (3, 3)), rng.uniform(0.15, 0.4, (3, 3))
    waves = 2 * np.pi * f[None, :, None] * t[None, None, :] + phase[:, :, None]
    w = 2 * np.pi * f[None, :, None]
    q, v, a = (
        np.sum(size[:, :, None] * x, axis=1).T
        for x in (np.sin(waves), w * np.cos(waves), -(w**2) * np.sin(waves))
    )
    tau = true.inverse(q, v, a) + RUB * np.tanh(v / 0.003) + 0.02 * rng.normal(size=q.shape)
    channels = {
        "q": {f"j{k + 1}": q[:, k] for k in range(3)},
        "dq": {f"j{k + 1}": v[:, k] for k in range(3)},
        "tau": {f"j{k + 1}": tau[:, k] for k in range(3)},
    }
    return Recording("rec", t, channels, Controller("none", {}, {}), "measured", "effort", "a", "", ())


def completed(folder, friction="", mass=2.0):
    record = recorded(folder, 0, mass=mass)
    (folder / "model.xml").write_text(ARM_XML.format(f=friction, m=2.0))
    model = RigidModel(folder / "model.xml")
    problem = build_problem(model, [make_session(model, record, 0)], [], [])
    search = Search(problem)
    terms, slots = complete(search)
    return terms, search.finish(terms, slots, []), slots


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    return completed(tmp_path_factory.mktemp("bare"), mass=2.8)


def test_friction_is_found_on_the_joints_that_have_it_and_on_no_other(bare):
    terms, solution, _ = bare
    levels = {
        t.joint: float(theta[0])
        for t, theta in zip(terms, solution.theta, strict=True)
        if t.effect != LINKS and t.effect != "viscous_friction"
    }
    assert set(levels) == {0, 2}
    assert levels[0] == pytest.approx(0.8, rel=0.15)
    assert levels[2] == pytest.approx(0.4, rel=0.15)


def test_a_link_forty_per_cent_too_light_is_a_matter_of_links(bare):
    assert LINKS in [t.effect for t in bare[0]]


def test_an_arm_that_has_friction_is_left_to_the_search(tmp_path):
    terms, _, _ = completed(tmp_path, friction=' frictionloss="0.5" damping="0.1"')
    assert terms == []


def test_levelling_the_joints_changes_no_trust_in_rows(tmp_path):
    record = recorded(tmp_path, 0, mass=2.8)
    (tmp_path / "model.xml").write_text(ARM_XML.format(f="", m=2.0))
    model = RigidModel(tmp_path / "model.xml")
    problem = build_problem(model, [make_session(model, record, 0)], [], [])
    trust, levelled = problem.trust.copy(), problem.weight.copy()
    block = problem.blocks[0]
    rows, every = np.full(len(problem.y), 0.3), np.ones(len(block.picks), dtype=bool)
    before = problem.rms(rows, block, every)
    complete(Search(problem))
    assert not np.allclose(problem.weight, levelled)
    assert np.array_equal(problem.trust, trust)
    assert problem.rms(rows, block, every) == before  # an effort is as large as it was


def test_nothing_comes_through_while_the_gap_is_crossed(tmp_path):
    record = recorded(tmp_path, 1)
    (tmp_path / "model.xml").write_text(ARM_XML.format(f="", m=2.0))
    s = make_session(RigidModel(tmp_path / "model.xml"), record, 0)
    z = stop_operator(s, 0, 0.05)
    assert np.abs(z).max() <= 1.0
    pull = behind_gap(z, 0.5)
    assert np.all(pull[np.abs(z) < 0.5] == 0.0)
    fast = np.abs(s.v[:, 0]) > 0.3
    far = np.abs(z) == 1.0
    assert np.all(np.sign(pull[far & fast]) == np.sign(s.v[far & fast, 0]))
    assert (far & fast).sum() > 100


def test_a_narrow_line_widens_the_band_and_noise_does_not():
    t = np.arange(0, 8, 0.001)
    noise = np.random.default_rng(2).normal(size=len(t))
    assert line_hz(np.sin(2 * np.pi * 61 * t) + 0.1 * noise, 0.001) == pytest.approx(61, abs=2)
    assert line_hz(noise, 0.001) == 0.0
    assert line_hz(np.sin(2 * np.pi * 3 * t) + 0.1 * noise, 0.001) == 0.0


def test_a_load_at_the_hand_is_no_matter_of_all_links(tmp_path):
    def loaded(seed):
        rng = np.random.default_rng(seed)
        record = recorded(tmp_path, seed)
        true = RigidModel(tmp_path / "true.xml")
        heavy = true.variant(lambda m: add_mass(m, 3, 0.6, np.array([0.2, 0.0, 0.04])))
        q = np.stack([record.channels["q"][j] for j in true.joints], axis=1)
        v = np.gradient(q, 0.005, axis=0)
        a = np.gradient(v, 0.005, axis=0)
        tau = true.inverse(q, v, a, heavy) + RUB * np.tanh(v / 0.003) + 0.02 * rng.normal(size=q.shape)
        for k, j in enumerate(true.joints):
            record.channels["tau"][j] = tau[:, k]
        return record

    (tmp_path / "model.xml").write_text(ARM_XML.format(f="", m=2.0))
    model = RigidModel(tmp_path / "model.xml")
    problem = build_problem(model, [make_session(model, loaded(1), 0)], [], [])
    search = Search(problem)
    terms, _ = complete(search)
    assert LINKS not in [t.effect for t in terms]
    best = max(search.scan(terms, 3.0)[0], key=lambda s: s.gain)
    assert best.term.effect == "payload"


def test_motors_are_found_on_all_joints_of_an_arm_that_has_none(tmp_path):
    friction = ' damping="0.1" frictionloss="0.3"'
    record = recorded(tmp_path, 0)
    motors = np.array([0.2, 0.1, 0.05])
    for k, (name, tau) in enumerate(record.channels["tau"].items()):
        v = record.channels["dq"][name]
        rubbed = tau + (0.3 - RUB[k]) * np.tanh(v / 0.003) + 0.1 * v
        record.channels["tau"][name] = rubbed + motors[k] * np.gradient(v, record.t)
    (tmp_path / "model.xml").write_text(ARM_XML.format(f=friction, m=2.0))
    model = RigidModel(tmp_path / "model.xml")
    search = Search(build_problem(model, [make_session(model, record, 0)], [], []))
    terms, slots = complete(search)
    assert sorted((t.effect, t.joint) for t in terms) == [("armature", k) for k in range(3)]
    theta = search.finish(terms, slots, []).theta
    assert [float(x[0]) for x in theta] == pytest.approx([motors[t.joint] for t in terms], rel=0.05)
