"""The arm as a force gauge: what the part resisted a push with, and what the belief makes of it."""

import mujoco
import numpy as np
import pytest

from s2r_host.log.tables import Joints
from s2r_host.perception.motion import JointMotion
from s2r_host.run.belief import Belief
from s2r_host.run.measure import PartTemplate
from s2r_host.run.resistance import felt_resistance, tip_force, with_felt
from s2r_host.trajectory.torque import InverseDynamics
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
DT, DURATION = 0.001, 2.0
TOUCH = 0.45  # share of the motion


@pytest.fixture(scope="module")
def pushed():
    """A push from home, 12 N against it from the touch on, arm friction, torque noise; way and direction of the tip."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, DURATION, DT)
    x = t / DURATION
    way = np.array([0.05, 0.10, 0.02, 0.08, -0.03, 0.12, 0.02])
    rest = np.zeros((200, 7))
    q = ARM.q_home + np.outer(10 * x**3 - 15 * x**4 + 6 * x**5, way)
    dq = np.outer((30 * x**2 - 60 * x**3 + 30 * x**4) / DURATION, way)
    ddq = np.outer((60 * x - 180 * x**2 + 120 * x**3) / DURATION**2, way)
    dynamics = InverseDynamics(ARM)
    tau = dynamics.along(q, dq, ddq) + 0.6 * np.sign(way)
    p = dynamics.tool_positions(q)
    along = (p[-1] - p[0]) / np.linalg.norm(p[-1] - p[0])
    for k in np.flatnonzero(x > TOUCH):
        tau[k] += dynamics.tool_jacobian(q[k]).T @ (12.0 * along)
    tau += rng.normal(0.0, 0.15, tau.shape)
    q, dq = np.vstack([rest + q[0], q, rest + q[-1]]), np.vstack([rest, dq, rest])
    tau = np.vstack([rest + tau[0], tau, rest + tau[-1]])
    joints = Joints(ARM.joint_names, (1e9 * DT * np.arange(len(q))).astype(np.int64), q, dq, tau)
    return joints, p, along


def test_the_force_appears_at_the_touch_with_its_size_and_direction(pushed):
    joints, _, along = pushed
    force = tip_force(ARM, joints)
    before, after = force.share < 0.4, (force.share > 0.6) & (force.share < 0.9)
    assert np.linalg.norm(np.median(force.force_N[before], axis=0)) < 0.5
    assert np.median(force.force_N[after], axis=0) == pytest.approx(12.0 * along, abs=0.5)


@pytest.mark.parametrize("positive", [True, False])
def test_the_resistance_of_a_slide_and_of_a_hinge(pushed, positive):
    joints, p, along = pushed
    force = tip_force(ARM, joints)
    sign = 1.0 if positive else -1.0
    point = np.zeros((1, 3)), np.ones((1, 3))
    slide = PartTemplate(*point, JointMotion("prismatic", np.zeros(3), sign * along, 0.0))
    assert felt_resistance(slide, force, positive) == pytest.approx(12.0, rel=0.05)
    assert felt_resistance(slide, force, not positive) is None  # the part does not help the push
    middle = p[int(0.75 * len(p))]
    arm_m = np.cross(along, [0.0, 0.0, 0.15])  # the axis stands 15 cm beside the way
    axis = np.cross(-arm_m, along)
    axis /= np.linalg.norm(axis)
    hinge = PartTemplate(*point, JointMotion("revolute", middle + arm_m, sign * axis, 0.0))
    assert felt_resistance(hinge, force, positive) == pytest.approx(12.0 * np.linalg.norm(arm_m), rel=0.1)


def test_a_push_into_the_air_feels_nothing(pushed):
    joints, _, along = pushed
    free = joints.t < joints.t[0] + 0.2 + TOUCH * DURATION
    air = Joints(joints.names, joints.stamp_ns[free], joints.q[free], joints.dq[free], joints.tau[free])
    force = tip_force(ARM, air)
    slide = PartTemplate(np.zeros((1, 3)), np.ones((1, 3)), JointMotion("prismatic", np.zeros(3), along, 0.0))
    assert felt_resistance(slide, force, True) is None


def test_an_arm_that_rests_tells_nothing(pushed):
    joints, _, _ = pushed
    rest = Joints(joints.names, joints.stamp_ns[:150], joints.q[:150], joints.dq[:150], joints.tau[:150])
    assert tip_force(ARM, rest) is None


LID = """<mujoco><compiler angle="radian"/><worldbody><body name="object_base"/><body name="object_part">
<joint name="object_joint" axis="0 -1 0" range="-1 1" frictionloss="0.4"/>
<geom name="part_lid" type="box" pos="0.1 0 0" size="0.1 0.1 0.002" mass="0.5"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("felt", "positive", "friction"), [(1.5, True, 1.5 - 0.4905), (1.0, False, 1.4905), (0.6, True, 0.4)]
)
def test_friction_is_what_gravity_does_not_explain_and_never_less_than_believed(
    tmp_path, felt, positive, friction
):
    path = tmp_path / "object.xml"
    path.write_text(LID)
    hinge = JointMotion("revolute", np.zeros(3), np.array([0.0, -1.0, 0.0]), 0.0)
    template = PartTemplate(np.zeros((1, 3)), np.ones((1, 3)), hinge)
    after = with_felt(Belief(None, None, template, path, path, {}), felt, 0.0, positive, tmp_path / "model-1")
    assert after.felt == felt
    for side in (True, False):
        model = mujoco.MjModel.from_xml_path(str(after.path(side)))
        assert model.dof_frictionloss[0] == pytest.approx(friction, abs=1e-3)
