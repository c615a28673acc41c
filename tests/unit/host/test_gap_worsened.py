"""A patched model that predicts worse is called so."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.gap import pipeline
from s2r_host.gap.simulation.forward import Errors
from s2r_host.gap.simulation.worsened import worsened

NAN = np.full(2, np.nan)


def errors(held, effort=(1.0, 1.0), open_held=(0.1, 0.1)):
    return Errors(NAN, np.array(held), NAN, np.array(open_held), np.array(effort))


@pytest.mark.parametrize(
    ("after", "joint"),
    [
        (errors((0.01, 0.02)), None),  # as before
        (errors((0.001, 0.029)), None),  # a little worse
        (errors((0.01, 0.2)), 1),
        (errors((0.0001, 0.2)), None),  # the other joint gains more
        (errors((0.05, 0.2)), 1),  # the worst of two
        (errors((np.inf, 0.2)), 0),  # blown up
        (errors((0.01, 0.2), effort=(1.0, 0.5)), None),  # the effort is explained
    ],
)
def test_what_is_clearly_worse_is_found(after, joint):
    found = worsened(errors((0.01, 0.02)), after, [0, 1], 1e-4)
    assert (None if found is None else found[0]) == joint
    if joint is not None:
        assert found == (joint, (0.01, 0.02)[joint], after.held[joint])


def test_errors_near_the_encoders_noise_do_not_count():
    assert worsened(errors((1e-6, 1e-6)), errors((5e-6, 5e-6)), [0, 1], 1e-5) is None


def test_without_a_loop_the_open_one_counts():
    before, after = errors(NAN, NAN, (0.1, 0.1)), errors(NAN, NAN, (0.1, 0.9))
    assert worsened(before, after, [0, 1], 1e-4) == (1, 0.1, 0.9)
    assert worsened(errors(NAN, NAN, NAN), errors(NAN, NAN, NAN), [0, 1], 1e-4) is None


def doubted(verdict):
    """A finished analysis of two joints whose patch predicts the second one ten times worse."""
    decision = SimpleNamespace(verdict=verdict, parameters_off=[{"name": "mass"}])
    a: Any = SimpleNamespace(
        problem=SimpleNamespace(joints=[0, 1]), decision=decision, verdict=verdict, places=["everywhere"], notes=[],
        before=errors((0.01, 0.02)), after=errors((0.01, 0.2)), repeats=[], twin="patched",
        fit=[SimpleNamespace(q_lsb=np.zeros(2))], model=SimpleNamespace(joints=["a", "b"], unit=lambda _: "rad"),
    )  # fmt: skip
    nominal: Any = "nominal"
    pipeline._doubt_patch(a, nominal)
    return a


def test_a_generic_correction_that_predicts_worse_is_left_out():
    a = doubted("unknown")
    assert (a.verdict, a.twin, a.after) == ("unknown", "nominal", a.before)
    assert "the held-out motion of 'b' worse than the nominal model (0.02 to 0.2 rad)" in a.notes[0]


def test_numbers_that_predict_worse_are_taken_back():
    a = doubted("parameter_off")
    assert (a.verdict, a.decision.verdict, a.twin) == ("nothing_missing", "nothing_missing", "nominal")
    assert a.decision.parameters_off == a.places == []
    assert a.notes[0].startswith("mass explained effort")


def test_named_physics_that_predicts_worse_keeps_its_name_and_says_so():
    a = doubted("physics_missing")
    assert (a.verdict, a.twin) == ("physics_missing", "patched")
    assert "do not simulate with it" in a.notes[0]
