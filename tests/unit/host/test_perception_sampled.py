"""Sampling the evidence finds a small part's motion from starts that lead downhill astray."""

import numpy as np
import pytest

from s2r_host.perception.levers import Column
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.refine import perturbed
from s2r_host.perception.sampled import sampled
from s2r_host.perception.synthetic import beam

PIVOT, UP = np.array([0.6, 0.0, 0.18]), np.array([0.0, 0.0, 1.0])
TURN_RAD = np.radians(25.0)


@pytest.fixture(scope="module")
def scene(lever_on_column):
    """A lever of 11 cm on a column, turned by 25° about it."""
    lever = beam(PIVOT, PIVOT + np.array([-0.05, -0.1, 0.01]), 0.02, 0.014)
    return lever_on_column(lever, JointMotion("revolute", PIVOT, UP, TURN_RAD))


def off_m(motion: JointMotion) -> float:
    """How far from where it should be the motion carries the lever, at most [m]."""
    p = PIVOT + np.linspace(0.3, 1.0, 5)[:, None] * np.array([-0.05, -0.1, 0.01])
    X, Y = motion.transform(), JointMotion("revolute", PIVOT, UP, TURN_RAD).transform()
    return float(np.linalg.norm(p @ (X - Y)[:3, :3].T + (X - Y)[:3, 3], axis=1).max())


def test_a_start_that_is_off_comes_near(scene):
    start = perturbed(
        JointMotion("revolute", PIVOT, UP, TURN_RAD), np.array([0.1, -0.08, 0.015, -0.01, -0.12])
    )
    (found,) = sampled([start], [], scene, np.random.default_rng(0))
    assert off_m(start) > 0.008
    assert off_m(found) < 0.5 * off_m(start)


def test_a_round_body_is_enough_to_begin_with(scene):
    column = Column(PIVOT + np.array([0.004, -0.003, 0.0]), UP, sure=True)
    found = sampled([], [column], scene, np.random.default_rng(0))
    assert min(off_m(motion) for motion in found) < 0.008


def test_slides_and_unsure_bodies_are_left_out(scene):
    slide = JointMotion("prismatic", PIVOT, UP, 0.05)
    assert sampled([slide], [Column(PIVOT, UP, sure=False)], scene, np.random.default_rng(0)) == []


def test_the_same_seed_gives_the_same_motions(scene):
    start = JointMotion("revolute", PIVOT, UP, 0.5)
    first, again = (sampled([start], [], scene, np.random.default_rng(7))[0] for _ in range(2))
    np.testing.assert_array_equal(first.transform(), again.transform())
