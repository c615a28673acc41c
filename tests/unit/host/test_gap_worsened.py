"""A patched model that predicts worse is called so."""

import numpy as np
import pytest

from s2r_host.gap.forward import Errors
from s2r_host.gap.worsened import worsened

NAN = np.full(2, np.nan)


def errors(held, effort=(1.0, 1.0), open_held=(0.1, 0.1)):
    return Errors(NAN, np.array(held), NAN, np.array(open_held), np.array(effort))


@pytest.mark.parametrize(
    ("after", "joint"),
    [
        (errors((0.01, 0.02)), None),  # as before
        (errors((0.001, 0.029)), None),  # a little worse
        (errors((0.01, 0.2)), 1),
        (errors((0.05, 0.2)), 1),  # the worst of two
        (errors((np.inf, 0.2)), 0),  # blown up
        (errors((0.01, 0.2), effort=(1.0, 0.5)), None),  # the effort is explained
    ],
)
def test_what_is_clearly_worse_is_found(after, joint):
    assert worsened(errors((0.01, 0.02)), after, [0, 1], 1e-4) == joint


def test_errors_near_the_encoders_noise_do_not_count():
    assert worsened(errors((1e-6, 1e-6)), errors((5e-6, 5e-6)), [0, 1], 1e-5) is None


def test_without_a_loop_the_open_one_counts():
    before, after = errors(NAN, NAN, (0.1, 0.1)), errors(NAN, NAN, (0.1, 0.9))
    assert worsened(before, after, [0, 1], 1e-4) == 1
    assert worsened(errors(NAN, NAN, NAN), errors(NAN, NAN, NAN), [0, 1], 1e-4) is None
