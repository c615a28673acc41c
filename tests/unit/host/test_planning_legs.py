"""Plans of several legs: where one place cannot carry the part the whole way, others carry it on."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from s2r_host.cli_plan import plan
from s2r_host.planning import OutOfReachError, PlanRefusedError, PlanRequest, PlanSettings
from s2r_host.planning.bench.verifier import verify
from s2r_host.planning.planner import scene_of, world_of
from s2r_host.planning.reach import stops_on_the_way
from s2r_host.trajectory import legs, plan_trajectory
from s2r_host.trajectory.legs import plan_legs
from s2r_host.trajectory.retreat import retreat
from s2r_host.trajectory.trajectory import Trajectory
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")

# A flap with a bar, hinged below: the bar is hooked from behind, but at the end it lies where no hand gets behind it.
OVEN = """<mujoco><compiler angle="radian"/><worldbody>
  <geom type="plane" size="3 3 .1"/><site name="arm_base"/>
  <body pos=".75 0 .45">
    <geom type="box" pos=".16 .29 0" size=".14 .01 .22"/><geom type="box" pos=".16 -.29 0" size=".14 .01 .22"/>
    <geom type="box" pos=".16 0 -.23" size=".15 .3 .01"/>
    <body pos="0 0 -.2">
      <joint name="flap" axis="0 -1 0" range="0 1.5" damping="1.5" frictionloss="{friction}"
        solreffriction="0.004 1" solimpfriction="0.99 0.999 0.0001"/>
      <geom type="box" pos="0 0 .2" size=".012 .28 .2" mass="{mass}"/>
      <geom type="capsule" fromto="-.06 -.2 .36 -.06 .2 .36" size=".01" mass=".1"/>
      <geom type="capsule" fromto="-.01 -.2 .36 -.06 -.2 .36" size=".008" mass=".05"/>
      <geom type="capsule" fromto="-.01 .2 .36 -.06 .2 .36" size=".008" mass=".05"/>
    </body>
  </body>
</worldbody></mujoco>"""
TARGET = 1.45
TAP = """<mujoco><compiler angle="radian"/><worldbody><site name="arm_base"/><body pos=".6 0 0">
  <geom type="cylinder" size=".02 .12" pos="0 0 .12"/>
  <body pos="0 0 .26">
    <joint name="tap" axis="0 0 1" damping=".2" frictionloss=".2"/>
    <geom type="capsule" size=".009" fromto="-.02 0 0 -.12 0 0" mass=".2"/>
  </body>
