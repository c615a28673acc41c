"""What moving a part takes of the arm, by statics, against the physics engine's own numbers."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from s2r_host.planning.effort import Resistance, efforts
from s2r_host.planning.kinematics import ToolKinematics
from s2r_host.planning.planner import scene_of, world_of
from s2r_host.planning.settings import PlanSettings
from s2r_host.planning.task import PlanRequest
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
SCENE = """<mujoco><compiler angle="radian"/><worldbody><site name="arm_base"/><body name="part" pos=".6 0 .2">
<joint name="part" type="{kind}" axis="{axis}" frictionloss="3" damping="2" stiffness="{stiffness}"/>
<geom type="box" size=".01 .2 .1" pos="0 .2 .1" mass="1.5"/></body></worldbody></mujoco>"""


@pytest.fixture
def heavy(tmp_path):
    """A part in its scene: returns scene and the world at its start."""

    def made(kind: str, axis: str, stiffness: float = 0.0):
        path = tmp_path / "scene.xml"
        path.write_text(SCENE.format(kind=kind, axis=axis, stiffness=stiffness))
        settings = PlanSettings(threads=1)
        request = PlanRequest(ARM, path, 0.0, 0.1, ARM.q_home, "part", in_scene=True, settings=settings)
        scene = scene_of(request)
        return scene, world_of(request, scene)

    return made


def test_a_drawer_takes_its_friction_and_damping_at_any_point(heavy):
    scene, world = heavy("slide", "1 0 0")
    force_N = Resistance(scene, world, [0.0, 0.1], 1.0).force(0, np.array([[0.6, 0.1, 0.3], [0.6, 0.4, 0.2]]))
    np.testing.assert_allclose(force_N, [[3.2, 0.0, 0.0]] * 2, atol=1e-9)


def test_a_spring_resists_more_the_further_the_part_is(heavy):
    scene, world = heavy("slide", "1 0 0", stiffness=20.0)
    resistance = Resistance(scene, world, [0.0, 0.1], 1.0)
    point = np.array([[0.6, 0.1, 0.3]])
    assert (resistance.force(1, point) - resistance.force(0, point))[0, 0] == pytest.approx(2.0)


def test_a_flap_is_lifted_against_its_weight_and_let_down_with_none(heavy):
    scene, world = heavy("hinge", "1 0 0")
    point = np.array([[0.6, 0.4, 0.2]])  # 0.4 m from the hinge; the weight is at 0.2 m
    up = Resistance(scene, world, [0.0], 1.0).force(0, point)[0]
    assert up[2] == pytest.approx((1.5 * 9.81 * 0.2 + 3.0 + 2.0 * 0.1 / 0.4) / 0.4, rel=1e-6)
    down = Resistance(scene, world, [0.0], -1.0).force(0, point)[0]
    assert down[2] == pytest.approx(-(3.0 - 1.5 * 9.81 * 0.2 + 0.5) / 0.4, rel=1e-6)


def test_near_the_hinge_it_takes_more(heavy):
    scene, world = heavy("hinge", "0 0 1")
    force_N = Resistance(scene, world, [0.0], 1.0).force(0, np.array([[0.6, 0.4, 0.3], [0.6, 0.1, 0.3]]))
    near, far = np.linalg.norm(force_N, axis=1)[::-1]
    assert near > 4.0 * far


def test_joint_torques_are_those_that_hold_the_arm_against_the_force(heavy):
    scene, world = heavy("slide", "0 1 0")
    resistance = Resistance(scene, world, [0.0], 1.0)
    q = np.array([0.3, 0.4, -0.2, 1.1, 0.5, 0.9, -0.4])
    share = efforts(ToolKinematics(scene, 0.05), resistance, q[None, None], ARM.limits.tau_max)
    model = scene.fine
    data = mujoco.MjData(model)
    data.qpos[: ARM.dof] = q
    mujoco.mj_forward(model, data)
    torque = np.zeros(model.nv)
    site = scene.tool_site
    force_N = resistance.force(0, data.site_xpos[site][None])[0]
    mujoco.mj_applyFT(
        model, data, force_N, np.zeros(3), data.site_xpos[site].copy(), int(model.site_bodyid[site]), torque
    )
    assert share[0] == pytest.approx((np.abs(torque[: ARM.dof]) / ARM.limits.tau_max).max(), rel=1e-4)
