"""Of a lever that points at the camera little more than its end is seen, in the air before the body."""

import numpy as np
import pytest

from s2r_host.motion.facing import find_facing
from s2r_host.motion.scene import Scene, without_specks

BODY, DECK_M, TOP_M = np.array([0.6, 0.0]), 0.012, 0.2
P_CAMERA = np.array([0.0, -0.45, 0.55])
TOWARDS = (P_CAMERA[:2] - BODY) / np.linalg.norm(P_CAMERA[:2] - BODY)


def grid(*spans, step_m=0.002):
    return np.stack(np.meshgrid(*(np.arange(low, high, step_m) for low, high in spans)), axis=-1).reshape(
        -1, len(spans)
    )


def end_of_a_lever(away_m, turned_rad=0.0, size_m=0.024, z_m=0.22):
    """Points of a face that looks at the camera, so far from the body's axis."""
    c, s = np.cos(turned_rad), np.sin(turned_rad)
    out = np.array([[c, -s], [s, c]]) @ TOWARDS
    across, up = grid((-0.5 * size_m, 0.5 * size_m), (-0.5 * size_m, 0.5 * size_m)).T
    level = BODY + away_m * out + across[:, None] * np.array([-out[1], out[0]])
    return np.column_stack([level, z_m + up])


def scene(*pieces):
    """A body on a deck, as far as a camera sees them, and pieces beside it."""
    x, y = grid((0.5, 0.7), (-0.15, 0.15), step_m=0.003).T
    deck = np.column_stack([x, y, np.full(len(x), DECK_M)])
    angle, z = grid((-1.2, 1.2), (DECK_M, TOP_M), step_m=0.004).T
    away = np.arctan2(TOWARDS[1], TOWARDS[0]) + angle
    body = np.column_stack([BODY[0] + 0.02 * np.cos(away), BODY[1] + 0.02 * np.sin(away), z])
    return Scene(np.concatenate([deck, body, *pieces]), P_CAMERA)


@pytest.mark.parametrize("turned_deg", [-20, 0, 20])
def test_the_end_of_a_lever_hangs_before_the_body(turned_deg):
    (lever,) = find_facing(scene(end_of_a_lever(0.09, np.radians(turned_deg))), [])
    assert np.linalg.norm(lever.p_root[:2] - BODY) < 0.015
    assert np.linalg.norm(lever.p_tip[:2] - BODY) == pytest.approx(0.09, abs=0.02)
    assert TOP_M - 0.03 < lever.p_root[2] <= TOP_M
    assert lever.width_m == pytest.approx(0.024, abs=0.004)


@pytest.mark.parametrize(
    "piece",
    [
        end_of_a_lever(0.09, np.radians(60)),  # beside the body: seen from its side it would be long
        end_of_a_lever(0.30),
        end_of_a_lever(0.09, size_m=0.09, z_m=0.15),  # a plate
        end_of_a_lever(0.09, z_m=0.04),  # stands on the deck
    ],
)
def test_what_else_is_in_view_is_no_end_of_a_lever(piece):
    assert find_facing(scene(piece), []) == []


def test_what_is_known_already_is_not_found_again():
    end = end_of_a_lever(0.09)
    assert find_facing(scene(end), [end]) == []


def test_a_bare_deck_has_none():
    x, y = grid((0.5, 0.7), (-0.15, 0.15), step_m=0.003).T
    assert find_facing(Scene(np.column_stack([x, y, np.full(len(x), DECK_M)]), P_CAMERA), []) == []


def test_a_few_matches_in_the_air_are_wrong_and_a_dense_patch_is_the_end_of_something():
    rng = np.random.default_rng(0)
    object_ = grid((0.5, 0.6), (-0.05, 0.05), (0.0, 0.02), step_m=0.005)
    speck = np.add((0.3, 0.2, 0.3), 0.01 * rng.random((60, 3)))
    end = np.add((0.3, -0.2, 0.3), np.column_stack([np.zeros(300), 0.03 * rng.random((300, 2))]))
    kept = without_specks(np.concatenate([object_, speck, end]))
    assert len(kept) == len(object_) + len(end)
    assert (np.abs(kept[:, 1] - 0.2) > 0.1).all()
