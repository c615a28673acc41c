"""What imitates a detent, a soft close or a rotor lacks a part of it, or brings one that it has not."""

import numpy as np
import pytest

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.regression.solution import Term
from s2r_host.gap.rig import write_model
from s2r_host.gap.search import consistency
from s2r_host.gap.search.consistency import disagreement
from s2r_host.gap.search.search import Search

DT = 0.004  # of what ``swung`` records
PLACE, WIDTH, EDGE, RAMP = 0.1, 0.08, 0.3, 0.01
DETENT = Term("detent", 0, (("q0", PLACE), ("w", WIDTH)))
ARMATURE = Term("armature", 0)
SOFT_CLOSE = Term("soft_close", 0, (("back", 0.0), ("q0", EDGE), ("ramp", RAMP), ("side", 1.0)))


def pull(q, dq):
    x = (q - PLACE) / WIDTH
    return 0.3 * x * np.exp(0.5 - 0.5 * x**2)


def picked_up(q, dq):
    return 0.3 * (q > PLACE)


def brake(q, dq):
    return 0.3 * dq * ((q > EDGE) & (dq > 0))


def caught(q, dq):
    return 0.6 * dq * ((q > EDGE) & (q < EDGE + 0.15) & (dq > 0))


def rotor(q, dq):
    return 0.03 * np.gradient(dq, DT)


def turned_mass(q, dq):
    """Of an inertia J sin²(q + 1): it depends on the pose, and so does the effort at constant speed."""
    return 0.05 * (np.sin(q + 1.0) ** 2 * np.gradient(dq, DT) + 0.5 * np.sin(2.0 * (q + 1.0)) * dq**2)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml"))


@pytest.mark.parametrize(
    ("term", "hidden", "said"),
    [
        (DETENT, pull, None),
        (DETENT, picked_up, "a force that stays on beyond its place"),
        (SOFT_CLOSE, brake, None),
        (SOFT_CLOSE, caught, "the brake of the deeper half"),
        (ARMATURE, rotor, None),
        (ARMATURE, turned_mass, "an inertia that changes with the joint's position"),
    ],
)
def test_an_imitation_is_told_by_its_parts(model, swung, term, hidden, said):
    fit, again, held = (swung(model, k, phase, hidden) for k, phase in ((0, 0.0), (1, 0.0), (2, 1.0)))
    problem = build_problem(model, [fit], [held], [again])
    search = Search(problem)
    found = disagreement(problem, search, search.finish([term], [[]], []))
    assert found is None if said is None else found is not None and said in found


@pytest.mark.parametrize(("off", "deviation", "speaks"), [(-2e11, 1.5e11, False), (-0.9, 0.2, True)])
def test_a_part_that_nothing_shows_contradicts_nothing(model, swung, monkeypatch, off, deviation, speaks):
    """The weight on a joint that no gravity pulls is rounding: its size would have to be a number without end."""
    problem = build_problem(model, [swung(model, 0, 0.0, brake)], [swung(model, 2, 1.0, brake)], [])
    search = Search(problem)
    monkeypatch.setattr(consistency, "_excess", lambda *_: (off, deviation))
    assert (disagreement(problem, search, search.finish([SOFT_CLOSE], [[]], [])) is not None) == speaks
