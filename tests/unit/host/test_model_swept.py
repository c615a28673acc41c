"""Points that stand where a lever went are its own, not the base's."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.model.pieces import box
from s2r_host.model.points import ObservedObject
from s2r_host.model.swept import without_swept
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


@pytest.mark.parametrize("angle_deg", [0.0, 7.0, 13.0, 20.0])
def test_what_the_lever_covered_on_its_way_goes(angle_deg):
    lever = [box("bar", "part", np.eye(4), LOW, HIGH)]
    assert len(without_swept(observed(at(0.09, angle_deg)), lever, TURN).rest) == 0


@pytest.mark.parametrize(
    "place", [at(0.09, 40.0), at(0.09, -20.0), at(0.09, 10.0, 0.18), at(0.15, 10.0), at(0.005, 0.0, 0.1)]
)
def test_what_stands_beside_below_or_beyond_it_stays(place):
    lever = [box("bar", "part", np.eye(4), LOW, HIGH)]
    assert len(without_swept(observed(place), lever, TURN).rest) == 1


def test_the_way_is_followed_backwards_too():
    lever = [box("bar", "part", np.eye(4), LOW, HIGH)]
    back = replace(TURN, delta=-TURN.delta)
    assert len(without_swept(observed(at(0.09, -10.0)), lever, back).rest) == 0
    assert len(without_swept(observed(at(0.09, 15.0)), lever, back).rest) == 1
