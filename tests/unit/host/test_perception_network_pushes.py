"""What the planner gets from the push network, with the weights that come with the package (no torch)."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from s2r_host.motion.push_proposals import PushProposal
from s2r_host.perception import synthetic
from s2r_host.perception.affordance import WEIGHTS
from s2r_host.perception.errors import BadViewError
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.network_pushes import NetworkPushSettings, push_proposals_from_network, shipped

ANY = NetworkPushSettings(least_likelihood=0.0)


@pytest.fixture(scope="module")
def frame():
    return synthetic.laptop_pair(np.random.default_rng(3)).before


@pytest.fixture(scope="module")
def proposals(frame):
    return list(push_proposals_from_network(frame, np.random.default_rng(0), settings=ANY))


def test_shipped_weights_are_small_and_say_what_data_they_come_from():
    assert sum(file.stat().st_size for file in WEIGHTS.iterdir()) < 15e6
    about = shipped().about
    assert len(about["data_sha256"]) == 64
    assert about["pushes"] >= 17_000
    assert about["onnx_difference"] < 1e-4


def test_proposals_are_poses_of_the_fingertip_like_those_of_the_rule(proposals):
    assert len(proposals) > 20
    settings = NetworkPushSettings()
    for push in proposals:
        assert isinstance(push, PushProposal)
        R = push.X_base_tool[:3, :3]
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1.0)
        assert R[2, 2] <= settings.steepest_z + 1e-9
        np.testing.assert_allclose(push.p_end - push.p_contact, settings.depth_m * push.direction, atol=1e-9)
        gap = push.p_contact - push.X_base_tool[:3, 3]
        np.testing.assert_allclose(gap, settings.standoff_m * push.direction, atol=1e-9)


def test_pushes_touch_the_object_that_is_seen(frame, proposals):
    seen = frame.points_base().reshape(-1, 3)
    seen = seen[np.isfinite(seen).all(axis=1)]
    for push in islice(proposals, 20):
        assert np.linalg.norm(seen - push.p_contact, axis=1).min() < 0.035


def test_the_same_seed_proposes_the_same(frame, proposals):
    again = list(push_proposals_from_network(frame, np.random.default_rng(0), settings=ANY))
    assert len(again) == len(proposals)
    np.testing.assert_array_equal(again[0].X_base_tool, proposals[0].X_base_tool)


def test_unlikely_pushes_are_not_offered(frame):
    sure = NetworkPushSettings(least_likelihood=1.01)
    assert not list(push_proposals_from_network(frame, np.random.default_rng(0), settings=sure))


def test_an_empty_table_is_refused_by_name(frame):
    low = frame.X_base_camera.copy()
    low[2, 3] -= 5.0
    with pytest.raises(BadViewError, match="points lie above the table"):
        next(push_proposals_from_network(DepthFrame(frame.depth_m, frame.K, low), np.random.default_rng(0)))
