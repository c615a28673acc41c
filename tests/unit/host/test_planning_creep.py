"""Parts that creep below a soft dry friction, and parts that half of their friction would not hold."""

from __future__ import annotations

from pathlib import Path

from s2r_host.planning.planner import plan_manipulation, scene_of
from s2r_host.planning.settings import PlanSettings
from s2r_host.planning.staying import check_stays, creeping, s_after
from s2r_host.planning.task import PlanRequest
from s2r_host.trajectory.deliver import cannot_stay
from s2r_host.trajectory.perturb import PERTURBATIONS
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
SCENES = Path(__file__).parents[2] / "bench" / "scenes"
FIRM = 'solreffriction="0.004 1" solimpfriction="0.99 0.999 0.0001"'


def _request(path: Path, joint: str, s_initial: float, s_target: float) -> PlanRequest:
    settings = PlanSettings(threads=1)
    return PlanRequest(ARM, path, s_initial, s_target, ARM.q_home, joint, in_scene=True, settings=settings)


def test_a_part_that_creeps_slowly_is_let_in_and_told_what_to_set():
    request = _request(SCENES / "toggle.xml", "switch", -0.5, 0.5)
    scene = scene_of(request)
    check_stays(request, scene, 0.01)
    said = creeping(request, scene)
    assert said is not None
    assert f'give <joint name="switch"> {FIRM}, with which it moves by 0.00' in said


def test_with_what_it_says_the_part_stays(tmp_path):
    path = tmp_path / "toggle.xml"
    path.write_text((SCENES / "toggle.xml").read_text().replace('name="switch"', f'name="switch" {FIRM}'))
    request = _request(path, "switch", -0.5, 0.5)
    assert creeping(request, scene_of(request)) is None


def test_a_flap_that_half_its_friction_does_not_hold_is_fragile_whatever_the_plan():
    request = _request(SCENES / "oven.xml", "flap", 0.0, 1.3)
    assert cannot_stay(request, scene_of(request), PERTURBATIONS)


def test_a_door_about_an_upright_hinge_stays_with_any_friction():
    request = _request(SCENES / "door_bar.xml", "hinge", 0.0, -1.2)
    assert not cannot_stay(request, scene_of(request), PERTURBATIONS)


# A lid that leans on its friction: in MuJoCo it sinks by millimetres while the hand is on its way to its lip.
LID = """<mujoco><compiler angle="radian"/><worldbody><site name="arm_base"/>
  <geom type="plane" size="3 3 .1"/>
  <body pos=".45 0 .25"><geom type="box" pos=".12 0 -.1" size=".12 .12 .006"/>
    <geom type="box" pos=".24 0 -.01" size=".006 .12 .085"/>
    <body pos=".24 0 .08" euler="0 .5 0"><joint name="lid" axis="0 1 0" range="0 1.7" ref=".5" damping=".07"
        frictionloss="3"/>
      <geom type="box" pos="-.12 0 0" size=".12 .12 .006" mass=".3"/>
      <geom type="box" pos="-.255 0 .004" size=".02 .03 .004" mass=".02"/></body></body>
</worldbody></mujoco>"""


def test_the_hand_goes_below_where_a_creeping_lid_will_be(tmp_path):
    path = tmp_path / "lid.xml"
    path.write_text(LID)
    request = _request(path, "lid", 0.5, 0.9)
    scene = scene_of(request)
    assert s_after(request, scene, 1.0) < 0.47
    result = plan_manipulation(request, scene)
    assert result.success, result.reason
    assert result.hook.s_start < 0.48


def test_a_part_that_stays_is_hooked_where_it_is():
    request = _request(SCENES / "door_bar.xml", "hinge", 0.0, -0.4)
    assert plan_manipulation(request).hook.s_start == 0.0