</body></worldbody></mujoco>"""


def request_for(path, target=TARGET, **changes):
    settings = PlanSettings(threads=1)
    return PlanRequest(
        ARM, path, 0.0, target, ARM.q_home, joint="flap", in_scene=True, settings=settings, **changes
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("legs")


@pytest.fixture(scope="module")
def oven(folder):
    path = folder / "oven.xml"
    path.write_text(OVEN.format(friction=6.0, mass=1.5))
    return path


@pytest.fixture(scope="module")
def opened(oven, folder):
    """What ``s2r plan`` says and leaves for an oven that is opened further than one place can."""
    options = ["--scene", str(oven), "--joint", "flap", "--target", str(TARGET), "--out", str(folder / "out")]
    result = CliRunner().invoke(plan, [*options, "--threads", "1", "--time-limit", "3600", "--json"])
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def test_where_one_place_does_not_do_the_part_is_left_on_the_way_and_carried_on(opened):
    first, *others = opened["legs"]
    assert others
    assert opened["held"]
    assert abs(opened["error"]) < 0.02
    assert first["s_initial"] == 0.0
    assert 0.2 < first["final"] < TARGET
    for before, after in zip(opened["legs"][:-1], opened["legs"][1:], strict=True):
        assert after["s_initial"] == before["s_left"]
        assert after["start_s"] > before["end_s"] > before["start_s"]
        assert not np.allclose(before["p_part"], after["p_part"], atol=0.02)
    assert opened["legs"][-1]["s_target"] == TARGET
    assert opened["legs"][-1]["s_left"] is None


def test_between_legs_the_part_stands_where_the_fine_model_left_it_and_nothing_touches_it(opened, folder):
    trace = np.genfromtxt(folder / "out" / "trace.csv", delimiter=",", names=True, deletechars="")
    for before, after in zip(opened["legs"][:-1], opened["legs"][1:], strict=True):
        standing = (trace["t"] > after["start_s"] - 0.4) & (trace["t"] < after["start_s"])
        assert standing.sum() > 100
        assert not trace["touch"][standing].any()
        assert trace["s"][standing] == pytest.approx(before["s_left"], abs=0.01)


def test_the_legs_are_one_motion_at_500_hertz_that_stands_up_to_the_verifier(opened, oven, folder):
    table = np.genfromtxt(folder / "out" / "plan.csv", delimiter=",", names=True, deletechars="")
    assert np.diff(table["t"]).max() <= 0.002 + 1e-9
    assert table["t"][-1] == pytest.approx(opened["duration_s"], abs=1e-6)
    knots = np.loadtxt(folder / "out" / "knots.csv", delimiter=",", skiprows=1)
    assert len(knots) <= 4096  # what the executor takes
    motion = Trajectory(knots[:, 0], *(knots[:, 1 + k * ARM.dof : 1 + (k + 1) * ARM.dof] for k in range(3)))
    request = request_for(oven)
    verdict = verify(motion, request, scene_of(request))
    assert verdict.good, verdict


def test_where_one_place_does_nothing_changes(folder):
    path = folder / "tap.xml"
    path.write_text(TAP)
    request = PlanRequest(
        ARM, path, 0.0, 0.4, ARM.q_home, joint="tap", in_scene=True, settings=PlanSettings(threads=1)
    )
    alone, delivery = plan_trajectory(request, accept_fragile=True)
    legged = plan_legs(request, accept_fragile=True)
    assert len(legged.legs) == 1
    assert np.array_equal(alone.q_cmd, legged.legs[0].result.q_cmd)
    assert np.array_equal(delivery.trajectory.q, legged.delivery.trajectory.q)


def test_stops_lie_on_the_way_the_farthest_first(oven):
    request = request_for(oven)
    scene = scene_of(request)
    stops = stops_on_the_way(scene, world_of(request, scene), TARGET, request.settings)
    assert len(stops) >= 2
    assert all(0.0 < stop < TARGET for stop in stops)
    assert stops[0] > stops[1]


def test_a_flap_that_falls_on_the_way_is_refused_with_that_reason(folder, monkeypatch):
    def out_of_reach(*_, **__):
        raise OutOfReachError("no place follows it")

    monkeypatch.setattr(legs, "plan_trajectory", out_of_reach)
    path = folder / "light.xml"
    # Held at its lower stop, but nowhere on the way there.
    path.write_text(OVEN.format(friction=1.0, mass=1.5).replace('range="0 1.5"', 'range="0 1.45"'))
    with pytest.raises(
        OutOfReachError, match="no place follows it; nor in several legs: the part does not stay on the way"
    ):
        plan_legs(request_for(path))


def test_a_part_that_does_not_stay_cannot_be_left(folder):
    path = folder / "spring.xml"
    path.write_text(
        OVEN.format(friction=1.0, mass=0.2).replace('damping="1.5"', 'damping="1.5" stiffness="30"')
    )
    # A moment after the motion the spring has not had time to show that it is stronger than the friction.
    settings = PlanSettings(threads=1, hold_s=0.02)
    request = PlanRequest(ARM, path, 0.4, 0.8, ARM.q_home, joint="flap", in_scene=True, settings=settings)
    standing = Trajectory(
        np.array([0.0, 0.01]), np.tile(ARM.q_home, (2, 1)), np.zeros((2, ARM.dof)), np.zeros((2, ARM.dof))
    )
    with pytest.raises(PlanRefusedError, match="the part does not stay: let go of, it goes from"):
        retreat(standing, request, scene_of(request))
