"""Colours tell whether anything moved, and say when they cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.perception.change import Change, Changes, compare, with_shadows
from s2r_host.perception.colour_change import colour_moved
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.synthetic import LeverLook, lever_look
from s2r_host.perception.view import DepthView

SHAPE = (240, 320)
EVERYWHERE = np.ones(SHAPE, bool)
HALF_M = np.array([0.06, 0.01, 0.007])  # of a lever


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


def shadowed() -> tuple[tuple[LeverLook, LeverLook], tuple[DepthFrame, DepthFrame]]:
    """Two looks at a lever, each without a return where the other one has the lever alone."""
    one, two = lever_look(2.2, HALF_M), lever_look(1.5, HALF_M)

    def frame(look: LeverLook, other: LeverLook) -> DepthFrame:
        return replace(look.frame, depth_m=np.where(other.part & ~look.part, 0.0, look.frame.depth_m))

    return (one, two), (frame(one, two), frame(two, one))


def moved(changes: Changes) -> list[np.ndarray]:
    return [label == Change.MOVED for label in (changes.before, changes.after)]


@pytest.mark.parametrize("by_colour", [False, True])
def test_a_lever_that_left_nothing_but_a_shadow_has_moved_by_its_colours(by_colour: bool) -> None:
    looks, frames = shadowed()
    views = [DepthView(frame) for frame in frames]
    changes = compare(views[0], views[1])
    found = moved(with_shadows(views[0], views[1], changes) if by_colour else changes)
    for view, look, other, label in zip(views, looks, looks[::-1], found, strict=True):
        own = (look.part & ~other.part).ravel()[view.flat]
        assert label[own].mean() > 0.7 if by_colour else not label[own].any()
        assert label[~look.part.ravel()[view.flat]].mean() < 0.001


def test_where_the_robot_was_left_out_nothing_has_moved() -> None:
    (one, two), (before, after) = shadowed()
    views = DepthView(before, two.part & ~one.part), DepthView(after, one.part & ~two.part)
    assert not any(label.any() for label in moved(with_shadows(*views, compare(*views))))


def test_without_colours_a_shadow_tells_nothing() -> None:
    _, frames = shadowed()
    views = [DepthView(replace(frame, colour=None)) for frame in frames]
    assert not any(label.any() for label in moved(with_shadows(views[0], views[1], compare(*views))))
