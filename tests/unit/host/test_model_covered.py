"""Points that stand where a lever was before and after are its own; what stands between the two is the base's."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.model.covered import without_covered
from s2r_host.model.pieces import box
from s2r_host.model.points import ObservedObject
from s2r_host.perception.motion import JointMotion

UP = np.array([0.0, 0.0, 1.0])
LOW, HIGH = (
    np.array([0.03, -0.01, 0.2]),
    np.array([0.13, 0.01, 0.216]),
)  # a lever along x, hinged at the origin
TURN = JointMotion("revolute", np.zeros(3), UP, np.radians(20.0))


def observed(rest) -> ObservedObject:
    rest = np.atleast_2d(np.array(rest, dtype=float))
    part = np.random.default_rng(0).uniform(LOW, HIGH, (300, 3))
    return ObservedObject(part, np.zeros_like(part), rest, np.zeros_like(rest), UP, 0.0, None)


def at(radius_m: float, angle_deg: float, height_m: float = 0.208):
    angle = np.radians(angle_deg)
    return radius_m * np.cos(angle), radius_m * np.sin(angle), height_m


LITTLE = replace(TURN, delta=np.radians(8.0))


@pytest.mark.parametrize("angle_deg", [0.0, 4.0, 8.0])
def test_what_the_lever_covers_before_and_after_a_small_turn_goes(angle_deg):
    lever = [box("bar", "part", np.eye(4), LOW, HIGH)]
    assert len(without_covered(observed(at(0.09, angle_deg)), lever, LITTLE).rest) == 0


def test_a_spout_seen_twice_beside_the_levers_way_stays():
    """It was taken for the lever, and the fingertip ran into it."""
    lever = [box("bar", "part", np.eye(4), LOW, HIGH)]
    beside = [at(0.09, 20.0, 0.196), at(0.09, 10.0, 0.196), at(0.12, 26.0)]
    assert len(without_covered(observed(beside), lever, replace(TURN, delta=np.radians(25.0))).rest) == 3


@pytest.mark.parametrize(
    "place", [at(0.09, 30.0), at(0.09, -20.0), at(0.09, 4.0, 0.18), at(0.15, 4.0), at(0.005, 0.0, 0.1)]
)
def test_what_stands_beside_below_or_beyond_it_stays(place):
    lever = [box("bar", "part", np.eye(4), LOW, HIGH)]
    assert len(without_covered(observed(place), lever, LITTLE).rest) == 1


def test_small_turns_the_other_way_count_too():
    lever = [box("bar", "part", np.eye(4), LOW, HIGH)]
    back = replace(LITTLE, delta=-LITTLE.delta)
    assert len(without_covered(observed(at(0.09, -4.0)), lever, back).rest) == 0
    assert len(without_covered(observed(at(0.09, 12.0)), lever, back).rest) == 1
