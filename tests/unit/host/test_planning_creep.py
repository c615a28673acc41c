"""Parts that creep below a soft dry friction, and parts that half of their friction would not hold."""

from __future__ import annotations

from pathlib import Path

from s2r_host.planning.door import check_stays, creeping
from s2r_host.planning.planner import scene_of
from s2r_host.planning.settings import PlanSettings
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
