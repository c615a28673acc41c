"""Which name goes first: one that fits and predicts nothing, or one that fits less well and predicts."""

from types import SimpleNamespace

import numpy as np
import pytest

from s2r_host.gap.regression.solution import Scored, Term
from s2r_host.gap.search.search import Search


@pytest.fixture
def ranked(monkeypatch):
    """The order of names with (effect, gain, share of the held-out misfit)."""

    def order(*rows):
        scored = [
            Scored(Term(name, *(joint or [0])), gain, gain, share, np.zeros(0))
            for name, gain, share, *joint in rows
        ]
        search = SimpleNamespace(scan_profiled=lambda chosen: (scored, {}))
        return [s.term.effect for s in Search._ranked(search, [])]  # pyright: ignore[reportArgumentType]

    return order


def test_what_fits_and_does_not_predict_goes_behind_what_does_both(ranked):
    assert ranked(("joint_elasticity", 61.0, -0.02), ("cogging", 15.0, 0.9))[0] == "cogging"


def test_little_evidence_is_not_preferred_for_a_good_prediction(ranked):
    assert ranked(("joint_elasticity", 61.0, -0.02), ("cogging", 5.0, 0.9))[0] == "joint_elasticity"


def test_a_name_that_predicts_a_part_keeps_its_place(ranked):
    assert ranked(("backlash", 61.0, 0.4), ("cogging", 15.0, 0.9))[0] == "backlash"


def test_nothing_is_ranked_where_nothing_was_found(ranked):
    assert ranked() == []


@pytest.mark.parametrize(
    ("rival", "first"),
    [
        (("cable_spring", 91.0, 0.99), "cable_spring"),
        (("cable_spring", 91.0, 0.82), "hysteresis"),  # leaves nearly as much
        (("cable_spring", 85.0, 0.99), "hysteresis"),  # fits clearly worse
        (("cable_spring", 91.0, 0.99, 1), "hysteresis"),  # its share is one of another joint's misfit
    ],
)
def test_of_two_that_fit_alike_the_one_that_predicts_far_better_goes_first(ranked, rival, first):
    order = ranked(("hysteresis", 98.0, 0.79), rival, ("spring_return", 40.0, 0.7))
    assert order[0] == first
    assert ("hysteresis" in order) == (first == "hysteresis")
    assert order[-1] == "spring_return"


def test_a_best_name_that_leaves_next_to_nothing_keeps_its_place(ranked):
    assert ranked(("bandwidth", 98.0, 0.97), ("saturation", 97.0, 0.999))[0] == "bandwidth"
