"""Parts that no push brings to the target are refused at once, and the text says what they are stuck in."""

from __future__ import annotations

from pathlib import Path

import pytest

from s2r_host.planning.blocked import check_gets_there
from s2r_host.planning.planner import scene_of
from s2r_host.planning.settings import PlanSettings
from s2r_host.planning.task import PlanRefusedError, PlanRequest
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
SCENE = """<mujoco><compiler angle="radian"/><worldbody><body name="arm_base"/>
  <geom name="floor" type="plane" size="3 3 .1" pos="0 0 {floor}"/>
  <geom name="post" type="box" size=".01 .01 .2" pos="{post} -.05 .3"/>
  <body pos=".5 .15 .3"><joint name="hinge" axis="0 0 -1" range="0 1.8" damping="{damping}" frictionloss="{friction}"
    solreffriction="0.004 1" solimpfriction="0.99 0.999 0.0001"/>
    <geom type="box" pos="0 -.15 0" size=".009 .15 .2" mass="1.5"/>
    <geom name="grip" type="capsule" fromto="-.05 -.26 -.05 -.05 -.26 .05" size=".007"/></body>
</worldbody></mujoco>"""
FREE = {"floor": 0.0, "post": -2.0, "damping": 0.2, "friction": 0.3}


def _check(folder: Path, s_target: float = 0.7, **changed: float) -> None:
    path = folder / "door.xml"
    path.write_text(SCENE.format(**{**FREE, **changed}))
    request = PlanRequest(
        ARM, path, 0.0, s_target, ARM.q_home, "hinge", in_scene=True, settings=PlanSettings(threads=1)
    )
    check_gets_there(request, scene_of(request), 0.01)


@pytest.mark.parametrize("changed", [{}, {"friction": 3.0}, {"damping": 5.0}, {"s_target": 1.8}])
def test_a_door_that_turns_is_let_in(tmp_path, changed):
    _check(tmp_path, **changed)


def test_a_door_that_stands_in_the_floor_is_refused_with_the_depth(tmp_path):
    with pytest.raises(
        PlanRefusedError, match=r"overlaps by 50\.0 mm \(floor with a box of body 'hinge_part'\)"
    ):
        _check(tmp_path, floor=0.15)


def test_a_door_with_a_post_in_its_way_is_refused_only_beyond_the_post(tmp_path):
    _check(tmp_path, post=0.4, s_target=0.3)
    with pytest.raises(PlanRefusedError, match=r"there it overlaps by .* \(post with a box"):
        _check(tmp_path, post=0.4, s_target=1.4)


def test_a_door_that_is_too_stiff_is_refused_with_what_it_resists_with(tmp_path):
    with pytest.raises(
        PlanRefusedError, match=r"resists with friction 200 N·m, damping 0.2 N·m·s/rad: arm 'xmate3pro'"
    ):
        _check(tmp_path, friction=200.0)


def test_a_door_with_a_very_strong_damper_is_refused(tmp_path):
    with pytest.raises(PlanRefusedError, match=r"damping 2e\+03 N·m·s/rad: arm"):
        _check(tmp_path, damping=2000.0)
