"""The table behind an open lid, and the keys under a shut one, are seen in one view only and did not move."""

from __future__ import annotations

import numpy as np

from s2r_host.perception import synthetic as scenes
from s2r_host.perception.change import Change
from s2r_host.perception.estimate import UP, prepare
from s2r_host.perception.revealed import with_revealed_level
from s2r_host.perception.view import DepthView


def test_what_a_lid_uncovers_of_the_table_counts_as_unmoved_and_the_lid_does_not():
    pair = scenes.laptop_pair(np.random.default_rng(3), turn_rad=0.6)
    rng = np.random.default_rng(0)
    scene, _ = prepare(pair.before, pair.after, None, None, None, rng)
    view = scene.before
    assert isinstance(view, DepthView)
    level = np.abs(view.points[:, 2]) < 0.003
    covered = level & (scene.changes.before == Change.UNKNOWN) & view.normal_ok
    on_lid = pair.part_before.ravel()[view.flat] & (view.points[:, 2] > 0.05)
    assert covered.sum() > 500
    found = with_revealed_level(scene, UP, rng)
    assert (found.changes.before[covered] == Change.STATIC).mean() > 0.9
    assert np.array_equal(found.changes.before[on_lid], scene.changes.before[on_lid])


def test_without_gravity_nothing_is_known_to_be_level():
    pair = scenes.laptop_pair(np.random.default_rng(3), turn_rad=0.6)
    rng = np.random.default_rng(0)
    scene, _ = prepare(pair.before, pair.after, None, None, None, rng)
    assert with_revealed_level(scene, None, rng) is scene
