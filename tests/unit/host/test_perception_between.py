"""Frames from between two views sharpen a hinge, and what else they show changes nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from s2r_host.perception import synthetic as scenes
from s2r_host.perception.between import refined_between
from s2r_host.perception.estimate import JointEstimate, estimate_joint
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.motion import line_distance, rotation

TURN_RAD, SHARES = np.radians(20.0), (0.4, 0.7)
NOISE = 0.004  # at 1 m: twice a camera's


def closing(seed: int, share: float) -> scenes.Pair:
    """The same lid, closed or opened by a share of the whole turn."""
    return scenes.laptop_pair(np.random.default_rng(seed), share * TURN_RAD, NOISE)


@cache
def told(seed: int) -> tuple[scenes.Pair, tuple[DepthFrame, ...], JointEstimate]:
    whole = closing(seed, 1.0)
    frames = tuple(closing(seed, share).after for share in SHARES)
    return whole, frames, estimate_joint(whole.before, whole.after)


def hinge_off_mm(found: JointEstimate, pair: scenes.Pair) -> float:
    off = line_distance(found.axis_origin_m, found.axis_direction, pair.motion.origin[None])
    return 1e3 * float(off[0])


def axis_off_deg(found: JointEstimate, pair: scenes.Pair) -> float:
    cosine = float(found.axis_direction @ pair.motion.direction)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def vague(two: JointEstimate) -> JointEstimate:
    """The same joint told 2° and 8 mm off, and known to be told no better."""
    across = np.cross(two.axis_direction, [0.0, 0.0, 1.0])
    return replace(
        two,
        axis_direction=rotation(across / np.linalg.norm(across), np.radians(2.0)) @ two.axis_direction,
        axis_origin_m=two.axis_origin_m + np.array([0.0, 0.0, 0.008]),
        intervals90=replace(two.intervals90, axis_angle_rad=0.1, axis_offset_m=0.03),
    )


def test_a_hinge_told_vaguely_is_told_better_with_frames_from_between() -> None:
    pair, frames, two = told(0)
    start = vague(two)
    found = refined_between(start, pair.before, pair.after, frames)
    assert found.warnings == two.warnings
    assert found.delta == pytest.approx(TURN_RAD, abs=np.radians(0.8))
    assert axis_off_deg(found, pair) < 0.4 * axis_off_deg(start, pair)
    assert hinge_off_mm(found, pair) < 0.4 * hinge_off_mm(start, pair)
    width = np.ptp(two.intervals90.delta)
    assert np.ptp(found.intervals90.delta) == pytest.approx(width)
    assert np.mean(found.intervals90.delta) == pytest.approx(found.delta)
    both = found.moved_mask_before & two.moved_mask_before
    assert both.sum() > 0.9 * max(found.moved_mask_before.sum(), two.moved_mask_before.sum())


def test_frames_that_hands_cover_change_nothing_and_that_is_said() -> None:
    pair, frames, two = told(0)
    aside = np.zeros(frames[0].depth_m.shape, bool)
    aside[:, :150] = True
    covered = replace(frames[0], depth_m=np.where(aside, frames[0].depth_m, 0.0).astype(np.float32))
    found = refined_between(two, pair.before, pair.after, [covered])
    assert found.axis_direction is two.axis_direction
    assert "show no motion" in found.warnings[-1]


def test_frames_of_another_joint_are_not_believed() -> None:
    pair, _, two = told(0)
    narrow = replace(two, intervals90=replace(two.intervals90, axis_angle_rad=1e-5))
    found = refined_between(narrow, pair.before, pair.after, told(0)[1][:1])
    assert found.axis_direction is narrow.axis_direction
    assert "out of its 90 % interval" in found.warnings[-1]
