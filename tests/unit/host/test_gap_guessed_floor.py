"""One recording and no second run: what may pass for noise, and what may not."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.effects.base import Context
from s2r_host.gap.effects.saturation import EFFECT as SATURATION
from s2r_host.gap.motion.known_noise import motion_noise
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session, wrench_parts
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.floor import generic_leftovers
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.regression.rows import make_blocks
from s2r_host.gap.verdict import insufficient
from s2r_host.gap.verdict.insufficient import passes_for_noise, wide_guess

DT = 0.004
MASS, FRICTION, DAMPING = 3.0, 2.0, 4.0
DRAWER = f"""<mujoco><option gravity="0 0 0"/><worldbody><body name="front">
  <joint name="rail" type="slide" axis="1 0 0" frictionloss="{FRICTION}" damping="{DAMPING}"/>
  <inertial pos="0 0 0" mass="{MASS}" diaginertia=".1 .1 .1"/></body></worldbody></mujoco>"""
QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)
RACKING = 1.0  # friction per moment [1/m]


def strokes(offsets, reach=0.25, seconds=2.0):
    """There and back once for each offset: time, position, velocity, acceleration, and the offset, (time,) each."""
    t_one = np.arange(0.0, seconds, DT)
    x = t_one / seconds
    way = reach * (10 * x**3 - 15 * x**4 + 6 * x**5)
    q = np.concatenate([part for _ in offsets for part in (way, way[::-1])])
    v, t = np.gradient(q, DT), DT * np.arange(len(q))
    return t, q, v, np.gradient(v, DT), np.repeat(offsets, 2 * len(t_one))


def pulled(racking, offsets=(0.0, 0.06, -0.06, 0.12, -0.12, 0.03), noise=0.05):
    """A drawer pulled beside its centre; its effort is the wrench alone."""
    t, q, v, a, offset = strokes(offsets)
    way, pull = np.tanh(v / 1e-3), np.zeros(len(t))
    for _ in range(20):  # the moment follows the pull, which follows the friction
        pull = MASS * a + DAMPING * v + (FRICTION + racking * np.abs(pull * offset)) * way
    rng = np.random.default_rng(3)
    channels = {
        "q": {"rail": q + 2e-6 * rng.normal(size=len(t))},
        "dq": {"rail": v + 1e-4 * rng.normal(size=len(t))},
        "tau": {"rail": np.zeros(len(t))},
        "wrench": {
            "front.fx": pull + noise * rng.normal(size=len(t)),
            "front.mz": -pull * offset + 0.1 * noise * rng.normal(size=len(t)),
        },
    }
    return Recording("pulls", t, channels, Controller("none"), "measured", "effort", "a", "", ())


@pytest.fixture
def model(tmp_path):
    (tmp_path / "drawer.xml").write_text(DRAWER, encoding="utf-8")
    return RigidModel(tmp_path / "drawer.xml")


def written(rec, folder):
    columns = {"t": rec.t}
    for kind, joints in rec.channels.items():
        columns |= {f"{kind}.{name}": values for name, values in joints.items()}
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(folder / "rec.csv", table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    (folder / "rec.yaml").write_text("effort: measured\ninput: effort\n", encoding="utf-8")
    return folder / "rec.csv"


def test_a_drawer_that_jams_under_a_pull_beside_its_centre_has_play(model, tmp_path):
    path = written(pulled(RACKING), tmp_path)
    a = analyse(tmp_path / "drawer.xml", [path], [], [], QUICK, lambda _: None)
    assert a.verdict == "physics_missing", a.notes
    named = a.decision.effects[0]
    assert named.name == "joint_play"
    coefficient = named.parameters["coefficient"]
    assert coefficient["value"] == pytest.approx(RACKING, rel=0.1)
    assert coefficient["unit"] == "1/m"


def test_the_same_drawer_without_it_misses_nothing(model, tmp_path):
    path = written(pulled(0.0), tmp_path)
    a = analyse(tmp_path / "drawer.xml", [path], [], [], QUICK, lambda _: None)
    assert a.verdict == "nothing_missing", a.notes


def test_a_pull_along_the_rail_racks_by_its_moment_and_presses_on_nothing(model):
    s = make_session(model, pulled(0.0, noise=0.0), 0)
    parts = wrench_parts(model, s, 0)
    assert parts is not None
    offset = np.abs(strokes((0.0, 0.06, -0.06, 0.12, -0.12, 0.03))[4])
    assert parts.across.max() == pytest.approx(0.0, abs=1e-6 * np.abs(parts.along).max())
    assert parts.racking == pytest.approx(offset * np.abs(parts.along), abs=1e-6)


def test_few_columns_tell_the_size_of_the_noise_where_many_err_by_more(model):
    """A motion that passes its places twice: position bins learnt on one stretch predict the other badly."""
    t, q, v, a, _ = strokes((0.0,), reach=0.6, seconds=4.0)
    drag = 2.0 * v * np.abs(v)
    needed = MASS * a + DAMPING * v + FRICTION * np.tanh(v / 1e-3) + drag
    tau = needed + 0.3 * np.random.default_rng(1).normal(size=len(t))
    channels = {"q": {"rail": q}, "dq": {"rail": v}, "tau": {"rail": tau}}
    rec = Recording("r", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    s = make_session(model, rec, 0)
    blocks, raw = make_blocks(model, [s], [], [0])
    size, course = generic_leftovers(model, s, 0, raw[0], blocks[0].picks)
    assert np.std(size) < 0.95 * np.std(course)
    assert np.std(size) < 0.85 * np.std(raw[0])


@pytest.mark.parametrize(("noisy", "by_speed"), [("q", True), ("dq", False)])
def test_the_noise_of_an_acceleration_is_that_of_the_channel_it_is_made_from(model, noisy, by_speed):
    t, q, v, a, _ = strokes((0.0, 0.0, 0.0), reach=0.3, seconds=3.0)
    rng = np.random.default_rng(2)
    noise = {"q": 1e-3, "dq": 1.0}
    channels = {
        "q": {"rail": q + (noise["q"] if noisy == "q" else 1e-7) * rng.normal(size=len(t))},
        "dq": {"rail": v + (noise["dq"] if noisy == "dq" else 1e-3) * rng.normal(size=len(t))},
        "tau": {"rail": MASS * a + DAMPING * v},
    }
    rec = Recording("r", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    s = make_session(model, rec, 0)
    assert bool(s.by_speed[0]) == by_speed
    cut = float(s.cut[0])
    clean = MASS * 1e-3 * np.sqrt(2.0 * DT * (2.0 * np.pi) ** 2 * cut**3 / 3.0)  # of the quiet speed
    expected = clean if by_speed else 0.0
    assert motion_noise(model, s, 0) == pytest.approx(expected, rel=0.4, abs=0.05)


def test_a_drive_overcomes_the_friction_of_its_joint(model):
    ctx = Context(model, [make_session(model, pulled(0.0), 0)])
    held, drives = ({"limit": share * FRICTION, "v0": 0.0} for share in (1.01, 2.0))
    assert SATURATION.log_prior(ctx, 0, drives) == 0.0
    assert SATURATION.log_prior(ctx, 0, held) < -100.0


def test_a_wide_guess_asks_for_a_second_run(model):
    quiet, loud = (
        build_problem(model, [make_session(model, pulled(0.0, noise=n), 0)], [], []) for n in (1e-3, 1.0)
    )
    assert wide_guess(quiet) is None
    said = wide_guess(loud)
    assert said is not None
    assert "record the same motion once more and give it with --repeat" in said


@pytest.mark.parametrize(
    ("share", "times_known", "declared", "said"),
    [(0.1, 3.0, 0.0, True), (0.1, 1.5, 0.0, False), (0.03, 3.0, 0.0, False), (0.1, 3.0, 1.0, False)],
)
def test_nothing_is_not_missing_where_a_guess_is_far_above_all_known_noise(
    model, monkeypatch, share, times_known, declared, said
):
    problem = build_problem(model, [make_session(model, pulled(0.0), 0)], [], [])
    session = problem.ctx.sessions[0]
    floor = {0: share * float(np.std(session.u[:, 0]))}
    monkeypatch.setattr(insufficient, "known_noise", lambda *_: floor[0] / times_known)
    session.rec.effort_sigma["rail"] = declared * floor[0]
    found = passes_for_noise(replace(problem, floor=floor))
    assert (found is not None) == said
    assert found is None or "The noise that is known of is" in found
    assert passes_for_noise(replace(problem, floor=floor, floor_source="repeat")) is None
