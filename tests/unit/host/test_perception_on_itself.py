"""A lever that turns by less than it is wide lands on its own former place."""

import numpy as np
import pytest

from s2r_host.perception.evidence import (
    COST_ON_ITSELF,
    COST_ON_SURFACE,
    COST_STATIC,
    Scene,
    carry,
    probe,
    score,
)
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.synthetic import beam

PIVOT, UP = np.array([0.6, 0.0, 0.18]), np.array([0.0, 0.0, 1.0])
WIDTH_M = 0.045
TURN = JointMotion("revolute", PIVOT, UP, np.radians(16.0))


@pytest.fixture(scope="module")
def scene(lever_on_column):
    """A lever as wide as half its length on a column, turned by 16° about it."""
    lever = beam(PIVOT, PIVOT + np.array([-0.04, -0.09, 0.0]), WIDTH_M, 0.02)
    return lever_on_column(lever, TURN, 0.03)


@pytest.fixture(scope="module")
def moved(scene):
    rng = np.random.default_rng(0)
    before, after = scene.moved_before(), scene.moved_after()
    return probe(scene.before, before, 400, rng), probe(scene.after, after, 400, rng)


def costs(motion, scene, moved, **options):
    return carry(motion.transform()[None], moved[0], scene.after, scene.changes.after, 0.001, **options)[0]


def test_the_scene_is_one_where_most_of_the_lever_lands_on_itself(scene, moved):
    assert scene.small()
    assert np.mean(costs(TURN, scene, moved) == COST_STATIC) > 0.3


def test_of_a_lever_that_is_hardly_held_against_the_motion(scene, moved):
    as_plate, as_lever = costs(TURN, scene, moved), costs(TURN, scene, moved, small=True)
    on_static = as_plate == COST_STATIC
    assert np.mean(as_lever[on_static] == COST_ON_ITSELF) > 0.9
    assert (as_lever[~on_static] == as_plate[~on_static]).all()
    assert COST_ON_ITSELF <= COST_ON_SURFACE


def test_landing_on_what_stands_still_is_held_against_it_as_before(scene, moved):
    """Lowered on to the table, it meets what is there in both views; from there it would go on into the ground."""
    down = JointMotion("prismatic", PIVOT, -UP, PIVOT[2] + 0.01)
    lowered = costs(down, scene, moved, small=True)
    assert np.mean(lowered == COST_STATIC) > 0.3
    assert not (lowered == COST_ON_ITSELF).any()


def test_the_true_turn_fits_better_than_twice_as_much(scene, moved, monkeypatch):
    twice = JointMotion("revolute", PIVOT, UP, 2.0 * TURN.delta)
    true, more = score([TURN, twice], scene, *moved, 0.001)
    assert true < 0.75 * more
    monkeypatch.setattr(Scene, "small", lambda self: False)
    true, more = score([TURN, twice], scene, *moved, 0.001)
    assert true > more  # a plate of that size would be told to have turned by 32°
