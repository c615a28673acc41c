"""Lids and doors that show one face before the motion and the other after it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from s2r_host.perception import AbstainError, DepthFrame, estimate_joint
from s2r_host.perception import synthetic as scenes
from s2r_host.perception.motion import line_distance
from s2r_sim.objects.pair_data import UNIT_M, pair_object
from s2r_sim.objects.pairs import draw_pair
from s2r_sim.objects.splits import Split


def test_a_lid_that_turned_its_other_face_to_the_camera_is_answered_with_a_warning():
    pair = draw_pair("laptop", Split.VALIDATION, 1002)
    found = estimate_joint(
        DepthFrame(pair.depth_before, pair.K, pair.X_base_camera),
        DepthFrame(pair.depth_after, pair.K, pair.X_base_camera),
    )
    true_direction = np.sign(pair.delta) * np.array(pair.joint.direction)
    assert found.joint_type == "revolute"
    assert np.degrees(np.arccos(found.axis_direction @ true_direction)) < 3.0
    assert found.delta == pytest.approx(abs(pair.delta), abs=np.radians(2))
    hinge = line_distance(np.array(pair.joint.origin_m), true_direction, found.axis_origin_m[None])[0]
    assert hinge < found.intervals90.axis_offset_m
    assert any("one face before and the other after" in text for text in found.warnings)


@pytest.mark.parametrize("seed", [301, 303])
def test_a_lid_of_which_one_view_shows_the_edge_is_answered_the_right_way_round(seed: int):
    # 303: the lid, turned the other way, would come to lie in the table behind it.
    pair = draw_pair("laptop", Split.VALIDATION, seed)
    found = estimate_joint(
        DepthFrame(pair.depth_before, pair.K, pair.X_base_camera),
        DepthFrame(pair.depth_after, pair.K, pair.X_base_camera),
    )
    true_direction = np.sign(pair.delta) * np.array(pair.joint.direction)
    assert np.arccos(found.axis_direction @ true_direction) < found.intervals90.axis_angle_rad
    assert found.intervals90.delta[0] < abs(pair.delta) < found.intervals90.delta[1]
    hinge = line_distance(np.array(pair.joint.origin_m), true_direction, found.axis_origin_m[None])[0]
    assert hinge < found.intervals90.axis_offset_m
    assert any("little but the edge" in text for text in found.warnings)


def test_a_lid_seen_edge_on_afterwards_is_not_answered():
    pair = scenes.laptop_pair(np.random.default_rng(1), turn_rad=1.0)
    with pytest.raises(AbstainError, match="no single rigid motion"):
        estimate_joint(pair.before, pair.after)


@pytest.mark.parametrize("in_base", [True, False])
def test_a_lid_that_opens_from_nearly_shut_to_its_edge_did_not_sink_onto_its_base(
    tmp_path: Path, in_base: bool
):
    file = pair_object("laptop", Split.TRAIN, 0, str(tmp_path), quick=True)["file"]
    drawn = np.load(tmp_path / file)
    X = drawn["T_base_camera"] if in_base else np.eye(4)
    before, after = (DepthFrame(UNIT_M * drawn["depth"][k].astype(np.float32), drawn["K"], X) for k in (0, 1))
    with pytest.raises(AbstainError, match="explains 0 % of what moved in the second view"):
        estimate_joint(before, after, up=np.array([0.0, 0.0, 1.0]) if in_base else None)
