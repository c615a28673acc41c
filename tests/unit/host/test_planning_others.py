"""Things that carry the part and do not stand where their file has them: the plan is the same as if they did."""

import numpy as np
import pytest

from s2r_host.planning import PlanRequest, PlanSettings, plan_manipulation
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.planner import scene_of
from s2r_host.planning.sample_objects import DrawerShape, drawer_mjcf
from s2r_host.trajectory import plan_trajectory
from s2r_host.trajectory.reactive import ReactivePlanner
from s2r_host.trajectory.shift import shift_with_part
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
TURN_RAD = 0.4


def on_a_turntable(folder, turned_in_file: bool) -> PlanRequest:
    """A cabinet on a turntable that hardly turns, at 0.4 rad: by its file, or by where it stands in it."""
    at_rad, stands_rad = (TURN_RAD, 0.0) if turned_in_file else (0.0, TURN_RAD)
    table = (
        f'<body name="turntable" pos="0.75 0 0" euler="0 0 {at_rad}">'
        '<joint name="table_joint" type="hinge" axis="0 0 1" damping="1e5" armature="1e4"/>'
        '<inertial pos="0 0 0.1" mass="20" diaginertia="1 1 1"/>'
    )
    text = drawer_mjcf(DrawerShape(x=-0.2)).replace("<worldbody>", f"<worldbody>{table}")
    path = folder / f"object_{turned_in_file}.xml"
    path.write_text(text.replace("</worldbody>", "</body></worldbody>"))
    others = np.array([stands_rad, 0.0])
    return PlanRequest(ARM, path, 0.0, 0.1, ARM.q_home, settings=PlanSettings(threads=1), others=others)


@pytest.fixture(scope="module")
def requests(tmp_path_factory) -> tuple[PlanRequest, PlanRequest]:
    folder = tmp_path_factory.mktemp("turntable")
    return on_a_turntable(folder, True), on_a_turntable(folder, False)


def test_the_fingertip_goes_along_with_the_part_as_it_stands(requests):
    along = [shift_with_part(ARM.q_home, 0.05, scene_of(one), one.others) for one in requests]
    assert along[0] == pytest.approx(along[1], abs=1e-9)


def test_plan_and_motion_are_those_of_the_part_as_it_stands(requests):
    plans = [plan_manipulation(one) for one in requests]
    assert plans[0].success
    assert plans[0].q_cmd == pytest.approx(plans[1].q_cmd, abs=1e-6)
    motions = [plan_trajectory(one)[1].trajectory for one in requests]
    assert motions[0].q == pytest.approx(motions[1].q, abs=1e-6)


def test_a_motion_is_watched_with_everything_where_it_stands(requests):
    request = requests[1]
    scene = scene_of(request)
    result, delivery = plan_trajectory(request, scene=scene)
    planner = ReactivePlanner(request, scene, result.hook)
    planner.begin(delivery.trajectory)
    truth = FineWorld(scene, ARM.q_home, request.s_initial, request.others)
    outlook = planner.look(delivery.trajectory, 0.0, truth.s)
    assert outlook.motion is None
    assert outlook.running_end == pytest.approx(delivery.replay.final, abs=1e-3)
