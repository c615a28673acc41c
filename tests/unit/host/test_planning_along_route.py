"""A part so heavy that sampling gets stuck is moved along the route itself, when that is asked for."""

from dataclasses import replace
from pathlib import Path

import pytest

from s2r_host.planning import PlanRequest, PlanSettings
from s2r_host.planning.along_route import AlongRoute
from s2r_host.planning.planner import plan_manipulation, scene_of
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
GATE = Path(__file__).parents[2] / "bench/scenes_outside/garage_door.xml"  # 41 kg on rollers
CHEAPEST = PlanSettings().cascade[:1]


@pytest.fixture(scope="module")
def request_and_scene():
    settings = PlanSettings(threads=1, cascade=CHEAPEST)
    request = PlanRequest(ARM, GATE, 0.0, 0.3, ARM.q_home, "gate", in_scene=True, settings=settings)
    return request, scene_of(request)


def test_sampling_alone_gets_stuck(request_and_scene):
    request, scene = request_and_scene
    result = plan_manipulation(request, scene)
    assert not result.success
    assert "no progress" in result.reason or "not reached" in result.reason


def test_the_route_itself_moves_it(request_and_scene):
    request, scene = request_and_scene
    wanted = replace(request, settings=replace(request.settings, along_route=True))
    result = plan_manipulation(wanted, scene)
    assert result.success, result.reason
    assert abs(result.final - 0.3) < request.settings.tolerance_m


def test_a_leg_that_has_to_be_left_again_is_not_played_so(request_and_scene, monkeypatch):
    request, scene = request_and_scene
    played = []
    monkeypatch.setattr(AlongRoute, "run", lambda self: played.append(self))
    wanted = replace(request, leave=True, settings=replace(request.settings, along_route=True))
    plan_manipulation(wanted, scene)
    assert not played
