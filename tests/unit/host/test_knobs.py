"""A knob with spokes is told from lever and spout, and turned by the side of a spoke."""

import numpy as np
import pytest

from s2r_host.motion.knobs import find_knobs, find_lying_knobs
from s2r_host.motion.lever_axes import upright_axis
from s2r_host.motion.lever_proposals import lever_proposals
from s2r_host.motion.scene import Scene, observed_scene
from s2r_host.motion.standing import THIN_DECK_M, deck_height
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.synthetic import Box, beam, faucet_view, look_at, pair

K = np.array([[600.0, 0, 320], [0, 600.0, 180], [0, 0, 1]])
SHAPE = (360, 640)
UP = np.array([0.0, 0.0, 1.0])
MIDDLE, HIGH_M, SPOKE_M = np.array([0.6, -0.14, 0.0]), 0.05, 0.045


def scene_of(spokes: int, high_m: float = HIGH_M, wide_m: float = 0.014) -> Scene:
    """A column with a spout on the table, and before it a knob with so many spokes, the first towards the arm."""
    column = beam(np.array([0.6, 0.08, 0.0]), np.array([0.6, 0.08, 0.2]), 0.04, 0.04)
    spout = beam(np.array([0.6, 0.08, 0.12]), np.array([0.48, 0.08, 0.15]), 0.022, 0.022)
    knob = [beam(MIDDLE, MIDDLE + (high_m - 0.007) * UP, 0.025, 0.025)]
    for angle in np.pi + 2.0 * np.pi * np.arange(spokes) / spokes:
        out = SPOKE_M * np.array([np.cos(angle), np.sin(angle), 0.0])
        knob.append(beam(MIDDLE + high_m * UP, MIDDLE + out + high_m * UP, wide_m, 0.014))
    X = look_at(np.array((0.0, -0.45, 0.55)), np.array([0.6, 0.0, 0.08]))
    table = np.eye(4)
    table[:3, 3] = (0.75, 0.0, -0.015)
    static = [Box(table, np.array([1.3, 1.6, 0.03])), column, spout, *knob]
    still = JointMotion("revolute", MIDDLE, UP, 0.0)
    return observed_scene(pair(static, [], still, K, SHAPE, X, np.random.default_rng(0)).before)


@pytest.mark.parametrize("spokes", [3, 4])
def test_a_knob_is_found_with_its_axis_and_its_spokes(spokes: int) -> None:
    knobs = find_knobs(scene_of(spokes))
    assert len(knobs) == 1
    found = knobs[0].spokes
    assert len(found) == spokes
    assert np.linalg.norm(found[0].p_root[:2] - MIDDLE[:2]) < 0.008
    angles = sorted(np.arctan2(one.direction[1], one.direction[0]) % (2.0 * np.pi / spokes) for one in found)
    off = np.array(angles) - (np.pi % (2.0 * np.pi / spokes))
    assert np.abs((off + np.pi / spokes) % (2.0 * np.pi / spokes) - np.pi / spokes).max() < np.radians(15.0)


def test_a_spoke_is_pushed_square_to_itself() -> None:
    spoke = find_knobs(scene_of(4))[0].spokes[0]
    pushes = list(lever_proposals(spoke, upright_axis(spoke)))
    assert {bool(push.direction @ pushes[0].direction > 0.0) for push in pushes} == {True, False}
    assert all(abs(push.direction @ spoke.direction) < 1e-6 for push in pushes)


def test_the_top_of_a_knob_is_no_deck() -> None:
    assert deck_height(scene_of(4).p_base) == THIN_DECK_M


@pytest.mark.parametrize("degrees", [45, 90])
def test_a_faucet_with_a_lever_has_no_knob(degrees: int) -> None:
    assert not find_knobs(observed_scene(faucet_view(np.random.default_rng(0), np.radians(degrees)).frame))


def test_a_flat_knob_on_the_table_is_found_though_it_passes_for_a_deck() -> None:
    scene = scene_of(4, high_m=0.012, wide_m=0.033)
    assert not find_knobs(scene)
    (knob,) = find_lying_knobs(scene)
    assert len(knob.spokes) == 4
    assert np.linalg.norm(knob.p_axis[:2] - MIDDLE[:2]) < 0.008


def test_what_stands_higher_or_has_something_on_it_does_not_lie() -> None:
    assert not find_lying_knobs(scene_of(4))
    faucet = observed_scene(faucet_view(np.random.default_rng(0), np.radians(45)).frame)
    assert not find_lying_knobs(faucet)
