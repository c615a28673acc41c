"""Where the pushed side of a part is: a small motion of it that explains where pushes at several places ended."""

import numpy as np
import pytest

from s2r_host.run.side import Touch, hinge_columns, hinge_doubts, none_slipped, transform, where

AXIS = np.array([0.0, 0.0, 1.0])
MIDDLE = np.array([0.08, 0.0, 0.1])
BESIDE = np.radians(1.5)
DOUBTS = hinge_doubts(BESIDE, 0.08)


def _columns(p: np.ndarray) -> np.ndarray:
    return hinge_columns(p, MIDDLE, np.cross(AXIS, p))


def _ends_beside(p: np.ndarray, found: np.ndarray) -> float:
    """How much further the part goes when the fingertip stops where the model's side is at ``p``."""
    x, y, _ = transform(found, MIDDLE)[:3] @ np.append(p, 1.0)
    return float(-np.arctan2(y, x))


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.02), (0.02, 0.0, 0.0), (0.01, 0.0, -0.01)])
@pytest.mark.parametrize("shift", [0.0, 0.001, -0.002])
def test_what_a_moved_side_does_is_what_its_columns_say(turn, shift):
    found = np.array([*turn, 0.0, shift, 0.0])
    for p in ([0.05, 0.0, 0.1], [0.11, 0.0, 0.12], [0.08, 0.0, 0.07]):
        assert _ends_beside(np.array(p), found) == pytest.approx(_columns(np.array(p)) @ found, abs=1e-4)


def test_a_shifted_and_turned_side_is_found_where_it_was_not_pushed():
    true = np.array([0.005, 0.0, 0.008, 0.0, 0.0015, 0.0])
    pushed = [np.array([x, 0.0, z]) for x, z in ((0.06, 0.1), (0.11, 0.11), (0.09, 0.07), (0.07, 0.13))]
    found = where([Touch(float(_columns(p) @ true), 0.0, 0.0, _columns(p)) for p in pushed], BESIDE, DOUBTS)
    elsewhere = np.array([0.1, 0.0, 0.12])
    assert _columns(elsewhere) @ found == pytest.approx(_columns(elsewhere) @ true, abs=np.radians(0.1))


@pytest.mark.parametrize(
    ("count", "sure", "vague"), [(1, 1 / 2, 1 / 3), (2, 1.0, 1 / 1.75), (99, 1.0, 1 / 1.5)]
)
def test_one_motion_teaches_half_and_a_vague_look_less_however_many_there_are(count, sure, vague):
    """Half of a look's variance is shared, so that many vague ones are hardly better than two."""
    p = np.array([0.08, 0.0, 0.1])
    for sigma, share in ((0.0, sure), (BESIDE, vague), (np.inf, 0.0)):
        found = where([Touch(0.01, sigma, 0.0, _columns(p))] * count, BESIDE, DOUBTS)
        assert _columns(p) @ found == pytest.approx(0.01 * share, rel=0.05)


def test_vague_looks_that_contradict_each_other_turn_nothing():
    """A lid edge-on: measured 0.9° too far at one place, 0.4° short at the next."""
    vague = np.radians(0.7)
    pushed = [np.array([x, 0.0, 0.1]) for x in (0.08, 0.07, 0.09)]
    offsets = np.radians([0.9, -0.4, 0.9])
    found = where(
        [Touch(offset, vague, 0.0, _columns(p)) for offset, p in zip(offsets, pushed, strict=True)],
        BESIDE,
        DOUBTS,
    )
    assert np.linalg.norm(found[:3]) < np.radians(0.5)


def test_what_the_joint_makes_of_all_looks_is_not_learnt():
    p = np.array([0.08, 0.0, 0.1])
    found = where([Touch(0.01, 0.0, 3.0 * BESIDE, _columns(p))] * 5, BESIDE, DOUBTS)
    assert _columns(p) @ found == pytest.approx(0.001, rel=0.05)


def test_one_motion_that_went_another_way_hardly_counts():
    p = np.array([0.08, 0.0, 0.1])
    offsets = (0.010, 0.011, 0.1)
    found = where([Touch(offset, 0.0, 0.0, _columns(p)) for offset in offsets], BESIDE, DOUBTS)
    assert _columns(p) @ found == pytest.approx(0.0105, abs=0.001)


def test_a_lever_that_lies_rolled_about_its_own_line_is_told_from_pushes_at_two_heights():
    """A tenth of a radian: half a millimetre, half a degree, five millimetres above and below its middle line."""
    along, true = np.array([1.0, 0.0, 0.0]), np.array([-0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    touches = [
        Touch(float(_columns(p) @ true), np.radians(0.1), 0.0, _columns(p))
        for p in (np.array([0.06, 0.0, 0.105]), np.array([0.06, 0.0, 0.095]))
    ]
    elsewhere = _columns(np.array([0.06, 0.0, 0.106]))
    lever, plate = (
        elsewhere @ where(touches, BESIDE, hinge_doubts(BESIDE, 0.06, line)) for line in (along, None)
    )
    assert lever == pytest.approx(elsewhere @ true, rel=0.2)
    assert plate < 0.5 * elsewhere @ true


@pytest.mark.parametrize(
    ("offsets_deg", "told"),
    [((3.5,), 0), ((2.5,), 1), ((3.5, 0.2), 1), ((3.5, 3.0), 2), ((3.5, -3.5), 0), ((3.5, 0.2, 0.1), 3)],
)
def test_a_motion_that_slipped_does_not_tell_where_a_side_is_until_another_agrees(offsets_deg, told):
    columns = _columns(np.array([0.06, 0.0, 0.1]))
    touches = [Touch(float(np.radians(offset)), 0.0, 0.0, columns) for offset in offsets_deg]
    assert len(none_slipped(touches, BESIDE)) == told
