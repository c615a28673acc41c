"""The base has all that was seen to stand: what the arm may run into, whether or not it is linked to the rest."""

import numpy as np
import pytest

from s2r_host.model.pieces import outside_m
from s2r_host.model.plates import base_pieces
from s2r_host.model.points import ObservedObject

UP = np.array([0.0, 0.0, 1.0])
P_CAMERA = np.array([0.0, -0.6, 0.5])
NOISE_M = 0.0007


def rod(
    start: tuple[float, float, float], end: tuple[float, float, float], radius_m: float, count: int, seed: int
):
    """Points on the camera's side of a round rod, and their normals, (n, 3) each."""
    rng = np.random.default_rng(seed)
    a, b = np.array(start), np.array(end)
    axis = (b - a) / np.linalg.norm(b - a)
    to_camera = P_CAMERA - 0.5 * (a + b)
    u = to_camera - (to_camera @ axis) * axis
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    angle, along = rng.uniform(-1.2, 1.2, count), rng.uniform(0.0, 1.0, count)
    n = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
    return a + along[:, None] * (b - a) + radius_m * n + rng.normal(0.0, NOISE_M, (count, 3)), n


def deck(low: tuple[float, float], high: tuple[float, float], z_m: float, count: int):
    """Points on a level plate, and their normals."""
    p = np.random.default_rng(7).uniform((*low, z_m), (*high, z_m), (count, 3))
    return p + np.random.default_rng(8).normal(0.0, NOISE_M, p.shape), np.tile(UP, (count, 1))


def seen(*shapes: tuple[np.ndarray, np.ndarray]) -> ObservedObject:
    """A lever of no matter what shape, and what stands around it."""
    part = np.random.default_rng(1).uniform((-0.01, -0.1, 0.1), (0.01, 0.0, 0.11), (300, 3))
    rest, normals = (np.concatenate([shape[k] for shape in shapes]) for k in (0, 1))
    return ObservedObject(part, np.zeros_like(part), rest, normals, UP, 0.0, P_CAMERA)


DECK = deck((-0.08, -0.06), (0.08, 0.06), 0.02, 6000)
SPOUT = rod((-0.15, 0.1, 0.18), (-0.05, 0.12, 0.18), 0.012, 900, 2)


def test_a_spout_that_is_seen_apart_from_its_body_is_of_the_base() -> None:
    pieces, warnings = base_pieces(seen(DECK, SPOUT), np.random.default_rng(0), 20.0)
    assert not warnings
    assert np.percentile(outside_m(SPOUT[0], pieces), 95) < 0.003
    assert np.percentile(outside_m(DECK[0], pieces), 95) < 0.003


def test_what_lies_between_two_clumps_is_not_filled() -> None:
    pieces, _ = base_pieces(seen(DECK, SPOUT), np.random.default_rng(0), 20.0)
    between = np.array([[-0.07, 0.09, 0.1], [-0.05, 0.08, 0.12]])
    assert (outside_m(between, pieces) > 0.01).all()


def test_a_strip_apart_too_thin_for_a_plate_is_of_the_base() -> None:
    """It used to count to the plane it lies in, and that plane's outline left it out."""
    strip = deck((0.1, -0.004), (0.3, 0.004), 0.06, 700)
    pieces, _ = base_pieces(seen(DECK, strip), np.random.default_rng(0), 20.0)
    assert np.percentile(outside_m(strip[0], pieces), 95) < 0.004


def test_a_few_points_in_the_air_are_nothing() -> None:
    rng = np.random.default_rng(3)
    ghost = rng.uniform((-0.2, -0.2, 0.3), (-0.18, -0.18, 0.32), (150, 3))
    pieces, _ = base_pieces(seen(DECK, (ghost, np.tile(UP, (150, 1)))), np.random.default_rng(0), 20.0)
    assert outside_m(ghost, pieces).min() > 0.1


def test_a_table_that_is_not_quite_flat_is_nothing() -> None:
    bump = deck((0.3, 0.2), (0.36, 0.26), 0.009, 500)
    pieces, _ = base_pieces(seen(DECK, bump), np.random.default_rng(0), 20.0)
    assert outside_m(bump[0], pieces).min() > 0.1


@pytest.mark.parametrize("count", [0, 150])
def test_hardly_anything_that_stands_makes_an_empty_base_and_says_so(count: int) -> None:
    pieces, (warning,) = base_pieces(
        seen(deck((-0.08, -0.06), (0.08, 0.06), 0.02, count)), np.random.default_rng(0), 20.0
    )
    assert not pieces
    assert "the base is empty" in warning
