"""A piece turns about the body, a foot of its own or a level axis at the side, and is pushed to the middle first."""

import numpy as np
import pytest

from s2r_host.motion.lever_axes import UP, LeverAxis, level_axis, upright_axis, with_room_first
from s2r_host.motion.levers import LeverCandidate

BODY = np.array([0.6, 0.0])


def piece(root, tip, rooted=False):
    """A straight piece, its ends given [m], of a faucet whose body stands at ``BODY``."""
    root, tip = np.array(root), np.array(tip)
    p = root + np.linspace(0.0, 1.0, 50)[:, None] * (tip - root)
    outward = np.append(tip[:2] - BODY, 0.0) / np.linalg.norm(tip[:2] - BODY)
    return LeverCandidate(p, root, tip, 0.02, 0.02, 0.0, outward, 0.1, 1.0, rooted, BODY)


def test_a_lever_on_top_turns_about_the_axis_of_the_body_which_its_visible_root_is_far_from():
    axis = upright_axis(piece((0.6, 0.045, 0.2), (0.6, 0.14, 0.23)))
    assert axis.radius(np.array([0.6, 0.14, 0.23])) == pytest.approx(0.14)


def test_a_short_wide_piece_on_top_moves_square_to_the_way_from_the_body_and_not_to_its_own_line():
    lever = piece((0.63, 0.035, 0.2), (0.61, 0.07, 0.2))
    way = upright_axis(lever).way(lever.p_tip)
    assert abs(way @ np.append((lever.p_tip[:2] - BODY) / np.linalg.norm(lever.p_tip[:2] - BODY), 0.0)) < 1e-9


def test_a_handle_on_its_own_foot_turns_about_a_line_within_what_is_seen_of_it():
    handle = piece((0.6, 0.15, 0.1), (0.5, 0.15, 0.12), rooted=True)
    assert 0.08 < upright_axis(handle).radius(handle.p_tip) < 0.1


def test_an_upright_lever_at_the_side_swings_about_the_line_from_the_body_to_it():
    """Its own line does not tell: it used to be pushed along that axis."""
    lever = piece((0.6, 0.05, 0.2), (0.6, 0.055, 0.3))
    way = level_axis(lever).way(lever.p_tip)
    assert abs(way @ np.array([1.0, 0.0, 0.0])) > 0.98
    assert level_axis(lever).radius(lever.p_tip) == pytest.approx(0.09, abs=0.005)


def test_a_level_lever_at_the_side_swings_up_and_down_about_its_root_beside_the_body():
    lever = piece((0.59, 0.035, 0.2), (0.48, 0.035, 0.2))
    axis = level_axis(lever)
    assert abs(axis.way(lever.p_tip) @ UP) > 0.99
    assert axis.radius(lever.p_tip) == pytest.approx(0.12, abs=0.005)


@pytest.mark.parametrize(
    ("tip", "axis_of", "towards"),
    [
        ((0.62, 0.12, 0.2), upright_axis, (-1.0, 0.0, 0.0)),  # on top, leading away from the arm
        ((0.50, 0.12, 0.2), upright_axis, (-1.0, 0.0, 0.0)),
        ((0.65, 0.05, 0.3), level_axis, (-1.0, 0.0, 0.0)),  # at the side, leaning back
        ((0.48, 0.05, 0.22), level_axis, (0.0, 0.0, 1.0)),  # at the side, leading to the arm
    ],
)
def test_a_lever_is_pushed_first_to_where_levers_mostly_lead(tip, axis_of, towards):
    lever = piece((0.6, 0.05, 0.2), tip)
    for axis in (axis_of(lever), LeverAxis(axis_of(lever).p, -axis_of(lever).direction)):
        assert with_room_first(axis, lever).way(lever.p_tip) @ np.array(towards) > 0.0
