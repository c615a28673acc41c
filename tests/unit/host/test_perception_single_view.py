"""A joint from believed lines of motion: the fit, apart from the network that believes."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_host.perception.motion import unit
from s2r_host.perception.single_view import fit_lines

AXIS, ORIGIN = unit(np.array([0.2, 1.0, 0.1])), np.array([0.6, 0.1, 0.2])


def hinge_lines(rng, noise=0.0, wrong=0.0):
    points = ORIGIN + rng.uniform(-0.15, 0.15, (400, 3)) + np.array([0.1, 0.0, 0.1])
    lines = np.cross(AXIS, points - ORIGIN)
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    lines += noise * rng.normal(size=lines.shape)
    astray = rng.uniform(size=len(points)) < wrong
    lines[astray] = rng.normal(size=(astray.sum(), 3))
    lines *= rng.choice([-1, 1], len(points))[:, None]  # a line has no sense
    return points, lines / np.linalg.norm(lines, axis=1, keepdims=True)


def off(found):
    angle = np.degrees(np.arccos(min(1.0, abs(found.direction @ AXIS))))
    gap = ORIGIN - found.origin
    return angle, np.linalg.norm(gap - (gap @ AXIS) * AXIS)


def test_exact_lines_give_the_hinge():
    found = fit_lines(*hinge_lines(np.random.default_rng(0)))
    assert found.joint_type == "revolute"
    angle, line_m = off(found)
    assert angle < 0.1
    assert line_m < 0.001


@pytest.mark.parametrize("seed", range(3))
def test_noise_and_a_fifth_of_wrong_lines_do_little(seed):
    found = fit_lines(*hinge_lines(np.random.default_rng(seed), noise=0.1, wrong=0.2))
    assert found.joint_type == "revolute"
    angle, line_m = off(found)
    assert angle < 5
    assert line_m < 0.02


def test_parallel_lines_give_a_slide():
    rng = np.random.default_rng(0)
    lines = AXIS + 0.08 * rng.normal(size=(300, 3))
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    found = fit_lines(rng.uniform(-0.2, 0.2, (300, 3)), lines)
    assert found.joint_type == "prismatic"
    assert abs(found.direction @ AXIS) > np.cos(np.radians(1))
