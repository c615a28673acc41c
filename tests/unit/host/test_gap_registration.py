"""Recordings whose positions are off are set against each other by what their efforts show of one place."""

import numpy as np
import pytest

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.registration import registered
from s2r_host.gap.motion.session import Session, make_session
from s2r_host.gap.recordings.recording import Controller, Recording

MODEL = """<mujoco><worldbody><body name="lever">
<joint name="hinge" type="hinge" axis="0 0 1" frictionloss="0.4"/>
<geom type="box" size="0.1 0.01 0.01" mass="0.1"/></body></worldbody></mujoco>"""
SIGMA_RAD, SPEED_RAD_S = 0.02, 0.3
STARTS = (0.0, 0.1, 0.2, 0.35, 0.3, 0.25)
WAYS = (1, 1, 1, -1, -1, -1)
OFFS = np.array([0.02, -0.025, 0.01, -0.02, 0.03, -0.015])


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.xml"
    path.write_text(MODEL)
    return RigidModel(path)


def strokes(model, law, offs=OFFS, sigma=SIGMA_RAD) -> list[Session]:
    """Strokes at one speed against ``law(q, way)``, their positions told ``offs`` too far."""
    found = []
    for k, (start, way, off) in enumerate(zip(STARTS, WAYS, offs, strict=True)):
        t = np.arange(0.0, 1.0, 0.005)
        q = start + way * SPEED_RAD_S * t
        tau = law(q, way) + np.random.default_rng(k).normal(0.0, 0.005, len(t))
        channels = {
            "q": {"hinge": q + off},
            "dq": {"hinge": np.full(len(t), way * SPEED_RAD_S)},
            "tau": {"hinge": tau},
        }
        accuracies = {"effort_sigma": {"hinge": 0.03}, "effort_gain_sigma": {"hinge": 0.04}}
        if sigma:
            accuracies["position_sigma"] = {"hinge": sigma}
        rec = Recording(f"r{k}", t, channels, Controller(), "measured", "effort", "run", "", (), **accuracies)
        found.append(make_session(model, rec, k))
    return found


def notches(q, way):
    return 0.4 * way + 0.3 * np.sin(2 * np.pi * q / 0.18)


def uneven(q, way):
    return way * (0.4 + 0.3 * np.sin(2 * np.pi * q / 0.35))


def plain(q, way):
    return np.full_like(q, 0.4 * way)


def shifts(model, before) -> tuple[np.ndarray, list[str]]:
    notes: list[str] = []
    after = registered(model, before, notes)
    return np.array([np.mean(b.q - a.q) for a, b in zip(before, after, strict=True)]), notes


@pytest.mark.parametrize("law", [notches, uneven])
def test_what_depends_on_the_place_brings_positions_into_step(model, law):
    found, notes = shifts(model, strokes(model, law))
    left = OFFS + found
    assert np.ptp(left) < 0.25 * np.ptp(OFFS)
    assert len(notes) == 1
    assert "r1 +0.0" in notes[0]


def test_the_effort_goes_with_the_position_it_was_felt_at(model):
    before = strokes(model, notches)
    after = registered(model, before, [])
    for a, b in zip(before, after, strict=True):
        assert b.rec.channels["tau"] is a.rec.channels["tau"]
        assert b.v == pytest.approx(a.v)


def test_friction_alike_everywhere_moves_nothing(model):
    found, notes = shifts(model, strokes(model, plain))
    assert not found.any()
    assert not notes


def test_positions_in_step_stay(model):
    found, notes = shifts(model, strokes(model, notches, offs=np.zeros(6)))
    assert not found.any()
    assert not notes


def test_undeclared_positions_are_taken_as_told(model):
    found, notes = shifts(model, strokes(model, notches, sigma=0.0))
    assert not found.any()
    assert not notes


def test_more_than_declared_is_another_place(model):
    """A shift of many deviations would explain notches by a wrong one of them."""
    found, notes = shifts(model, strokes(model, notches, sigma=0.002))
    assert not found.any()
    assert not notes
