"""The arm as a force gauge: its own torques, the force at its fingertip, the object's joint behind it."""

from dataclasses import replace

import coal
import mujoco
import numpy as np
import pytest

from s2r_host.gap.recordings.files import read_recording
from s2r_host.log.tables import Joints
from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.obstacles import Obstacle
from s2r_host.perception.motion import JointMotion
from s2r_host.proprioception import object_log
from s2r_host.proprioception.following import Followed, PushedPart, follow, free_rows
from s2r_host.proprioception.object_log import ALONE, Touch, _blows, _clear, _in_the_mean, touches, write_log
from s2r_host.proprioception.object_numbers import learn_numbers
from s2r_host.proprioception.own_torques import learn_own_torques
from s2r_host.proprioception.samples import EVERY_S, Samples, samples_of
from s2r_host.proprioception.tip_force import TipForce, tip_force
from s2r_host.run.measure import PartTemplate
from s2r_host.run.object_file import with_lean
from s2r_host.trajectory.torque import InverseDynamics
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
DT, DURATION = 0.002, 2.0
COULOMB = np.array([0.6, 0.7, 0.5, 0.6, 0.4, 0.5, 0.6])
VISCOUS = np.array([0.3, 0.4, 0.1, 0.3, 0.1, 0.05, 0.05])
ROTOR = np.array([0.6, 0.6, 0.6, 0.6, 0.15, 0.15, 0.15])
PUSH = np.array([0.05, 0.10, 0.02, 0.08, -0.03, 0.12, 0.02])
TOUCH, PUSHED_N = 0.45, 12.0


