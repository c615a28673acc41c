"""Noise floors without a second run: bounded by the channels' own noise, and blind to rests."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.effects.armature import EFFECT as ARMATURE
from s2r_host.gap.effects.base import IMPOSSIBLE, Context
from s2r_host.gap.motion.known_noise import known_noise, motion_noise
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.rest import rests_of, stillness
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.floor import without_rests
from s2r_host.gap.regression.friction_seen import dry_level, trust
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.regression.rows import band, compare, make_blocks

DT, STEP = 0.004, 0.001
INERTIA, FRICTION, DAMPING = 0.035, 0.05, 0.01
TABLE = f"""<mujoco><worldbody><body><joint name="table" damping="{DAMPING}" frictionloss="{FRICTION}"/>
  <geom type="cylinder" size=".2 .02" mass="1"/><inertial pos="0 0 0" mass="1" diaginertia=".02 .02 {INERTIA}"/>
</body></worldbody></mujoco>"""
QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)


def turned(extra, waypoints, noise=0.006, top=0.6, seed=1):
    """A turntable under PD from place to place [rad], with a torque ``extra(q, dq)`` that its model lacks."""
    rng, rows = np.random.default_rng(seed), []
    command = np.concatenate(
        [
            np.full(60, waypoints[0]),
            *(stroke(a, b, top) for a, b in itertools.pairwise(waypoints)),
        ]
    )
    q, dq = float(command[0]), 0.0
    speed = np.gradient(command, STEP)
    for k, (q_cmd, dq_cmd) in enumerate(zip(command, speed, strict=True)):
        u = 10.0 * (q_cmd - q) + 0.7 * (dq_cmd - dq)
        if k % round(DT / STEP) == 0:
            rows.append((k * STEP, q, dq + 0.003 * rng.normal(), u + noise * rng.normal(), q_cmd, dq_cmd))
        free = dq + STEP * (u + extra(q, dq) - DAMPING * dq) / INERTIA
        dq = np.sign(free) * max(abs(free) - STEP * FRICTION / INERTIA, 0.0)
        q += STEP * dq
    return np.array(rows)


def stroke(a, b, top):
    """A smooth way from a to b at up to ``top`` rad/s, then a stop of 0.2 s."""
    share = np.linspace(0.0, 1.0, max(2, round(1.5 * abs(b - a) / top / STEP)))
    return np.concatenate([a + (b - a) * (3.0 * share**2 - 2.0 * share**3), np.full(200, b)])


def answered(folder: Path, rows: np.ndarray):
    """What the tool says of one recording."""
    (folder / "table.xml").write_text(TABLE, encoding="utf-8")
    names = "t,q.table,dq.table,tau.table,q_cmd.table,dq_cmd.table"
    np.savetxt(folder / "rec.csv", rows, delimiter=",", header=names, comments="", fmt="%.9g")
    (folder / "rec.yaml").write_text(
        "controller: {type: pd, kp: {table: 10.0}, kd: {table: 0.7}, rate_hz: 1000}\neffort: measured\ninput: q_cmd\n",
        encoding="utf-8",
    )
    return analyse(folder / "table.xml", [folder / "rec.csv"], [], [], QUICK, lambda _: None)


FAR = (0.0, 3.0, -1.0, 2.0, 0.0)


def test_an_effect_finer_than_the_generic_correction_is_not_taken_for_noise(tmp_path):
    a = answered(tmp_path, turned(lambda q, dq: 0.08 * np.sin(14.0 * q + 0.7), FAR))
    assert a.problem.floor[0] < 0.02  # what a generic correction leaves over is 0.055
    assert a.verdict == "physics_missing"
    assert [e.name for e in a.decision.effects][:1] == ["cogging"]


def test_a_joint_that_rests_for_most_of_the_time_misses_nothing(tmp_path):
    rows = turned(lambda q, dq: 0.0, (0.0, 0.8, -0.5, 1.2, 0.1, 0.6, 0.0))
    late = rows[-1, 0] + DT * np.arange(1, 1 + 2 * len(rows))
    held = np.tile(
        rows[-1], (len(late), 1)
    )  # stopped short of its target, with the effort that friction holds
    held[:, 0] = late
    held[:, 3] = 0.8 * FRICTION + 0.006 * np.random.default_rng(3).normal(size=len(late))
    held[:, 4] = held[:, 1] + 0.08 * FRICTION
    held[:, 2] = 0.003 * np.random.default_rng(4).normal(size=len(late))
    a = answered(tmp_path, np.concatenate([rows, held]))
    assert a.verdict == "nothing_missing", a.notes


def test_the_noise_of_the_channels_is_known_from_what_lies_above_the_motion(tmp_path):
    (tmp_path / "table.xml").write_text(TABLE, encoding="utf-8")
    model = RigidModel(tmp_path / "table.xml")
    t = np.arange(0.0, 20.0, DT)
    q = np.sin(2.0 * t)
    rng = np.random.default_rng(5)
    load = model.inverse(
        q[:, None], np.gradient(q, DT)[:, None], np.gradient(np.gradient(q, DT), DT)[:, None]
    )
    for effort, speed in ((0.05, 1e-4), (1e-3, 0.02)):
        channels = {
            "q": {"table": q + 1e-4 * rng.normal(size=len(t))},
            "dq": {"table": np.gradient(q, DT) + speed * rng.normal(size=len(t))},
            "tau": {"table": load[:, 0] + effort * rng.normal(size=len(t))},
        }
        rec = Recording("r", t, channels, Controller("none"), "measured", "effort", "a", "", ())
        s = make_session(model, rec, 0)
        cut = float(s.cut[0])
        by_effort = effort * np.sqrt(2.0 * DT * cut)
        by_speed = INERTIA * speed * np.sqrt(2.0 * DT * (2.0 * np.pi) ** 2 * cut**3 / 3.0)
        assert known_noise(model, s, 0) == pytest.approx(np.hypot(by_effort, by_speed), rel=0.3)


def test_channels_without_noise_bound_nothing(tmp_path):
    (tmp_path / "table.xml").write_text(TABLE, encoding="utf-8")
    model = RigidModel(tmp_path / "table.xml")
    t = np.arange(0.0, 8.0, DT)
    channels = {"q": {"table": np.zeros(len(t))}, "tau": {"table": np.zeros(len(t))}}
    rec = Recording("r", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    assert known_noise(model, make_session(model, rec, 0), 0) == 0.0


def test_friction_shows_in_a_free_swing_that_nothing_drives(tmp_path):
    (tmp_path / "p.xml").write_text(
        """<mujoco><worldbody><body><joint name="pivot" axis="0 1 0" damping=".01"/>
        <geom type="sphere" size=".02" pos="0 0 -.3" mass="1"/></body></worldbody></mujoco>""",
        encoding="utf-8",
    )
    inertia, dt = 1.0 * 0.3**2 + 0.4 * 0.02**2, 1.0 / 240.0
    for name, start in (("a", 1.2), ("b", -0.8)):
        q, dq, rows = start, 0.0, []
        for k in range(12 * 960):
            if k % 4 == 0:
                rows.append((k * dt / 4, round(q / 7.7e-4) * 7.7e-4, 0.0))
            free = dq + dt / 4 * (-9.81 * 0.3 * np.sin(q) - 0.01 * dq) / inertia
            dq = np.sign(free) * max(abs(free) - dt / 4 * 0.05 / inertia, 0.0)
            q += dt / 4 * dq
        header = "t,q.pivot,tau.pivot"
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header=header, comments="", fmt="%.9g")
    a = analyse(tmp_path / "p.xml", [tmp_path / "a.csv"], [tmp_path / "b.csv"], [], QUICK, lambda _: None)
    assert a.verdict == "physics_missing", a.notes
    assert a.decision.effects[0].name in ("coulomb_friction", "asymmetric_friction")


def test_a_log_in_which_nothing_happens_is_insufficient(tmp_path):
    rows = np.zeros((2000, 6))
    rows[:, 0] = DT * np.arange(2000)
    a = answered(tmp_path, rows)
    assert a.verdict == "insufficient"
    assert "moves 0 rad only" in a.notes[0]


def slow_turning(folder, speed_noise, model_text=TABLE):
    """A slow clean turn, logged at 100 Hz with a noisy speed; model and session."""
    (folder / "table.xml").write_text(model_text, encoding="utf-8")
    model = RigidModel(folder / "table.xml")
    rng, dt = np.random.default_rng(6), 0.01
    t = np.arange(0.0, 20.0, dt)
    q = 0.7 * np.sin(0.5 * t)
    v, a = 0.35 * np.cos(0.5 * t), -0.175 * np.sin(0.5 * t)
    tau = model.inverse(q[:, None], v[:, None], a[:, None])[:, 0] + FRICTION * np.tanh(v / 1e-3)
    channels = {
        "q": {"table": q + 3e-5 * rng.normal(size=len(t))},
        "dq": {"table": v + speed_noise * rng.normal(size=len(t))},
        "tau": {"table": tau + 1e-4 * rng.normal(size=len(t))},
    }
    rec = Recording("r", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    return model, make_session(model, rec, 0)


def test_a_guessed_floor_is_not_below_the_noise_of_the_motion(tmp_path):
    model, s = slow_turning(tmp_path, 2e-3)
    shown = motion_noise(model, s, 0, sure=True)
    floor = build_problem(model, [s], [], []).floor[0]
    assert shown > 0.0
    assert floor >= 0.95 * motion_noise(model, s, 0, sure=True)  # a generic correction leaves half of it over


def coarse_turning(folder, index, off):
    """A turn read in steps of 0.2 mrad, up to ``off`` steps from where it was asked for, with a line at 18 Hz."""
    (folder / "table.xml").write_text(TABLE, encoding="utf-8")
    model, step, dt = RigidModel(folder / "table.xml"), 2e-4, 0.004
    t = np.arange(0.0, 16.0, dt)
    q = 0.7 * np.sin(1.5 * t) + 0.3 * np.sin(3.1 * t) + off * step * np.sin(0.4 * t)
    v = np.gradient(q, dt)
    tau = model.inverse(q[:, None], v[:, None], np.gradient(v, dt)[:, None])[:, 0] + FRICTION * np.tanh(
        v / 1e-3
    )
    tau += 0.02 * np.sin(36.0 * np.pi * t) + 2e-3 * np.random.default_rng(index).normal(size=len(t))
    channels = {"q": {"table": step * np.round(q / step)}, "tau": {"table": tau}}
    rec = Recording(f"r{index}", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    return model, make_session(model, rec, index)


def test_the_steps_of_an_encoder_that_two_runs_have_alike_are_noise(tmp_path):
    model, first = coarse_turning(tmp_path, 0, 0.0)
    _, again = coarse_turning(tmp_path, 1, 0.3)
    problem = build_problem(model, [first], [], [again])
    assert problem.floor_source == "repeat"
    assert problem.floor[0] >= 0.99 * motion_noise(model, first, 0, sure=True)
    assert problem.alike[0] > 0.2  # of its power, which half the difference of the runs does not show


def test_lost_rows_are_no_noise(tmp_path):
    (tmp_path / "table.xml").write_text(TABLE, encoding="utf-8")
    model, step, dt = RigidModel(tmp_path / "table.xml"), 2e-5, 0.004
    rng = np.random.default_rng(3)
    even = np.arange(0.0, 16.0, dt)
    kept = np.sort(rng.choice(len(even), size=int(0.94 * len(even)), replace=False))
    kept[0] = 0
    shown = []
    for t in (even, even[kept]):
        q = 0.7 * np.sin(1.5 * t) + 0.3 * np.sin(3.1 * t)
        channels = {"q": {"table": step * np.round(q / step)}, "tau": {"table": np.zeros(len(t))}}
        rec = Recording("r", t, channels, Controller("none"), "measured", "effort", "a", "", ())
        shown.append(motion_noise(model, make_session(model, rec, 0), 0))
    assert shown[1] == pytest.approx(shown[0], rel=0.2)


def test_an_acceleration_that_is_noise_tells_no_inertia(tmp_path):
    for speed_noise in (2e-3, 2e-2):
        model, s = slow_turning(tmp_path, speed_noise)
        assert not Context(model, [s]).accelerates(0)
        assert ARMATURE.log_prior(Context(model, [s]), 0, {}) == IMPOSSIBLE
    model, s = stopping(tmp_path, (FRICTION, FRICTION))
    assert ARMATURE.log_prior(Context(model, [s]), 0, {}) == 0.0


def test_motion_that_still_falls_above_its_band_is_no_noise(tmp_path):
    (tmp_path / "table.xml").write_text(TABLE, encoding="utf-8")
    model = RigidModel(tmp_path / "table.xml")
    t = np.arange(0.0, 20.0, 0.02)
    q = np.cumsum(np.cumsum(np.random.default_rng(7).normal(size=len(t)))) * 1e-4
    channels = {"q": {"table": q}, "tau": {"table": np.zeros(len(t))}}
    s = make_session(
        model, Recording("r", t, channels, Controller("none"), "measured", "effort", "a", "", ()), 0
    )
    assert motion_noise(model, s, 0) > 0.0
    assert motion_noise(model, s, 0, sure=True) == 0.0


def test_friction_of_a_free_swing_is_seen_although_its_load_is_all_that_is_left_over(tmp_path):
    weight, inertia, friction = 2.0, 0.05, 0.1
    path = tmp_path / "swing.xml"
    path.write_text(
        """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>
        <inertial pos="0 0 -.1" mass="2.0387" diaginertia=".0296 .0296 .01"/></body></worldbody></mujoco>""",
        encoding="utf-8",
    )
    q, dq, rows = 1.4, 0.0, []
    for k in range(8000):
        if k % 4 == 0:
            rows.append((k * STEP, q, dq))
        free = dq - STEP * weight * np.sin(q) / inertia
        dq = np.sign(free) * max(abs(free) - STEP * friction / inertia, 0.0)
        q += STEP * dq
    t, turned_by, speed = np.array(rows).T
    channels = {"q": {"hinge": turned_by}, "dq": {"hinge": speed}, "tau": {"hinge": np.zeros(len(t))}}
    model = RigidModel(path)
    law = Controller("none", {}, {}, {}, None)
    s = make_session(model, Recording("swing", t, channels, law, "measured", "effort", "a", "", ()), 0)
    assert dry_level(s, 0) == pytest.approx(friction, rel=0.2)
    assert not s.driven(0)


def test_what_feedback_makes_of_a_noisy_speed_is_left_out_of_the_band(tmp_path):
    model, s = slow_turning(tmp_path, 5e-3)
    channels, t = s.rec.channels, s.rec.t
    noise = channels["dq"]["table"] - 0.35 * np.cos(0.5 * t)
    fed_back = {"table": channels["tau"]["table"] - 2.0 * noise}
    rec = replace(s.rec, channels=channels | {"tau": fed_back})
    problem = build_problem(model, [make_session(model, rec, 0)], [], [])
    assert problem.blocks[0].session.cut[0] < 10.0


@pytest.mark.parametrize("guessed", [False, True])
def test_the_band_does_not_widen_with_the_number_of_recordings(tmp_path, guessed):
    path = tmp_path / "table.xml"
    path.write_text(TABLE)
    model, t, tones = (
        RigidModel(path),
        np.arange(0, 20, DT),
        np.array([0.3, 0.7, 1.3, 2.1, 3.3, 4.7, 6.1, 8.3, 11.0]),
    )
    q = np.sum(
        0.6 / (1.0 + tones**4) * np.sin(2.0 * np.pi * np.outer(t, tones) + np.arange(len(tones))), axis=1
    )
    tau = INERTIA * np.gradient(np.gradient(q, DT), DT) + 0.01 * np.random.default_rng(1).normal(size=len(t))
    channels = {"q": {"table": q}, "tau": {"table": tau}}
    rec = Recording("r", t, channels, Controller(), "measured", "effort", "a", "", ())
    fit = [make_session(model, rec, k) for k in range(8)]
    blocks, raw = make_blocks(model, fit, [], [0])
    alone, together = (band(model, 0, fit[:n], blocks[:n], raw[:n], guessed=guessed) for n in (1, len(fit)))
    assert alone < 20.0
    assert together == alone


@pytest.fixture
def swing(tmp_path):
    """A pendulum let go, as its encoder and an idle torque sensor show it until long after friction has stopped it."""
    path = tmp_path / "swing.xml"
    path.write_text(
        """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping=".05" frictionloss=".1"/>
        <inertial pos="0 0 -.2" mass="2.03874" diaginertia=".0184504 .0184504 .01"/></body></worldbody></mujoco>""",
        encoding="utf-8",
    )
    rng, rows = np.random.default_rng(1), []
    q, dq = 1.2, 0.0
    for k in range(24 * 1000):
        if k % 4 == 0:
            rows.append((k * STEP, q + 5e-5 * rng.normal(), dq + 2e-3 * rng.normal(), 1e-4 * rng.normal()))
        free = dq - STEP * (4.0 * np.sin(q) + 0.05 * dq) / 0.1
        dq = np.sign(free) * max(abs(free) - STEP * 0.1 / 0.1, 0.0)
        q += STEP * dq
    t, turned_by, speed, effort = np.array(rows).T
    channels = {"q": {"hinge": turned_by}, "dq": {"hinge": speed}, "tau": {"hinge": effort}}
    model = RigidModel(path)
    rec = Recording("swing", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    return model, make_session(model, rec, 0)


def test_the_floor_of_a_free_swing_is_read_from_what_gravity_and_inertia_balance(swing):
    model, s = swing
    floor = build_problem(model, [s], [], [replace(s, index=1)]).floor[0]
    assert floor >= 1.9e-3 * np.std(s.mass[:, 0] * s.a[:, 0])


def test_where_friction_stops_a_free_swing_says_little_although_it_comes_back(swing):
    model, s = swing
    block = build_problem(model, [s], [], [replace(s, index=1)]).blocks[0]
    stopped = s.t[block.picks] > 8.0
    assert np.max(trust(model, block, 1e-3)[stopped]) < 0.01  # of 0.1 N·m of friction


def test_a_rest_at_the_end_is_not_all_that_is_held_out(swing):
    model, s = swing
    block = build_problem(model, [s], [], []).blocks[0]
    held = np.abs(s.v[block.picks, 0][block.held])
    assert np.mean(held > 0.1) > 0.05
    assert np.mean(np.abs(s.v[block.picks, 0][~block.held]) > 0.1) > 0.5


def test_filters_that_ring_beside_a_turn_make_no_row_certain(tmp_path):
    model, s = slow_turning(tmp_path, 1e-4)
    block = build_problem(model, [s], [], [replace(s, index=1)]).blocks[0]
    still = compare(stillness(s, 0), s, 0, True)[block.picks]
    assert np.min(still) < -0.01
    assert np.max(trust(model, block, 1e-5)[still < -0.01]) < 0.2


def stopping(folder: Path, friction: tuple[float, float], rest_s: float = 0.5):
    """A table moved to and fro with rests in between, under friction (forth, back) [N·m]; model, session, rows."""
    (folder / "table.xml").write_text(TABLE, encoding="utf-8")
    rng, way = np.random.default_rng(4), []
    for a, b in itertools.pairwise((0.0, 1.5, -0.5, 2.0, 0.3, -1.2, 0.9, 0.0)):
        share = np.linspace(0.0, 1.0, 300)
        way += [a + (b - a) * (3.0 * share**2 - 2.0 * share**3), np.full(round(rest_s / DT), b)]
    q = np.concatenate(way)
    t, v = DT * np.arange(len(q)), np.gradient(q, DT)
    a = np.gradient(v, DT)
    # At rest friction holds whatever the drive still asks for, another amount each time.
    rests = np.abs(v) < 1e-9
    starts = np.cumsum(np.diff(rests.astype(int), prepend=0) == 1)
    held = rng.uniform(-max(friction), max(friction), starts.max() + 1)[starts]
    dry = np.where(rests, held, np.where(v > 0, friction[0], -friction[1]))
    u = INERTIA * a + DAMPING * v + dry + 0.002 * rng.normal(size=len(q))
    channels = {"q": {"table": q}, "dq": {"table": v}, "tau": {"table": u}}
    rec = Recording("r", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    model = RigidModel(folder / "table.xml")
    return model, make_session(model, rec, 0)


def test_what_friction_holds_at_rest_does_not_raise_the_floor_of_the_rows_that_move(tmp_path):
    model, session = stopping(tmp_path, (0.07, 0.03))
    problem = build_problem(model, [session], [], [])
    assert problem.floor[0] < 0.002  # a correction bent by the rests leaves many times as much


def test_what_friction_holds_at_rest_is_left_out_of_the_noise_that_sets_the_band(tmp_path):
    model, session = stopping(tmp_path, (FRICTION, FRICTION))
    (block,) = build_problem(model, [session], [], []).blocks
    held = np.where(rests_of(session, 0)[block.picks], FRICTION, 0.0)
    own = 0.002 * np.random.default_rng(1).normal(size=len(held))
    (left,) = without_rests([block], [own + held])
    assert np.std(own + held) > 10.0 * np.std(own)
    assert np.std(left) == pytest.approx(np.std(own), rel=0.1)


def test_rows_of_one_rest_count_as_one(tmp_path):
    model, session = stopping(tmp_path, (FRICTION, FRICTION))
    (block,) = build_problem(model, [session], [], []).blocks
    weight = trust(model, block, FRICTION, guessed=True)
    resting = stillness(session, 0)[block.picks] > 0.99
    assert resting.sum() > 200
    assert np.sum(weight[resting] ** 2) < 5.0  # seven rests and the ends, a few tenths of a row each
    assert np.median(weight[~resting]) > 0.9
