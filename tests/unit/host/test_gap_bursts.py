"""Pushes that come now and then: told from noise, with their times, and not seen where there are none."""

import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.rig import write_model

DT, NOISE = 0.004, 0.02
PUSHES = ((4.1, 3.0), (9.3, -4.0), (13.2, 3.5))
QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    path = write_model(tmp_path_factory.mktemp("rig") / "model.xml")
    return path, RigidModel(path)


def recorded(model, path, more, seed=0, duration=18.0):
    """A lively motion; the effort is what the model needs, less what else pushes, ``more(t, q, v)``, plus noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, DT)
    tones = [(0.5, 0.43, 0.0), (0.3, 1.7, 1.0), (0.1, 2.9, 2.0)]
    q = np.sum([a * np.sin(2 * np.pi * f * t + p) for a, f, p in tones], axis=0)
    v = np.sum([2 * np.pi * f * a * np.cos(2 * np.pi * f * t + p) for a, f, p in tones], axis=0)
    a = np.sum([-((2 * np.pi * f) ** 2) * a * np.sin(2 * np.pi * f * t + p) for a, f, p in tones], axis=0)
    u = (
        model.inverse(q[:, None], v[:, None], a[:, None])[:, 0]
        - more(t, q, v)
        + NOISE * rng.normal(size=len(t))
    )
    np.savetxt(
        path,
        np.stack([t, q, v, u], axis=1),
        delimiter=",",
        header="t,q.elbow,dq.elbow,tau.elbow",
        comments="",
    )
    return path


def pushes(t, q, v):
    del q, v
    return sum(size * np.exp(-(((t - middle) / 0.2) ** 2)) for middle, size in PUSHES)


def test_pushes_are_unknown_with_their_times(rig, tmp_path):
    path, model = rig
    found = analyse(path, [recorded(model, tmp_path / "a.csv", pushes)], [], [], QUICK, lambda _: None)
    assert found.verdict == "unknown"
    assert found.decision.effects == found.decision.parameters_off == []
    (place,) = found.places
    assert place.joint == "elbow"
    # Those of the fitted part and of the held-out one; a push of 0.2 s (deviation 0.14 s) is loud for some tenths.
    assert len(place.t) == len(PUSHES)
    for (start, stop), (middle, _) in zip(place.t, PUSHES, strict=True):
        assert start < middle < stop
        assert stop - start < 1.2
    assert any("something touches it" in r for r in found.decision.reasons)


@pytest.mark.parametrize(
    "more",
    [
        pytest.param(lambda t, q, v: 0.0 * t, id="nothing"),
        pytest.param(
            lambda t, q, v: (
                0.3 * np.interp(t, np.arange(0, 19, 0.5), np.random.default_rng(5).normal(size=38))
            ),
            id="wandering all the time",
        ),
        pytest.param(lambda t, q, v: -0.4 * np.tanh(v / 0.01), id="friction"),
    ],
)
def test_what_is_there_all_the_time_is_no_push(rig, tmp_path, more):
    path, model = rig
    found = analyse(path, [recorded(model, tmp_path / "a.csv", more)], [], [], QUICK, lambda _: None)
    assert found.decision.touched is None