def motion(
    way: np.ndarray, there_and_back: bool, touch: float | None = None
) -> tuple[Joints, np.ndarray, np.ndarray]:
    """What an arm with friction and rotors records of a motion from home; its fingertip's way and where that leads."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, DURATION, DT)
    x = t / DURATION
    if there_and_back:
        shape, speed, bend = (
            np.sin(np.pi * x) ** 2,
            np.pi * np.sin(2 * np.pi * x),
            2 * np.pi**2 * np.cos(2 * np.pi * x),
        )
    else:
        shape, speed, bend = (
            10 * x**3 - 15 * x**4 + 6 * x**5,
            30 * x**2 - 60 * x**3 + 30 * x**4,
            60 * x - 180 * x**2 + 120 * x**3,
        )
    q, dq, ddq = (
        ARM.q_home + np.outer(shape, way),
        np.outer(speed / DURATION, way),
        np.outer(bend / DURATION**2, way),
    )
    dynamics = InverseDynamics(ARM)
    tau = dynamics.along(q, dq, ddq) + COULOMB * np.tanh(dq / 0.002) + VISCOUS * dq + ROTOR * ddq
    p = dynamics.tool_positions(q)
    along = (p[-1] - p[0]) / max(float(np.linalg.norm(p[-1] - p[0])), 1e-9)
    if touch is not None:
        for k in np.flatnonzero(x > touch):
            tau[k] += dynamics.tool_jacobian(q[k]).T @ (PUSHED_N * along)
    tau += rng.normal(0.0, 0.15, tau.shape)
    stamps = (1e9 * DT * np.arange(len(q))).astype(np.int64)
    return Joints(ARM.joint_names, stamps, q, dq, tau), p, along


def samples(joints: Joints):
    found = samples_of(joints)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def own():
    """The arm, learnt from two motions through the air."""
    ways = (
        np.array([0.9, -0.5, 0.6, 0.7, -0.8, 0.6, 0.9]),
        np.array([-0.4, 0.6, -0.8, 0.5, 0.9, -0.7, -1.0]),
    )
    free = [samples(motion(way, there_and_back=True)[0]) for way in ways]
    learnt = learn_own_torques(
        ARM, [*free, free[0].part(slice(0, 0))]
    )  # of one that was in contact all the time
    assert learnt is not None
    return learnt


@pytest.fixture(scope="module")
def pushed():
    """A push against 12 N from a touch on."""
    return motion(PUSH, there_and_back=False, touch=TOUCH)


def test_the_arms_friction_is_learnt_from_motions_through_the_air(own):
    assert own.coulomb == pytest.approx(COULOMB, abs=0.08)
    assert own.rest.max() < 0.12


def test_rotors_that_no_description_tells_of_are_learnt_too(own):
    """Taken for inertia of the links they would be errors of tenths of newton metres elsewhere."""
    joints = motion(np.array([0.3, 0.4, 0.5, -0.6, 0.2, -0.8, 0.3]), there_and_back=True)[0]
    rows = samples(joints)
    moving = (np.abs(rows.dq) > 0.05).all(axis=1)
    left = rows.tau[moving] - own.along(rows)[moving]
    assert np.sqrt(np.mean(left**2, axis=0)) == pytest.approx(own.rest, abs=0.03)


@pytest.mark.parametrize("cycle_s", [0.001, 0.002, 0.004, 0.008])
def test_rows_are_five_milliseconds_apart_whatever_the_cycle_of_the_bus(cycle_s):
    """A classical bus has a cycle of 4 ms; what counts rows for seconds would take speeds for a fifth too low."""
    t = np.arange(0.0, DURATION, cycle_s)
    q = ARM.q_home + np.outer(t**2, PUSH)
    dq = np.outer(2.0 * t, PUSH)
    joints = Joints(ARM.joint_names, (1e9 * t).astype(np.int64), q, dq, np.ones_like(q))
    found = samples(joints)
    np.testing.assert_allclose(np.diff(found.t), EVERY_S, atol=1e-8)
    np.testing.assert_allclose(np.gradient(found.q, EVERY_S, axis=0)[1:-1], found.dq[1:-1], atol=2e-3)


def without(joints: Joints, lost: np.ndarray) -> Joints:
    """A recording that lost some rows."""
    kept = np.setdiff1d(np.arange(len(joints.q)), lost)
    assert joints.tau is not None
    return Joints(joints.names, joints.stamp_ns[kept], joints.q[kept], joints.dq[kept], joints.tau[kept])


def test_rows_that_a_recording_lost_bend_no_speed_and_move_no_time():
    whole, _, _ = motion(PUSH, there_and_back=False)
    lost = np.concatenate([np.arange(k, k + 7) for k in range(300, 700, 50)])
    ours, theirs = samples(without(whole, lost)), samples(whole)
    np.testing.assert_allclose(np.diff(ours.t), EVERY_S, atol=1e-8)
    assert len(ours) == len(theirs)
    np.testing.assert_allclose(ours.q, theirs.q, atol=2e-5)
    np.testing.assert_allclose(ours.ddq, theirs.ddq, atol=0.02)


def test_a_recording_that_lost_more_than_a_touch_takes_teaches_nothing():
    whole, _, _ = motion(PUSH, there_and_back=False)
    assert samples_of(without(whole, np.arange(400, 450))) is None


def test_too_short_a_motion_teaches_nothing():
    short = samples(motion(PUSH, there_and_back=False)[0]).part(slice(0, 20))
    assert learn_own_torques(ARM, [short]) is None


def test_an_arm_that_rests_tells_nothing():
    joints = motion(np.zeros(7), there_and_back=False)[0]
    assert samples_of(joints) is None


def test_the_force_appears_at_the_touch_with_its_size_and_direction(own, pushed):
    joints, _, along = pushed
    rows = samples(joints)
    force = tip_force(own, rows)
    before, after = rows.t < 0.4 * DURATION, (rows.t > 0.55 * DURATION) & (rows.t < 0.9 * DURATION)
    assert np.linalg.norm(np.median(force.force_N[before], axis=0)) < 1.0
    assert np.median(force.force_N[after], axis=0) == pytest.approx(PUSHED_N * along, abs=1.2)
    value, sigma = force.along(np.tile(along, (len(rows), 1)))
    assert np.mean(np.abs(value - PUSHED_N)[after] < 3.0 * sigma[after]) > 0.9


def plate_across(p: np.ndarray, along: np.ndarray) -> PushedPart:
    """A plate across a way, its near face at a point at joint value 0, that slides along it."""
    X = np.eye(4)
    X[:3, :3] = np.column_stack([along, *np.linalg.svd(along[None])[2][1:]])
    X[:3, 3] = p + 0.06 * along
    slide = PartTemplate(np.zeros((1, 3)), np.ones((1, 3)), JointMotion("prismatic", np.zeros(3), along, 0.0))
    return PushedPart([Obstacle("part_plate", coal.Box(0.05, 0.3, 0.3), X)], slide.pose, slide.velocity, True)


@pytest.mark.parametrize("positive", [True, False])
def test_a_pushed_slide_is_recorded_where_the_fingertip_is_with_the_force_it_took(
    own, pushed, positive, tmp_path
):
    """A plate across the way, touched at 45 % of the time and pushed to the end."""
    joints, p, along = pushed
    arm = ArmModel(ARM)
    sign = 1.0 if positive else -1.0
    # Its near face is where the fingertip ends; joint value 0 is there.
    X = np.eye(4)
    X[:3, 0] = along
    X[:3, 1] = np.cross([0.0, 0.0, 1.0], along) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], along))
    X[:3, 2] = np.cross(X[:3, 0], X[:3, 1])
    X[:3, 3] = p[-1] + 0.06 * along
    slide = PartTemplate(
        np.zeros((1, 3)), np.ones((1, 3)), JointMotion("prismatic", np.zeros(3), sign * along, 0.0)
    )
    part = PushedPart(
        [Obstacle("part_plate", coal.Box(0.05, 0.3, 0.3), X)], slide.pose, slide.velocity, positive
    )
    found = touches(own, arm, samples(joints), part, 0.0, 0.05 * sign, 0.2)
    assert len(found) == 1
    one = found[0]
    assert one.t[0] == pytest.approx(TOUCH * DURATION + 0.05, abs=0.06)
    assert one.s[-1] == pytest.approx(0.05 * sign, abs=2e-3)  # the camera's word, where it came to rest
    way = sign * (one.s - one.s[0])
    truth = np.interp(
        one.t, samples(joints).t, (own.dynamics.tool_positions(samples(joints).q) - p[0]) @ along
    )
    assert way == pytest.approx(truth - truth[0], abs=1e-3)
    assert np.median(one.effort) == pytest.approx(sign * PUSHED_N, abs=1.2)
    (path,) = write_log(found, "object_joint", tmp_path, "push", "a", hinged=False)
    recorded = read_recording(path)
    assert recorded.joints == ("object_joint",)
    assert recorded.effort == "measured"
    assert recorded.channels["tau"]["object_joint"] == pytest.approx(one.effort, rel=1e-5)
    # However good the gauge is, the axis is not.
    assert recorded.effort_sigma["object_joint"] > 0.07 * PUSHED_N


def test_a_part_that_goes_on_alone_is_where_it_was_met_and_not_where_it_ends(own, pushed):
    """The fingertip is taken back while it still moves; the part coasts on."""
    joints, p, along = pushed
    rows = samples(joints)
    part = plate_across(p[int(TOUCH * len(p))], along)
    going = rows.part(slice(0, int(0.8 * len(rows))))
    found = touches(own, ArmModel(ARM), going, part, 0.0, 0.09, 0.2)
    assert len(found) == 1
    truth = np.interp(
        found[0].t, rows.t, (own.dynamics.tool_positions(rows.q) - p[int(TOUCH * len(p))]) @ along
    )
    assert found[0].s == pytest.approx(truth, abs=4e-3)  # met within its first newtons


def test_what_the_arm_feels_before_it_is_there_is_no_place_of_the_part(own, pushed):
    """The part goes on alone, and a blow long before the touch passes for one."""
    joints, p, along = pushed
    rows = samples(joints)
    part = plate_across(p[int(TOUCH * len(p))], along)
    going = rows.part(slice(0, int(0.8 * len(rows))))
    tau, tips = going.tau.copy(), own.dynamics.tool_positions(going.q)
    early = (going.t > 0.2 * DURATION) & (going.t < 0.2 * DURATION + 0.04)
    for k in np.flatnonzero(early):
        tau[k] += own.dynamics.point_jacobian(going.q[k], tips[k])[:3].T @ (6.0 * along)
    truth = (own.dynamics.tool_positions(rows.q) - p[int(TOUCH * len(p))]) @ along
    ends = float(truth[int(0.8 * len(rows)) - 1]) + 0.004
    found = touches(own, ArmModel(ARM), replace(going, tau=tau), part, 0.0, ends, 0.2)
    assert found[-1].s == pytest.approx(np.interp(found[-1].t, rows.t, truth), abs=1e-2)


def test_another_place_that_the_fingertip_seems_to_meet_first_moves_nothing(own, pushed, monkeypatch):
    """As the model has it, the fingertip grazes a side wall far from the front that it pushes."""
    joints, p, along = pushed
    rows = samples(joints)
    part = plate_across(p[int(TOUCH * len(p))], along)
    going = rows.part(slice(0, int(0.8 * len(rows))))
    truth = (own.dynamics.tool_positions(rows.q) - p[int(TOUCH * len(p))]) @ along

    def grazes(*args):
        one = follow(*args)
        return replace(one, s=one.s + 0.2) if one is not None and len(one.rows) == 1 else one

    monkeypatch.setattr(object_log, "follow", grazes)
    ends = float(truth[int(0.8 * len(rows)) - 1]) + 0.004
    found = touches(own, ArmModel(ARM), going, part, 0.0, ends, 0.2)
    assert found[-1].s == pytest.approx(np.interp(found[-1].t, rows.t, truth), abs=1e-2)


@pytest.mark.parametrize(("slower", "recorded"), [(20.0, True), (2.0, False)])
def test_a_part_that_sticks_and_slips_is_recorded_in_the_mean_where_it_is_slow(own, pushed, slower, recorded):
    joints, p, along = pushed
    rows = samples(joints)
    t = np.arange(0.0, slower * rows.t[-1], EVERY_S)
    q, dq, ddq = (
        np.stack([np.interp(t / slower, rows.t, x) for x in table.T], axis=1) / slower**order
        for order, table in enumerate((rows.q, rows.dq, rows.ddq))
    )
    slow = Samples(t, q, dq, ddq, np.zeros_like(q))
    tips = own.dynamics.tool_positions(q)
    phase = np.mod(t / 0.2, 1.0)
    force_N = np.where(
        phase < 0.75, 3.0 + 4.0 * phase / 0.75, 7.0 - 16.0 * (phase - 0.75)
    )  # five slips a second
    tau = own.along(slow)
    for k in np.flatnonzero(t > TOUCH * slower * DURATION):
        tau[k] += own.dynamics.point_jacobian(q[k], tips[k])[:3].T @ (force_N[k] * along)
    part = plate_across(p[int(TOUCH * len(p))], along)
    ends = float((tips[-1] - p[int(TOUCH * len(p))]) @ along)
    found = touches(own, ArmModel(ARM), replace(slow, tau=tau), part, 0.0, ends, 0.2)
    means = [one for one in found if np.median(np.abs(one.ds)) < 0.015 and len(one.t) * EVERY_S > 2.0]
    assert bool(means) == recorded
    for one in means:
        assert np.median(one.effort) == pytest.approx(5.0, abs=0.4)
        assert np.ptp(one.effort) < 1.5


@pytest.mark.parametrize(("outwards", "recorded"), [("slowly", True), ("at once", False)])
def test_a_fingertip_may_slide_along_a_lever_that_sticks_but_not_jump(pushed, outwards, recorded):
    joints, *_ = pushed
    n = 400
    t, s = EVERY_S * np.arange(n), 0.08 * EVERY_S * np.arange(n)
    lever_m = np.linspace(0.06, 0.07, n) if outwards == "slowly" else np.where(s < 0.08, 0.06, 0.07)
    p = np.stack([lever_m, np.zeros(n), np.zeros(n)], axis=1)
    hinge = JointMotion("revolute", np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.0)
    template = PartTemplate(np.zeros((1, 3)), np.ones((1, 3)), hinge)
    part = PushedPart([], template.pose, template.velocity, True)
    force_N = np.tile([0.0, 7.0, 0.0], (n, 1))
    felt = TipForce(p, force_N, np.zeros((n, 3)), np.tile(0.01 * np.eye(6), (n, 1, 1)), np.ones(n))
    rows = samples(joints).part(np.zeros(n, dtype=int))
    found = _in_the_mean(replace(rows, t=t), Followed(np.arange(n), s, p), part, felt)
    assert len(found) == recorded
    for one in found:
        assert one.ds == pytest.approx(np.full(len(one.ds), 0.08), rel=1e-3)
        assert one.effort == pytest.approx(np.full(len(one.effort), 7.0 * 0.065), rel=0.1)


@pytest.mark.parametrize(("hinged", "told"), [(True, {"object_joint": 0.02}), (False, {})])
def test_a_recording_says_how_well_the_place_of_a_hinge_is_known(tmp_path, hinged, told):
    t = np.arange(0.0, 1.0, 0.005)
    touch = Touch(t, 0.3 * t, np.full(len(t), 0.3), np.ones(len(t)), np.full(len(t), 0.02), 0.02)
    (path,) = write_log([touch], "object_joint", tmp_path, "push", "a", hinged=hinged)
    assert read_recording(path).position_sigma == told


def test_where_the_part_stands_or_its_lever_is_uncertain_nothing_is_recorded():
    s = np.concatenate([np.full(40, 0.1), 0.1 + 0.4 * np.linspace(0.0, 1.0, 200), np.full(40, 0.5)])
    p = np.zeros((len(s), 3))
    p[:, 0] = np.where(s < 0.3, 0.1, 0.13)  # the fingertip's other edge, a third further out
    hinge = PartTemplate(
        np.zeros((1, 3)),
        np.ones((1, 3)),
        JointMotion("revolute", np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.0),
    )
    part = PushedPart([], hinge.pose, hinge.velocity, True)
    alone = np.ones(len(s), dtype=bool)
    clear = _clear(Followed(np.arange(len(s)), s, p), part, alone)
    assert len(clear) == 2
    assert clear[0].s.min() < 0.105 < 0.24 < clear[0].s.max() < 0.3 - 0.045
    assert 0.345 < clear[1].s.min() < 0.36
    assert sum(len(one.rows) for one in clear) < 200
    assert _clear(Followed(np.arange(100), np.full(100, 0.1), p[:100]), part, alone[:100]) == []
    assert _clear(Followed(np.arange(len(s)), s[::-1], p[::-1]), part, alone) == []  # against the fingertip
    # Something else is touched all along.
    assert _clear(Followed(np.arange(len(s)), s, p), part, ~alone) == []


def test_a_second_touch_shows_in_torques_that_no_force_at_the_fingertip_makes(own, pushed):
    joints, _, _ = pushed
    rows = samples(joints)
    pressed = (rows.t > 0.7 * DURATION) & (rows.t < 0.8 * DURATION)
    tau = rows.tau.copy()
    tau[pressed, 1] += 6.0  # the forearm leans on something
    tau[pressed, 3] -= 6.0
    alone, leaning = tip_force(own, rows), tip_force(own, replace(rows, tau=tau))
    touched = (rows.t > 0.55 * DURATION) & (rows.t < 0.9 * DURATION)
    assert np.median(alone.misfit[touched]) < 2.0
    assert leaning.misfit[pressed].min() > ALONE
    assert leaning.misfit[~pressed] == pytest.approx(alone.misfit[~pressed])


def test_a_force_beside_the_place_believed_turns_a_part_as_much_as_it_does(own, pushed):
    """3 mm nearer to a hinge 10 cm away a force turns 3 % less than it would there: its moment tells."""
    joints, _, along = pushed
    rows = samples(joints)
    touched = (rows.t > 0.55 * DURATION) & (rows.t < 0.9 * DURATION)
    across = np.cross(along, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    p = own.dynamics.tool_positions(rows.q)
    hinge = PartTemplate(
        np.zeros((1, 3)), np.ones((1, 3)),
        JointMotion("revolute", np.median(p, axis=0) + 0.1 * across, np.array([0.0, 0.0, 1.0]), 0.0),
    )  # fmt: skip
    part = PushedPart([], hinge.pose, hinge.velocity, True)
    assert part.turning == pytest.approx([0.0, 0.0, 1.0])
    there, _ = tip_force(own, rows, p).along(part.velocity(p), part.turning)
    beside = p + 0.003 * across
    with_moment, without = (
        tip_force(own, rows, beside).along(part.velocity(beside), turning)[0]
        for turning in (part.turning, None)
    )
    off = [np.median(np.abs(one - there)[touched]) for one in (with_moment, without)]
    assert off[0] < 0.8 * off[1]


@pytest.mark.parametrize("s_now", [0.0, 0.16])
def test_of_two_faces_that_the_fingertip_may_have_met_it_is_the_one_where_the_part_was(pushed, s_now):
    """A plate at the fingertip, and one 16 cm behind it, as the back of a drawer is."""
    joints, p, along = pushed
    part = plate_across(p[-1] + 0.01 * along, along)
    behind = plate_across(p[-1] - 0.15 * along, along)
    part = PushedPart([*part.shapes, *behind.shapes], part.pose, part.velocity, True)
    rows = samples(joints)
    followed = follow(ArmModel(ARM), rows, np.arange(len(rows))[-3:], part, s_now, 0.05, 0.2)
    assert followed is not None
    assert followed.s == pytest.approx(s_now, abs=0.06)


def test_a_push_is_free_until_the_fingertip_comes_near_the_part(pushed):
    joints, p, along = pushed
    rows = samples(joints)
    part = plate_across(p[int(TOUCH * len(p))] + 0.01 * along, along)
    free = free_rows(ArmModel(ARM), rows, part, 0.0)
    assert 0.2 * len(rows) < free < 0.9 * len(rows)
    assert free_rows(ArmModel(ARM), rows, part, -0.01) < free < free_rows(ArmModel(ARM), rows, part, 0.01)
    assert free_rows(ArmModel(ARM), rows, part, 0.5) == len(rows)  # the part is half a metre away


def test_a_motion_through_the_air_touches_nothing(own):
    joints = motion(PUSH, there_and_back=False)[0]
    slide = PartTemplate(
        np.zeros((1, 3)), np.ones((1, 3)), JointMotion("prismatic", np.zeros(3), np.array([1.0, 0, 0]), 0.0)
    )
    part = PushedPart(
        [Obstacle("part_plate", coal.Box(0.05, 0.3, 0.3), np.eye(4))], slide.pose, slide.velocity, True
    )
    assert touches(own, ArmModel(ARM), samples(joints), part, 0.0, 0.0, 0.2) == []


LID = """<mujoco><compiler angle="radian"/><worldbody><body name="object_base"/><body name="object_part">
<joint name="object_joint" axis="0 -1 0" range="-3 3" frictionloss="0.4" damping="0.1"/>
<geom name="part_lid" type="box" pos="0.1 0 0" size="0.1 0.1 0.002" density="3125"/></body></worldbody></mujoco>"""


def lid(tmp_path):
    path = tmp_path / "object.xml"
    path.write_text(LID)
    return path


def lid_touch(mjcf, mass_share: float, friction: float, damping: float, span: tuple[float, float]) -> Touch:
    """A lid turned at a speed that rises and falls, as an arm with 0.03 N·m of noise feels it."""
    rng = np.random.default_rng(3)
    x = np.linspace(0.0, 1.0, 401)
    t = 2.0 * x
    s = span[0] + (span[1] - span[0]) * (10 * x**3 - 15 * x**4 + 6 * x**5)
    ds = np.gradient(s, t)
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    weight = float(model.body_mass[2]) * 9.81 * 0.1 * np.cos(s)
    inertia = float(model.body_inertia[2, 1] + model.body_mass[2] * 0.1**2)
    effort = mass_share * (weight + inertia * np.gradient(ds, t)) + friction * np.sign(ds) + damping * ds
    return Touch(t, s, ds, effort + rng.normal(0.0, 0.03, len(s)), np.full(len(s), 0.03), 0.001)


def test_mass_and_friction_of_a_lid_are_told_apart_by_a_long_way(tmp_path):
    path = lid(tmp_path)
    numbers = learn_numbers(path, "object_joint", [lid_touch(path, 1.8, 1.2, 0.1, (0.2, 1.6))])
    assert numbers is not None
    assert 1.4 < numbers.mass_share < 1.9  # a prior about 1 holds it back
    assert numbers.friction == pytest.approx(1.2, abs=0.15)
    assert numbers.rest < 0.08


def test_what_a_short_way_does_not_tell_stays_as_guessed_and_the_sum_is_right(tmp_path):
    path = lid(tmp_path)
    numbers = learn_numbers(path, "object_joint", [lid_touch(path, 1.8, 1.2, 0.1, (0.2, 0.35))])
    assert numbers is not None
    assert numbers.sigma[0] > 0.2
    weight, speed = 0.5 * 9.81 * 0.1 * np.cos(0.27), 0.1
    learnt = numbers.mass_share * weight + numbers.friction + numbers.damping * speed
    assert learnt == pytest.approx(1.8 * weight + 1.2 + 0.1 * speed, abs=0.1)


def test_a_fingertip_that_jams_does_not_count_as_friction(tmp_path):
    path = lid(tmp_path)
    clean = lid_touch(path, 1.0, 1.2, 0.1, (0.2, 1.2))
    effort = clean.effort.copy()
    effort[340:] += 5.0 * np.linspace(0.0, 1.0, len(effort) - 340)  # the last seventh of the time
    numbers = learn_numbers(
        path, "object_joint", [Touch(clean.t, clean.s, clean.ds, effort, clean.sigma, 0.001)]
    )
    assert numbers is not None
    assert numbers.friction == pytest.approx(1.2, abs=0.15)


def test_a_drawer_that_sticks_keeps_its_mass(tmp_path):
    """Touches that slow down, the slower the more friction: without stiction a mass would stand for it."""
    path, mass = drawer(tmp_path)
    t = np.linspace(0.0, 0.6, 121)
    touched = []
    for top in (0.1, 0.05, 0.02):
        s = top * (t - 0.8 * t**2)
        ds = top * (1.0 - 1.6 * t)
        effort = mass * np.gradient(ds, t) + 3.0 + 3.0 * np.exp(-((ds / 0.02) ** 2))
        touched.append(Touch(t, s, ds, effort, np.full(len(t), 0.02), 0.001))
    numbers = learn_numbers(path, "object_joint", touched)
    assert numbers is not None
    assert numbers.mass_share == pytest.approx(1.0, abs=0.2)
    assert 3.0 < numbers.friction < 4.5  # as it rubs on average


def test_friction_is_as_sure_as_the_sum_of_what_it_is_of(tmp_path):
    """Slow nearly all along: what sticks and what rubs are one for the data, and only both together are known."""
    path, mass = drawer(tmp_path)
    touched = []
    for rows, speed in ((60, 0.1), (400, 0.012)):
        t = 0.005 * np.arange(rows)
        ds = speed * (1.0 + 0.1 * np.sin(20.0 * t))
        effort = mass * np.gradient(ds, t) + 3.0 + 3.0 * np.exp(-((ds / 0.02) ** 2))
        touched.append(Touch(t, speed * t, ds, effort, np.full(rows, 0.05), 0.001))
    numbers = learn_numbers(path, "object_joint", touched)
    assert numbers is not None
    rubs = 3.0 + 3.0 * np.mean(np.exp(-((np.concatenate([one.ds for one in touched]) / 0.02) ** 2)))
    assert numbers.friction == pytest.approx(rubs, abs=0.2)
    assert abs(numbers.friction - rubs) < 3.0 * numbers.sigma[1]
    assert numbers.sigma[1] < 0.2 * rubs


def drawer(tmp_path):
    """A slide along x whose part weighs 5 kg."""
    path = tmp_path / "object.xml"
    path.write_text(
        LID.replace('name="object_joint"', 'name="object_joint" type="slide"')
        .replace("0 -1 0", "1 0 0")
        .replace("3125", "62500")
    )
    return path, float(mujoco.MjModel.from_xml_path(str(path)).body_mass[2])


def drawer_touches(mass: float, friction: float, pull: float) -> list[Touch]:
    """Out and back at two speeds."""
    rng = np.random.default_rng(4)
    x = np.linspace(0.0, 1.0, 201)
    found = []
    for duration, sign in ((1.0, 1.0), (1.0, -1.0), (4.0, 1.0)):
        s = 0.1 * (10 * x**3 - 15 * x**4 + 6 * x**5)
        t, s = duration * x, s if sign > 0.0 else 0.1 - s
        ds = np.gradient(s, t)
        effort = mass * np.gradient(ds, t) + friction * np.sign(ds) + pull
        found.append(Touch(t, s, ds, effort + rng.normal(0.0, 0.03, len(s)), np.full(len(s), 0.03), 0.001))
    return found


def test_a_rail_that_leans_a_little_more_than_seen_is_learnt_as_that(tmp_path):
    path, mass = drawer(tmp_path)
    lean = 0.007
    numbers = learn_numbers(path, "object_joint", drawer_touches(mass, 3.0, lean * mass * 9.81))
    assert numbers is not None
    assert numbers.lean == pytest.approx(lean, abs=0.002)
    assert numbers.mass_share == pytest.approx(1.0, abs=0.15)
    before, after = (
        mujoco.MjModel.from_xml_path(str(p))
        for p in (path, with_lean(path, "object_joint", numbers.lean, tmp_path / "leans.xml"))
    )
    data = mujoco.MjData(after)
    mujoco.mj_forward(after, data)
    assert data.qfrc_bias[0] == pytest.approx(numbers.lean * mass * 9.81, rel=0.01)
    assert np.linalg.norm(after.opt.gravity) == pytest.approx(np.linalg.norm(before.opt.gravity))


def test_a_pull_is_neither_a_lean_nor_a_heavier_part(tmp_path):
    path, mass = drawer(tmp_path)
    numbers = learn_numbers(path, "object_joint", drawer_touches(mass, 3.0, 2.0))
    assert numbers is not None
    assert abs(numbers.lean) < 0.002
    assert numbers.mass_share == pytest.approx(1.0, abs=0.15)
    assert numbers.friction == pytest.approx(3.0, abs=0.2)


def test_a_hinge_does_not_lean(tmp_path):
    path = lid(tmp_path)
    numbers = learn_numbers(path, "object_joint", [lid_touch(path, 1.8, 1.2, 0.1, (0.2, 1.6))])
    assert numbers is not None
    assert numbers.lean == 0.0
    same = mujoco.MjModel.from_xml_path(str(with_lean(path, "object_joint", 0.1, tmp_path / "lid.xml")))
    assert same.opt.gravity == pytest.approx([0.0, 0.0, -9.81])


def test_nothing_felt_tells_nothing(tmp_path):
    assert learn_numbers(lid(tmp_path), "object_joint", []) is None


def test_a_blow_is_what_changes_fast_and_much():
    effort = np.full(200, 4.0)
    effort[100:104] = 1.0
    pushing = np.ones(200, dtype=bool)
    struck = _blows(effort, pushing)
    assert struck[100:104].all()
    assert not struck[:95].any()
    assert not struck[110:].any()
    assert not _blows(np.linspace(4.0, 8.0, 200), pushing).any()  # friction that grows where the part brakes
    assert not _blows(effort, np.zeros(200, dtype=bool)).any()
