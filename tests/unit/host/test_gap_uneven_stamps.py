"""Stamps that jitter give each of two runs of one motion a step of its own; they are two runs of it all the same."""

import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session, work_grid
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression import second_run
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.regression.second_run import beside_first, find_partner, no_partner
from s2r_host.gap.rig import write_model

QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)
TONES = [(0.5, 0.43, 0.0), (0.3, 1.7, 1.0)]
NOISE = 0.01
JITTER = [
    (100, 5e-4),
    (100, 4e-3),
    (200, 5e-4),
    (500, 1e-5),
    (500, 1e-4),
    (1000, 1e-5),
    (50, 1e-3),
    (20, 0.02),
]


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml"))


def stamps(rate_hz, jitter_s, seed):
    t = np.arange(0.0, 12.0, 1.0 / rate_hz) + 0.01
    return np.sort(t + np.random.default_rng(seed).uniform(-jitter_s, jitter_s, len(t)))


def recorded(model, t, seed, force=0.0):
    """A motion at the stamps ``t``, the effort that it needs and noise; ``force`` swings with time and comes back."""
    q, v, a = (
        np.sum(
            [s * (2 * np.pi * f) ** n * np.sin(2 * np.pi * f * t + p + n * np.pi / 2) for s, f, p in TONES],
            axis=0,
        )
        for n in range(3)
    )
    u = model.inverse(q[:, None], v[:, None], a[:, None])[:, 0] + force * np.sin(2 * np.pi * 1.37 * t)
    u = u + NOISE * np.random.default_rng(seed).normal(size=len(t))
    channels = {"q": {"elbow": q}, "dq": {"elbow": v}, "tau": {"elbow": u}}
    return Recording(f"r{seed}", t - t[0], channels, Controller(), "measured", "effort", "a", "", ())


def sessions(model, rate_hz, jitter_s, force=0.0):
    return [
        make_session(model, recorded(model, stamps(rate_hz, jitter_s, seed), seed, force), seed)
        for seed in range(2)
    ]


@pytest.mark.parametrize(("rate_hz", "jitter_s"), JITTER)
def test_stamps_that_jitter_leave_a_second_run_one(model, rate_hz, jitter_s):
    first, again = sessions(model, rate_hz, jitter_s)
    assert first.dt != again.dt
    assert no_partner(again, [first]) is None
    twin = beside_first(model, again, [first])
    n = min(len(first.t), len(twin.t))
    assert np.array_equal(twin.t[:n], first.t[:n])
    assert twin.q[10 : n - 10] == pytest.approx(first.q[10 : n - 10], abs=0.03)


def test_the_mean_of_the_steps_tells_the_rate_where_their_middle_does_not(model):
    first = make_session(model, recorded(model, stamps(10, 0.04, 0), 0), 0)
    for seed in range(1, 20):
        again = make_session(model, recorded(model, stamps(10, 0.04, seed), seed), seed)
        assert second_run._as_long(again, first)


@pytest.mark.parametrize(("rate_hz", "jitter_s"), [(500, 1e-5), (500, 1e-4), (1000, 1e-5)])
def test_stamps_that_jitter_make_no_faster_log(model, rate_hz, jitter_s):
    for seed in range(6):
        _, dt = work_grid(recorded(model, stamps(rate_hz, jitter_s, seed), seed))
        assert dt == pytest.approx(0.002, rel=0.01)


def test_what_comes_back_is_seen_between_stamps_that_jitter(model):
    first, again = sessions(model, 200, 5e-4, force=0.3)
    twin = beside_first(model, again, [first])
    problem = build_problem(model, [first], [], [twin])
    assert problem.floor_source == "repeat"
    assert problem.floor[0] < 2.0 * NOISE
    assert problem.twin is not None


def test_a_second_run_at_the_same_steps_is_not_made_anew(model):
    first, again = sessions(model, 250, 0.0)
    assert beside_first(model, again, [first]) is again


def test_a_run_at_another_rate_is_no_second_run(model):
    first, _ = sessions(model, 100, 0.0)
    other, _ = sessions(model, 125, 0.0)
    assert "it has 1500 rows of 0.008 s" in (no_partner(other, [first]) or "")


def test_the_floor_is_read_from_a_second_run_whose_stamps_jitter(tmp_path):
    model = RigidModel(write_model(tmp_path / "model.xml"))
    paths = []
    for seed, name in enumerate(("fit", "repeat")):
        rec = recorded(model, stamps(500, 1e-5, seed), seed)
        columns = [rec.t, *(rec.channels[kind]["elbow"] for kind in ("q", "dq", "tau"))]
        lines = [",".join(f"{x:.9g}" for x in row) for row in zip(*columns, strict=True)]
        paths.append(tmp_path / f"{name}.csv")
        paths[-1].write_text("\n".join(["t,q.elbow,dq.elbow,tau.elbow", *lines]) + "\n")
    found = analyse(tmp_path / "model.xml", paths[:1], [], paths[1:], QUICK, lambda _: None)
    assert found.problem is not None
    assert found.problem.floor_source == "repeat"
    assert find_partner(found.repeats[0], found.fit) is found.fit[0]
    assert found.verdict == "nothing_missing"
    assert not [note for note in found.notes if "no second run" in note]
