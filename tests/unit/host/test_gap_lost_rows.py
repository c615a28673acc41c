"""Rows a fast log lost, forces that no second run repeats, and how far held-out rows may move the numbers."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.gap.motion.law import stamps_agree
from s2r_host.gap.motion.lost_rows import bridged
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.friction_seen import dry_level
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.regression.unrepeated import wandering
from s2r_host.gap.rig import write_model
from s2r_host.gap.search.search import Search

DT, KP, KD = 0.004, 60.0, 6.0


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml"))


def logged(model, index=0, speed=1.0, wander=0.0, rising=0.0, late=0.0, duration=20.0):
    """A lively motion, the effort its model needs, and slow wandering of it that differs from run to run."""
    rng = np.random.default_rng(index)
    t = np.arange(0.0, duration, DT)
    tones = [(0.5, 0.43 * speed, 0.0), (0.3, 1.7 * speed, 1.0)]
    q = np.sum([a * np.sin(2 * np.pi * f * t + p) for a, f, p in tones], axis=0) + rising * t
    v = np.sum([2 * np.pi * f * a * np.cos(2 * np.pi * f * t + p) for a, f, p in tones], axis=0) + rising
    a = np.sum([-((2 * np.pi * f) ** 2) * a * np.sin(2 * np.pi * f * t + p) for a, f, p in tones], axis=0)
    u = model.inverse(q[:, None], v[:, None], a[:, None])[:, 0] + 0.005 * rng.normal(size=len(t))
    u = u + wander * np.sin(2 * np.pi * 0.23 * t + rng.uniform(0.0, 6.0))
    asked = (u - KD * (np.interp(t + late, t, v) - v)) / KP + np.interp(t - late, t, q)
    rows = {"q": q, "dq": v, "tau": u, "q_cmd": asked, "dq_cmd": np.interp(t + late, t, v)}
    law = Controller("pd", {"elbow": KP}, {"elbow": KD}, {}, 1.0 / DT)
    channels = {kind: {"elbow": x} for kind, x in rows.items()}
    return Recording(f"r{index}", t, channels, law, "commanded", "q_cmd", "a", "", ())


def with_holes(rec, rows=10, every=180):
    keep = np.arange(len(rec.t)) % every >= rows
    keep[0] = True
    channels = {kind: {j: x[keep] for j, x in table.items()} for kind, table in rec.channels.items()}
    return replace(rec, t=rec.t[keep], channels=channels)


def test_motion_and_effort_across_lost_rows_are_nearly_what_they_were(model):
    whole = logged(model, speed=1.6)
    torn = with_holes(whole)
    full, doubt = bridged(model, torn)
    assert len(full.t) == pytest.approx(len(whole.t), abs=2)
    lost = ~np.isin(np.round(whole.t / DT), np.round(torn.t / DT))
    for kind, share in (("q", 0.01), ("dq", 0.05), ("tau", 0.1)):
        true = whole.channels[kind]["elbow"]
        guess = np.interp(whole.t, full.t, full.channels[kind]["elbow"])
        plain = np.interp(whole.t, torn.t, torn.channels[kind]["elbow"])
        assert np.std((guess - true)[lost]) < share * np.std((plain - true)[lost]) + 0.01 * np.std(true) * (
            kind == "tau"
        )
    assert np.count_nonzero(doubt["elbow"]) >= 2
    assert np.median(doubt["elbow"]) == 0.0


def test_a_log_without_holes_or_without_speed_stays_as_it_is(model):
    whole = logged(model)
    assert bridged(model, whole)[0] is whole
    torn = with_holes(whole)
    del torn.channels["dq"]
    assert bridged(model, torn)[0] is torn


def test_jitter_of_the_stamps_makes_no_holes(model):
    rec = logged(model)
    shaken = replace(rec, t=rec.t + np.random.default_rng(3).uniform(-0.4, 0.4, len(rec.t)) * DT)
    assert bridged(model, shaken)[0] is shaken


def test_lost_rows_leave_the_nominal_model_at_its_floor(model):
    fit, again, held = (
        make_session(model, with_holes(logged(model, k, speed)), k) for k, speed in enumerate((1.0, 1.0, 1.6))
    )
    assert Search(build_problem(model, [fit], [held], [again])).at_floor([])


def test_a_slow_force_that_no_second_run_repeats_is_no_noise(model):
    first, again = (make_session(model, logged(model, k, wander=2.0), k) for k in range(2))
    found = wandering(model, 0, [first], [again])
    assert found is not None
    assert found.size > 0.05
    assert "no second run repeats" in found.words("elbow", "N·m")


def test_a_force_that_swings_at_one_frequency_is_repeated_by_no_second_run(model):
    rng = np.random.default_rng(4)
    first, again = (make_session(model, logged(model, k), k) for k in range(2))
    for s in (first, again):
        s.u[:, 0] += 1.5 * np.sin(2.0 * np.pi * 6.3 * s.t + rng.uniform(0.0, 6.0))
    found = wandering(model, 0, [first], [again])
    assert found is not None
    assert found.line_Hz == pytest.approx(6.3, abs=0.1)
    assert "at 6.3" in found.words("elbow", "N·m")


def test_noise_that_forgets_itself_is_noise_however_large(model):
    first, again = (make_session(model, logged(model, k), k) for k in range(2))
    assert wandering(model, 0, [first], [again]) is None


def test_the_law_says_that_effort_and_motion_share_their_stamps(model):
    assert stamps_agree(model, [make_session(model, logged(model), 0)], 0)
    measured = replace(logged(model), effort="measured")
    assert not stamps_agree(model, [make_session(model, measured, 0)], 0)


def test_stamps_that_known_effort_shares_leave_less_room_for_a_late_effort(model):
    def doubt_of_timing(rec):
        s = make_session(model, rec, 0)
        p = build_problem(model, [s], [], [])
        return next(d for b, d in zip(p.base, p.prior, strict=True) if b.name == "timing")

    known = logged(model)
    assert doubt_of_timing(known) < 0.5 * doubt_of_timing(replace(known, effort="measured"))


def test_dry_friction_of_a_joint_that_goes_one_way_is_no_wild_number(model):
    s = make_session(model, logged(model, rising=9.0), 0)
    assert np.all(s.v[:, 0] > 0.0)
    assert dry_level(s, 0) < 0.1


def test_a_livelier_held_out_motion_may_move_the_numbers_within_their_doubt(model):
    """An inertia that is 1 % off hides in the noise of a slow motion and must not be physics in a fast one."""
    fit, again = (make_session(model, logged(model, k, 0.15), k) for k in range(2))
    fast = logged(model, 2, 2.0)
    q, v, a = (fit_column(fast, k) for k in ("q", "dq", "ddq"))
    more = 0.01 * (model.inverse(q, v, a) - model.inverse(q, v, 0.0 * a))[:, 0]
    fast.channels["tau"]["elbow"] = fast.channels["tau"]["elbow"] + more
    search = Search(build_problem(model, [fit], [make_session(model, fast, 2)], [again]))
    assert search.at_floor([])
    search.within_doubt = lambda left: left
    assert not search.at_floor([])


def fit_column(rec, kind):
    """One channel of a recording as a column; the acceleration from its speed."""
    x = np.gradient(rec.channels["dq"]["elbow"], DT) if kind == "ddq" else rec.channels[kind]["elbow"]
    return x[:, None]
