"""A lever's turn by its edges in colour, where its depth is smeared as a stereo matcher smears it."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.perception.colour_turn import Turn, combined, turn_by_colour
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.synthetic import LEVER_COLOURS, LEVER_HINGE, LeverLook, lever_look
from s2r_host.perception.view import DepthView


def told(first: LeverLook, second: LeverLook, believed: float) -> Turn | None:
    view = DepthView(first.frame)
    motion = JointMotion(
        "revolute", LEVER_HINGE + np.array([0.001, -0.001, 0.0]), np.array([0.0, 0.0, 1.0]), believed
    )
    return turn_by_colour(view, first.part.ravel()[view.flat], DepthView(second.frame), motion)


@pytest.mark.parametrize(("before", "after"), [(2.2, 1.6), (0.6, 1.1), (1.4, 1.6), (2.6, 2.9)])
@pytest.mark.parametrize("off", [-0.05, 0.05])
def test_the_turn_is_found_where_depth_was_three_degrees_off(before, after, off):
    turn = told(lever_look(before), lever_look(after), after - before + off)
    assert turn is not None
    assert turn.delta == pytest.approx(after - before, abs=0.02)
    assert turn.sigma < 0.018


def test_without_colour_there_is_no_answer():
    second = lever_look(1.6)
    assert told(lever_look(2.2), replace(second, frame=replace(second.frame, colour=None)), -0.6) is None


def test_a_lever_that_is_not_seen_again_gives_no_answer():
    first = lever_look(2.2)
    assert first.frame.colour is not None
    empty = replace(first.frame, colour=np.full_like(first.frame.colour, LEVER_COLOURS[3]))
    assert told(first, replace(first, frame=empty), -0.6) is None


def test_of_two_answers_the_surer_one_counts_for_more():
    both = combined(Turn(0.30, 0.02), Turn(0.36, 0.01))
    assert both.delta == pytest.approx(0.348)
    assert both.sigma == pytest.approx(0.02 / np.sqrt(5.0))
