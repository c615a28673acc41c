"""What is unknown has a place, also where a noise floor that holds the force itself leaves none to be seen."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.rig import write_model
from s2r_host.gap.verdict.where import Place, somewhere

DT, NOISE, DURATION_S = 0.004, 0.01, 18.0
TONES = ((0.5, 0.43, 0.0), (0.3, 1.7, 1.0), (0.1, 2.9, 2.0))  # amplitude [rad], frequency [Hz], phase
QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    path = write_model(tmp_path_factory.mktemp("rig") / "model.xml")
    return path, RigidModel(path)


def recorded(model, path, more, seed):
    """A lively motion whose stamps begin at 5 s; the effort is what the model needs and ``more(t)`` beside it."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, DURATION_S, DT)
    rounds = [2.0 * np.pi * f * t + p for _, f, p in TONES]
    q = np.sum([a * np.sin(x) for (a, _, _), x in zip(TONES, rounds, strict=True)], axis=0)
    v = np.sum([2.0 * np.pi * f * a * np.cos(x) for (a, f, _), x in zip(TONES, rounds, strict=True)], axis=0)
    a = -np.sum(
        [(2.0 * np.pi * f) ** 2 * a * np.sin(x) for (a, f, _), x in zip(TONES, rounds, strict=True)], axis=0
    )
    needed = model.inverse(q[:, None], v[:, None], a[:, None])[:, 0]
    tau = needed + more(t) + NOISE * rng.normal(size=len(t))
    columns = np.stack([5.0 + t, q, v, tau], axis=1)
    np.savetxt(path, columns, delimiter=",", header="t,q.elbow,dq.elbow,tau.elbow", comments="")
    return path


def slow(size, seed):
    """A force that wanders over seconds, another one with each seed [N·m]."""
    knots = np.arange(0.0, DURATION_S + 3.0, 3.0)
    drawn = np.random.default_rng(seed).normal(size=len(knots))
    return lambda t: size * np.interp(t, knots, drawn)


def throughout(place):
    ((first, last),) = place.t
    assert first == pytest.approx(5.0, abs=0.05)
    assert last == pytest.approx(5.0 + DURATION_S, abs=0.05)
    assert place.joint == "elbow"
    assert place.q[1] - place.q[0] > 1.0
    assert place.dq[0] < 0.0 < place.dq[1]


def test_a_slow_force_that_no_second_run_repeats_is_where_it_acts(rig, tmp_path):
    path, model = rig
    first, again = (recorded(model, tmp_path / f"{k}.csv", slow(0.3, seed=k), seed=k) for k in range(2))
    found = analyse(path, [first], [], [again], QUICK, lambda _: None)
    assert found.verdict == "unknown"
    (place,) = found.places
    throughout(place)
    assert "no second run repeats" in place.words


def test_a_vibration_that_a_guessed_floor_holds_is_where_it_acts(rig, tmp_path):
    path, model = rig
    swings = recorded(model, tmp_path / "a.csv", lambda t: 0.2 * np.sin(2.0 * np.pi * 3.3 * t), seed=0)
    found = analyse(path, [swings], [], [], QUICK, lambda _: None)
    assert found.verdict == "unknown"
    (place,) = found.places
    throughout(place)
    assert "3.30 Hz" in place.words


def problem(*left):
    """Two joints, each with what is left over on it beside a floor of one."""
    t = np.arange(5) / 10.0
    session: Any = SimpleNamespace(
        rec=SimpleNamespace(start_s=2.0), t=t, q=np.stack([t, 2.0 * t], axis=1), v=np.ones((5, 2))
    )
    model = SimpleNamespace(joints=("j1", "j2"), index=("j1", "j2").index)
    blocks = [SimpleNamespace(joint=j, rows=slice(5 * j, 5 * j + 5)) for j in range(2)]
    rows = np.repeat(np.array(left), 5)
    made: Any = SimpleNamespace(
        ctx=SimpleNamespace(sessions=[session], model=model),
        joints=[0, 1],
        blocks=blocks,
        floor={0: 1.0, 1: 1.0},
    )
    return made, rows


@pytest.mark.parametrize(("left", "joint"), [((0.9, 0.2), "j1"), ((0.2, 0.9), "j2")])
def test_where_nothing_stands_out_it_is_the_joint_that_comes_nearest_to_its_floor(left, joint):
    (place,) = somewhere(*problem(*left), [])
    assert place.joint == joint
    assert place.t == [[2.0, 2.4]]
    assert place.q[1] == pytest.approx(0.4 if joint == "j1" else 0.8)


def test_times_that_stand_out_are_kept_and_others_filled_in():
    seen = Place("j2", 0.7, [[2.1, 2.2]], [0.0, 0.1], [1.0, 1.0], "at high speed")
    unseen = Place("j1", 0.3, [], [0.0, 0.1], [1.0, 1.0], "throughout the motion")
    first, second = somewhere(*problem(0.0, 1.0), [seen, unseen])
    assert first == seen
    assert second.t == [[2.0, 2.4]]
    assert second.q == unseen.q
