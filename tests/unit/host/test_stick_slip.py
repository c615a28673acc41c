"""A part that sticks and slips under a slow fingertip is recorded in running means."""

import numpy as np
import pytest

from s2r_host.proprioception.samples import EVERY_S
from s2r_host.proprioception.stick_slip import MEAN_S, averaged, stick_slips

N = 1000
SLOW = np.full(N, 0.008)
BLOW, CYCLE = 4, 40  # rows: 20 ms every 0.2 s


def struck(first: int, last: int, every: int = CYCLE // 2) -> np.ndarray:
    blows = np.zeros(N, dtype=bool)
    for start in range(first, last, every):
        blows[start : start + BLOW] = True
    return blows


def test_blows_that_follow_one_another_are_one_bout():
    contact = np.ones(N, dtype=bool)
    (bout,) = stick_slips(contact, struck(200, 700), SLOW)
    assert bout[0] == 200
    assert 680 <= bout[-1] < 704


@pytest.mark.parametrize(
    "blows",
    [
        struck(200, 201),  # the fingertip lands
        struck(200, 260),  # and bounces
        struck(100, 900, every=150),  # other than sticking, blows now and then
        np.zeros(N, dtype=bool),
    ],
)
def test_other_blows_are_none(blows):
    assert stick_slips(np.ones(N, dtype=bool), blows, SLOW) == []


def test_jumps_of_a_part_that_is_pushed_along_are_those_of_the_way():
    assert stick_slips(np.ones(N, dtype=bool), struck(200, 700), np.full(N, 0.05)) == []


def test_a_bout_ends_where_the_fingertip_leaves_the_part():
    contact = np.ones(N, dtype=bool)
    contact[450:] = False
    (bout,) = stick_slips(contact, struck(200, 700), SLOW)
    assert bout[-1] < 450


def test_means_over_whole_cycles_are_those_of_the_friction():
    cycle = np.concatenate([np.linspace(0.27, 0.62, 30), np.linspace(0.62, 0.27, 10)])
    means = averaged(np.tile(cycle, N // CYCLE))
    assert len(means) == N - round(MEAN_S / EVERY_S)
    assert means == pytest.approx(np.full(len(means), cycle.mean()), abs=0.03)
