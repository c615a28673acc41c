"""Which of several parts: the one at a point."""

import numpy as np
import pytest

from s2r_host.errors import SceneError
from s2r_host.motion.push_proposals import PushProposal
from s2r_host.motion.scene import Scene
from s2r_host.run.at import proposals_at, scene_at
from s2r_host.run.settings import RunSettings
from s2r_host.run.task import LAPTOP, parse_point
from s2r_protocol.exits import UsageError


def test_a_point_is_three_numbers():
    assert parse_point("0.55, -0.02,0.2") == (0.55, -0.02, 0.2)


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "a,b,c", "nan,0,0", "inf,0,0"])
def test_anything_else_is_refused_by_name(text):
    with pytest.raises(UsageError, match="--at"):
        parse_point(text)


def test_the_scene_is_what_lies_around_the_point():
    p = np.random.default_rng(0).uniform(0.0, 1.0, (200_000, 3))
    scene = Scene(p, np.zeros(3))
    near = scene_at(scene, (0.5, 0.5, 0.5)).p_base
    assert 100 < len(near) < len(p)
    assert np.linalg.norm(near - 0.5, axis=1).max() < 0.08
    assert scene_at(scene, None) is scene


def test_a_point_beside_everything_is_refused_with_the_nearest_one():
    scene = Scene(np.full((500, 3), 0.3), np.zeros(3))
    with pytest.raises(
        SceneError, match=r"within 8 cm of --at 0.30,0.30,0.50; .* 0.30,0.30,0.30, 20 cm away"
    ):
        scene_at(scene, (0.3, 0.3, 0.5))


def test_proposals_elsewhere_are_left_out():
    ahead = np.array([1.0, 0.0, 0.0])
    pushes = [
        PushProposal(np.eye(4), np.array([x, 0.0, 0.0]), np.array([x, 0.0, 0.0]) + ahead, ahead)
        for x in (0, 1)
    ]
    assert list(proposals_at(iter(pushes), (1.0, 0.05, 0.0))) == pushes[1:]
    assert list(proposals_at(iter(pushes), None)) == pushes


def test_a_laptop_has_nothing_to_choose(tmp_path):
    with pytest.raises(UsageError, match="one lid"):
        RunSettings(target=0.5, task=LAPTOP, out=tmp_path / "run", at=(0.5, 0.0, 0.1))
