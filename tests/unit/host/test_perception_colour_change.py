"""Colours tell whether anything moved, and say when they cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.perception.colour_change import colour_moved
from s2r_host.perception.frames import DepthFrame

SHAPE = (240, 320)
EVERYWHERE = np.ones(SHAPE, bool)


def looked(left: int, noise: float = 0.0, seed: int = 0) -> DepthFrame:
    """A grey bar, 12 px wide and 60 px long, before a slightly lighter wall."""
    colour = np.full((*SHAPE, 3), 120.0)
    colour[90:150, left : left + 12] = 95.0
    colour += np.random.default_rng(seed).normal(0.0, noise, colour.shape)
    depth = np.full(SHAPE, 0.8, np.float32)
    K = np.array([[300.0, 0.0, 160.0], [0.0, 300.0, 120.0], [0.0, 0.0, 1.0]])
    return DepthFrame(depth, K, np.eye(4), colour.clip(0, 255).astype(np.uint8))


@pytest.mark.parametrize("seed", range(5))
def test_what_stays_is_not_seen_to_move(seed: int) -> None:
    before, after = looked(100, 2.0, seed), looked(100, 2.0, seed + 100)
    assert colour_moved(before, after, EVERYWHERE) is False


def test_a_bar_three_pixels_on_has_moved() -> None:
    assert colour_moved(looked(100, 2.0), looked(103, 2.0, 1), EVERYWHERE) is True


def test_only_the_pixels_asked_for_count() -> None:
    elsewhere = EVERYWHERE.copy()
    elsewhere[:, 80:130] = False
    assert colour_moved(looked(100), looked(103), elsewhere) is False


def test_without_colours_or_from_another_place_they_do_not_tell() -> None:
    before, after = looked(100), looked(103)
    moved_camera = np.eye(4)
    moved_camera[0, 3] = 0.01
    assert colour_moved(before, replace(after, colour=None), EVERYWHERE) is None
    assert colour_moved(before, replace(after, X_base_camera=moved_camera), EVERYWHERE) is None
