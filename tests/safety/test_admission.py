"""Admission at every limit from both sides: just inside is admitted, just outside is refused by name.

Each quantity is also driven over its limit only between knots, where looking at the knots would see nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from s2r_executor.admission import Admission
from s2r_executor.bridge_motion import PathState, bridge
from s2r_executor.checks.bounds import check_bounds
from s2r_executor.checks.collision import CollisionModel
from s2r_executor.config import AdmissionConfig, BoxZone, CoreConfig
from s2r_executor.plan import CommandRefusedError, PlanRequest
from s2r_executor.quintic import sample, spline_through
from s2r_protocol.arms import ArmDescription, load_arm
from s2r_protocol.arms.source import Box
from s2r_protocol.faults import Refusal

ARM = load_arm("xmate3pro")
NAMES = ARM.joint_names
Q = np.array([0.0, 0.3, 0.0, 1.2, 0.0, 0.6, 0.0])  # stretched out in front, far from the table and itself
ADMISSION = Admission(ARM, AdmissionConfig(), CoreConfig())


def move(delta, duration_s, q0=Q, knots=2):
    """Minimum-jerk move by ``delta`` [rad]."""
    t = np.linspace(0.0, duration_s, knots)
    x = t / duration_s
    step = np.array(delta, float)
    s, ds = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / duration_s
    dds = 60 * x * (1 - x) * (1 - 2 * x) / duration_s**2
    return PlanRequest(NAMES, t, q0 + s[:, None] * step, ds[:, None] * step, dds[:, None] * step)


def one_joint(joint, amount):
    delta = np.zeros(7)
    delta[joint] = amount
    return delta


def refused(plan, q_ref=Q, admission=ADMISSION):
    with pytest.raises(CommandRefusedError) as error:
        admission.admit(plan, q_ref)
    assert "; " in str(error.value), "what is wrong, and after it what to do"
    return error.value


def test_a_modest_plan_is_admitted_with_a_stop_for_every_segment():
    plan = move([0.2, -0.1, 0.1, 0.2, -0.2, 0.1, 0.5], 2.0, knots=9)
    admitted = ADMISSION.admit(plan, Q)
    assert admitted.stop_duration.shape == (8,)
    assert (admitted.stop_duration > 0).all()
    assert all(0 < share < 1 for share in admitted.margins.values())
    np.testing.assert_array_equal(admitted.q, plan.q)


# -- form ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["q", "dq", "ddq"])
def test_not_a_number_is_refused_at_every_position_of_every_field(field, bad):
    plan = move(one_joint(0, 0.1), 1.0, knots=3)
    for knot in range(3):
        for joint in range(7):
            values = getattr(plan, field).copy()
            values[knot, joint] = bad
            error = refused(replace(plan, **{field: values}))
            assert error.code is Refusal.NONFINITE
            assert error.joint == NAMES[joint]
            assert error.quantity == field
            assert error.t == plan.t[knot]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_not_a_number_as_time_is_refused(bad):
    for knot in range(3):
        plan = move(one_joint(0, 0.1), 1.0, knots=3)
        plan.t[knot] = bad
        assert refused(plan).code is Refusal.NONFINITE


@pytest.mark.parametrize("field", ["splice_t", "payload_mass", "path_tolerance", "goal_tolerance"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_not_a_number_as_scalar_is_refused_by_name(field, bad):
    error = refused(replace(move(one_joint(0, 0.1), 1.0), **{field: bad}))
    assert (error.code, error.quantity) == (Refusal.NONFINITE, field)


def test_denormal_numbers_are_ordinary_numbers():
    plan = move(one_joint(0, 0.1), 1.0, knots=3)
    plan.dq[1, 3] = 5e-324
    ADMISSION.admit(plan, Q)


@pytest.mark.parametrize("value", [1e300, -1e300, 1e17, 2.0**63])
@pytest.mark.parametrize("field", ["q", "dq", "ddq"])
def test_huge_finite_numbers_are_refused(field, value):
    plan = move(one_joint(0, 0.1), 1.0, knots=3)
    getattr(plan, field)[1, 2] = value
    assert refused(plan).code in (Refusal.POSITION, Refusal.VELOCITY, Refusal.ACCELERATION)


@pytest.mark.parametrize(
    ("times", "quantity"),
    [
        ([0.0, 0.5, 0.5], "segment time"),
        ([0.0, 0.6, 0.5], "segment time"),
        ([0.0, 0.5, 0.5 + 0.9e-3], "segment time"),
        ([0.0, -0.5, 1.0], "segment time"),
        ([0.0, 0.5, 2.0**63], "segment time"),
        ([0.1, 0.5, 1.0], "time"),
        ([-0.1, 0.5, 1.0], "time"),
    ],
)
def test_times_that_do_not_rise_from_zero_are_refused(times, quantity):
    plan = replace(move(one_joint(0, 0.1), 1.0, knots=3), t=np.array(times))
    error = refused(plan)
    assert (error.code, error.quantity) == (Refusal.TIME, quantity)


def test_a_plan_longer_than_allowed_is_refused():
    config = AdmissionConfig(max_duration_s=5.0)
    admission = Admission(ARM, config, CoreConfig())
    admission.admit(move(one_joint(0, 0.1), 5.0), Q)
    assert refused(move(one_joint(0, 0.1), 5.001), admission=admission).quantity == "duration"


@pytest.mark.parametrize("knots", [0, 1])
def test_too_few_knots_are_refused(knots):
    plan = PlanRequest(NAMES, np.zeros(knots), *np.zeros((3, knots, 7)))
    assert refused(plan).code is Refusal.SIZE


def test_the_largest_number_of_knots_is_admitted_and_one_more_is_refused():
    admission = Admission(ARM, AdmissionConfig(max_knots=50), CoreConfig())
    admission.admit(move(one_joint(0, 0.1), 2.0, knots=50), Q)
    error = refused(move(one_joint(0, 0.1), 2.0, knots=51), admission=admission)
    assert (error.code, error.value, error.limit) == (Refusal.SIZE, 51, 50)


def test_arrays_that_do_not_match_the_knots_are_refused():
    plan = move(one_joint(0, 0.1), 1.0, knots=3)
    assert refused(replace(plan, dq=plan.dq[:2])).code is Refusal.SIZE
    assert refused(replace(plan, q=plan.q[:, :6])).code is Refusal.SIZE


@pytest.mark.parametrize(
    "names",
    [NAMES[:6], NAMES[::-1], (*NAMES, "joint8"), ("joint1",) * 7, (), ("joint1 ", *NAMES[1:])],
)
def test_other_joint_names_counts_or_orders_are_refused(names):
    assert refused(replace(move(one_joint(0, 0.1), 1.0), joint_names=names)).code is Refusal.MODEL


@pytest.mark.parametrize("knot", [0, -1])
@pytest.mark.parametrize(("field", "limit"), [("dq", 1e-6), ("ddq", 1e-4)])
def test_start_and_end_must_be_at_rest(knot, field, limit):
    plan = move(one_joint(0, 0.1), 1.0, knots=3)
    getattr(plan, field)[knot, 4] = 0.99 * limit
    ADMISSION.admit(plan, Q)
    getattr(plan, field)[knot, 4] = -1.01 * limit
    error = refused(plan)
    assert (error.code, error.joint, error.quantity) == (Refusal.NOT_AT_REST, "joint5", field)


@pytest.mark.parametrize("sign", [-1, 1])
def test_start_must_be_the_reference_and_the_first_setpoint_makes_no_step(sign):
    plan = move(one_joint(0, 0.1), 2.0)
    for joint in range(7):
        near, far = Q + one_joint(joint, sign * 0.99e-4), Q + one_joint(joint, sign * 1.01e-4)
        np.testing.assert_array_equal(ADMISSION.admit(plan, near).q[0], near)
        error = refused(plan, far)
        assert (error.code, error.joint) == (Refusal.START, NAMES[joint])


@pytest.mark.parametrize("knots", [3, 31, 301])
def test_a_start_off_the_reference_costs_little_jerk_however_close_the_knots_stand(knots):
    offset = np.full(7, -0.99e-4)
    plan = move(one_joint(0, 0.1), 3.0, knots=knots)
    exact, off = ADMISSION.admit(plan, Q), ADMISSION.admit(plan, Q + offset)
    assert off.margins["jerk"] - exact.margins["jerk"] < 0.003
    np.testing.assert_array_equal(off.q[0], Q + offset)
    later = plan.t > (0.31 if knots > 3 else 1.6)
    np.testing.assert_array_equal(off.q[later], plan.q[later])
    assert np.abs(off.q - plan.q).max() == pytest.approx(0.99e-4)


def splice_state(offset=0.0):
    parent = move(one_joint(0, 0.1), 1.0)
    at = sample(spline_through(parent.t, parent.q, parent.dq, parent.ddq), np.array([0.5]))
    return PathState(at.q[0] + one_joint(0, offset), at.dq[0], at.ddq[0])


def child_of(state, duration_s=1.2, knots=13):
    """From a moving state to rest 0.05 rad further on."""
    goal = state.q + one_joint(0, 0.05)
    zero = np.zeros(7)
    ends = spline_through(
        np.array([0.0, duration_s]),
        *(np.stack(x) for x in ((state.q, goal), (state.dq, zero), (state.ddq, zero))),
    )
    at = sample(ends, np.linspace(0.0, duration_s, knots))
    return PlanRequest(NAMES, at.t, at.q, at.dq, at.ddq, parent_seq=1, splice_t=0.5)


def test_a_splice_that_meets_the_running_plan_is_admitted_as_it_is():
    admitted = ADMISSION.admit_splice(child_of(splice_state()), splice_state(5e-7))
    assert len(admitted.t) == 13
    np.testing.assert_array_equal(admitted.q[0], splice_state(5e-7).q)


@pytest.mark.parametrize("offset", [2e-6, 1e-3, -0.0199])
def test_a_splice_that_misses_the_running_plan_gets_a_bridge_inside_the_limits(offset):
    admitted = ADMISSION.admit_splice(child_of(splice_state()), splice_state(offset))
    np.testing.assert_array_equal(admitted.q[0], splice_state(offset).q)
    np.testing.assert_allclose(admitted.q[-1], child_of(splice_state()).q[-1], atol=1e-12)
    spline = spline_through(admitted.t, admitted.q, admitted.dq, admitted.ddq)
    dense = sample(spline, np.linspace(0.0, admitted.duration_s, 20_001))
    limits = ADMISSION._arm.limits
    for values, limit in (
        (dense.dq, limits.dq_max),
        (dense.ddq, limits.ddq_max),
        (dense.dddq, limits.dddq_max),
    ):
        assert (np.abs(values) <= limit * (1 + 1e-6)).all()


def fast_plan(shares, t=(0.0, 0.2, 0.4, 0.8)):
    """The first joint at these shares of its velocity limit."""
    speeds = np.outer(shares, one_joint(0, ADMISSION._arm.limits.dq_max[0]))
    q = Q + np.vstack([np.zeros(7), np.cumsum(np.diff(t)[:, None] * (speeds[1:] + speeds[:-1]) / 2, axis=0)])
    return PlanRequest(NAMES, np.array(t), q, speeds, 0.0 * q, parent_seq=1, splice_t=0.5)


def test_a_bridge_joins_later_where_the_plan_is_too_fast_to_be_joined_sooner():
    plan = fast_plan((0.8, 0.95, 0.8, 0.0))
    start = PathState(plan.q[0] + one_joint(0, 1e-3), plan.dq[0], plan.ddq[0])
    joined = bridge(plan, start, ADMISSION._arm.limits, AdmissionConfig())
    np.testing.assert_array_equal(joined.q[0], start.q)
    assert not (joined.q == plan.q[1]).all(axis=1).any()
    np.testing.assert_array_equal(joined.q[-1], plan.q[-1])


def test_a_plan_that_is_too_fast_to_be_joined_anywhere_is_refused_as_a_splice():
    plan = fast_plan((0.95, 0.95, 0.95, 0.95))
    start = PathState(plan.q[0] + one_joint(0, 1e-3), plan.dq[0], plan.ddq[0])
    with pytest.raises(CommandRefusedError, match="no motion inside the limits joins") as caught:
        bridge(plan, start, ADMISSION._arm.limits, AdmissionConfig())
    assert caught.value.code is Refusal.SPLICE


def test_a_splice_too_far_from_the_running_plan_is_refused_with_its_numbers():
    with pytest.raises(CommandRefusedError) as caught:
        ADMISSION.admit_splice(child_of(splice_state()), splice_state(0.021))
    error = caught.value
    assert (error.code, error.joint, error.quantity, error.t) == (Refusal.SPLICE, NAMES[0], "position", 0.5)
    assert error.value == pytest.approx(0.021)
    assert error.limit == 0.02


@pytest.mark.parametrize(
    ("field", "limit"), [("path_tolerance", 0.2), ("goal_tolerance", 0.1), ("payload_mass", 3.0)]
)
def test_tolerances_and_payload_have_bounds(field, limit):
    plan = replace(move(one_joint(0, 0.01), 3.0), path_tolerance=0.2)
    ADMISSION.admit(replace(plan, **{field: limit}), Q)
    assert refused(replace(plan, **{field: np.nextafter(limit, 9.0)})).quantity == field
    error = refused(replace(plan, **{field: -1e-9}))
    assert error.quantity == field
    assert f"or start the executor with another admission.max_{field.removesuffix('_mass')}" in str(error)


@pytest.mark.parametrize("path", [0.0, 0.01, 0.1])
def test_a_goal_tolerance_beyond_what_the_following_window_allows_at_rest_is_refused(path):
    plan = replace(move(one_joint(0, 0.01), 3.0), path_tolerance=path)
    limit = 0.5 * (path or 0.05)
    assert ADMISSION.admit(replace(plan, goal_tolerance=limit), Q).goal_tolerance == limit
    error = refused(replace(plan, goal_tolerance=np.nextafter(limit, 9.0)))
    assert (error.code, error.quantity, error.limit) == (Refusal.POSITION, "goal_tolerance", limit)
    assert ADMISSION.admit(plan, Q).goal_tolerance == min(0.02, limit)


# -- limits -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("side", ["q_min", "q_max"])
def test_a_knot_one_unit_in_the_last_place_outside_its_position_limit_is_refused(joint, side):
    limit = getattr(ARM.limits, side)[joint]
    outside = np.nextafter(limit, np.inf if side == "q_max" else -np.inf)
    q0 = Q.copy()
    q0[joint] = limit - np.sign(limit) * 0.1
    for end, good in ((limit, True), (outside, False)):
        plan = move(np.zeros(7), 3.0, q0)
        plan.q[-1, joint] = end
        spline = spline_through(plan.t, plan.q, plan.dq, plan.ddq)
        if good:
            check_bounds(spline, ARM.limits, NAMES)
        else:
            with pytest.raises(CommandRefusedError) as error:
                check_bounds(spline, ARM.limits, NAMES)
            assert error.value.code is Refusal.POSITION
            assert error.value.joint == NAMES[joint]
            assert error.value.t == pytest.approx(3.0)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("joint", range(7))
def test_position_overshoot_only_between_knots_is_found(joint, sign):
    """Out and back within one segment: both knots lie inside, the middle does not."""
    limit = ARM.limits.q_max[joint] if sign > 0 else ARM.limits.q_min[joint]
    for excess, good in ((-1e-3, True), (1e-3, False), (1e-9, False), (-1e-9, True)):
        t = np.array([0.0, 1.0, 2.0])
        q, dq, ddq = np.tile(np.zeros(7), (3, 1)), np.zeros((3, 7)), np.zeros((3, 7))
        dq[0, joint] = sign * 0.5
        q[:, joint] = 0.0
        peak = np.abs(sample(spline_through(t, q, dq, ddq), np.linspace(0, 1, 20_001)).q[:, joint]).max()
        q[:, joint] = limit + sign * (excess - peak)
        spline = spline_through(t, q, dq, ddq)
        if good:
            check_bounds(spline, ARM.limits, NAMES)
            continue
        with pytest.raises(CommandRefusedError, match="between knots") as error:
            check_bounds(spline, ARM.limits, NAMES)
        assert (error.value.code, error.value.joint) == (Refusal.POSITION, NAMES[joint])
        assert 0.0 < error.value.t < 1.0
        assert error.value.value == pytest.approx(limit + sign * excess, abs=1e-8)


_PEAKS = {  # of a minimum-jerk move of 1 rad in 1 s: velocity, acceleration, jerk
    "velocity": (1.875, 1, Refusal.VELOCITY, "dq_max"),
    "acceleration": (10 / np.sqrt(3), 2, Refusal.ACCELERATION, "ddq_max"),
    "jerk": (60.0, 3, Refusal.JERK, "dddq_max"),
}


@pytest.mark.parametrize("quantity", ["velocity", "acceleration"])
@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("sign", [-1, 1])
def test_limits_hold_between_knots_a_thousandth_to_both_sides(quantity, joint, sign):
    """The whole move is one segment, so its knots show neither velocity nor acceleration."""
    peak, order, code, name = _PEAKS[quantity]
    limit = getattr(ARM.limits, name)[joint]
    for share, good in ((0.999, True), (1.001, False)):
        if quantity == "velocity":  # a long slow move reaches the velocity limit with little acceleration
            duration = 3.5
            amount = share * limit * duration / peak
        else:
            amount = 0.05
            duration = (amount * peak / (share * limit)) ** (1 / order)
        wide = np.full(7, 100.0)
        limits = replace(ARM.limits, q_min=-wide, q_max=wide, dddq_max=np.full(7, 1e6))
        if quantity == "velocity":
            limits = replace(limits, ddq_max=np.full(7, 1e6))
        plan = move(one_joint(joint, sign * amount), duration)
        spline = spline_through(plan.t, plan.q, plan.dq, plan.ddq)
        if good:
            check_bounds(spline, limits, NAMES)
            continue
        with pytest.raises(CommandRefusedError, match="between knots") as error:
            check_bounds(spline, limits, NAMES)
        refusal = error.value
        assert (refusal.code, refusal.joint, refusal.quantity) == (code, NAMES[joint], quantity)
        assert abs(refusal.value) == pytest.approx(1.001 * limit, rel=1e-6)
        assert abs(refusal.limit) == limit
        assert 0.0 < refusal.t < duration


@pytest.mark.parametrize("joint", range(7))
def test_jerk_limit_holds_a_thousandth_to_both_sides(joint):
    limit = ARM.limits.dddq_max[joint]
    for share, good in ((0.999, True), (1.001, False)):
        amount = 1e-3
        duration = (60.0 * amount / (share * limit)) ** (1 / 3)
        plan = move(one_joint(joint, amount), duration)
        limits = replace(ARM.limits, ddq_max=np.full(7, 1e6))
        spline = spline_through(plan.t, plan.q, plan.dq, plan.ddq)
        if good:
            check_bounds(spline, limits, NAMES)
            continue
        with pytest.raises(CommandRefusedError) as error:
            check_bounds(spline, limits, NAMES)
        assert (error.value.code, error.value.joint) == (Refusal.JERK, NAMES[joint])


def test_the_whole_admission_refuses_what_the_bounds_refuse():
    plan = move(one_joint(5, 0.5), 0.3)
    assert refused(plan).code in (Refusal.VELOCITY, Refusal.ACCELERATION)


# -- torque -------------------------------------------------------------------------------------------


def test_torque_is_refused_only_with_the_payload():
    admission = Admission(ARM, AdmissionConfig(), CoreConfig())
    stretched = np.array([0.0, 1.35, 0.0, 0.05, 0.0, 0.1, 0.0])
    plan = move(one_joint(0, 0.2), 3.0, stretched)
    admission.admit(plan, stretched)
    error = refused(replace(plan, payload_mass=3.0, payload_com=(0.0, 0.0, 0.1)), stretched, admission)
    assert (error.code, error.quantity) == (Refusal.TORQUE, "torque")
    assert abs(error.value) > error.limit
    assert error.joint == "joint2"
    # The payload of one plan is not the payload of the next.
    admission.admit(plan, stretched)


def test_torque_boundary_is_met_from_both_sides():
    stretched = np.array([0.0, 1.35, 0.0, 0.05, 0.0, 0.1, 0.0])
    plan = move(one_joint(0, 0.2), 3.0, stretched)
    share = ADMISSION.admit(plan, stretched).margins["torque"]
    Admission(ARM, AdmissionConfig(torque_margin=1 - share * 1.001), CoreConfig()).admit(plan, stretched)
    error = refused(
        plan, stretched, Admission(ARM, AdmissionConfig(torque_margin=1 - share * 0.999), CoreConfig())
    )
    assert error.code is Refusal.TORQUE


# -- collision ----------------------------------------------------------------------------------------


def test_self_collision_only_in_the_middle_of_a_segment_is_found():
    """Folded up, the hand swings past the upper arm: free at both ends of its only segment, not between."""
    admission = Admission(ARM, AdmissionConfig(table_z_m=None), CoreConfig())
    left = np.array([0.0, 0.9, 0.4, 1.9, -0.5, 1.9, 0.0])
    right = left + one_joint(4, 0.8)
    for end in (left, right):
        admission.admit(move(np.zeros(7), 1.0, end), end)
    error = refused(move(right - left, 3.0, left), left, admission)
    assert error.code is Refusal.COLLISION
    assert " - " in error.quantity
    assert 0.0 < error.t < 3.0
    assert error.value < error.limit == pytest.approx(0.01)
    assert "10 mm must be between them; plan around it" in str(error)


def test_a_collision_tells_the_distance_that_is_left_without_the_inflation():
    """Down to 2 mm over the plane for the hand: 5 mm must be left."""
    import pinocchio as pin

    start = np.array([0.0, 0.5, 0.0, 1.3, 0.0, 1.2, 0.0])
    model = CollisionModel(ARM, AdmissionConfig())
    goal = start + one_joint(1, 0.6)
    t = np.linspace(0.0, 1.0, 2000)
    posed = start + t[:, None] * (goal - start)
    hits = [q for q in posed if _touches(model, pin, q)]
    error = model._refusal(hits[0], 0.5)
    assert error.quantity.endswith("table (hand)")
    assert error.value == pytest.approx(0.005, abs=2e-4)
    assert error.limit == 0.005
    assert model._refusal(hits[-1], 0.5).value < 0.0


def _touches(model, pin, q):
    return pin.computeCollisions(model._model, model._data, model._geometry, model._geometry_data, q, True)


@pytest.mark.parametrize(("apart_m", "touches"), [(0.0098, True), (0.0102, False)])
def test_boxes_corner_to_corner_keep_the_same_distance_as_face_to_face(apart_m, touches):
    import pinocchio as pin

    source = ARM.source
    across = (0.1 + apart_m / np.sqrt(3.0),) * 3
    away = Box(link="link7", name="away", type="box", center=(0.0, 0.0, 0.0), half=(0.05, 0.05, 0.05))
    frame = pin.buildModelFromXML(ARM.urdf)
    data = frame.createData()
    pin.framesForwardKinematics(frame, data, np.zeros(7))
    at_link = data.oMf[frame.getFrameId("link7", pin.FrameType.BODY)].actInv(np.array(across))
    boxes = (
        away.model_copy(update={"center": tuple(at_link)}),
        away.model_copy(update={"link": "base", "name": "b"}),
    )
    arm = ArmDescription(source.model_copy(update={"shapes": boxes}), ARM.directory)
    assert _touches(CollisionModel(arm, AdmissionConfig(table_z_m=None)), pin, np.zeros(7)) is touches


def test_a_pedestal_on_the_base_may_reach_below_the_table():
    """It stands, as the base does; of what moves nothing else may, and it does not count as the hand."""
    source = ARM.source
    mount = source.mounts[0].model_copy(
        update={"parent": "base", "child": "pedestal", "origin": (0.0, 0.0, -0.9)}
    )
    link = source.link_named("base").model_copy(update={"name": "pedestal"})
    box = Box(link="pedestal", name="pedestal", type="box", center=(0.0, 0.0, 0.4), half=(0.1, 0.1, 0.4))
    update = {
        "links": (*source.links, link),
        "mounts": (*source.mounts, mount),
        "shapes": (*source.shapes, box),
    }
    arm = ArmDescription(source.model_copy(update=update), ARM.directory)
    admission = Admission(arm, AdmissionConfig(), CoreConfig())
    admission.admit(move(one_joint(0, 0.1), 1.0), Q)
    assert "table" in refused(move(one_joint(1, 1.2), 3.0), Q, admission).quantity


def test_a_thin_keep_out_wall_is_not_jumped_over():
    """A fast swing through a wall thinner than the distance between two time samples."""
    wall = BoxZone(name="wall", lower_m=(0.3, 0.0, 0.5), upper_m=(0.9, 0.001, 1.0))
    admission = Admission(ARM, AdmissionConfig(keep_out=(wall,)), CoreConfig())
    left = Q + one_joint(0, 0.7)
    admission.admit(move(np.zeros(7), 1.0, left), left)
    error = refused(move(one_joint(0, -1.4), 2.0, left), left, admission)
    assert error.code is Refusal.COLLISION
    assert "wall" in error.quantity


def test_the_table_may_be_neared_but_not_entered():
    """Lower the fingertip by joint 2 until the plan is refused; the last admitted tip height is at the table."""
    import pinocchio as pin

    model = pin.buildModelFromXML(ARM.urdf)
    data, tip = model.createData(), model.getFrameId(ARM.tool_frame)

    def height(q):
        pin.framesForwardKinematics(model, data, q)
        return data.oMf[tip].translation[2]

    start = np.array([0.0, 0.5, 0.0, 1.3, 0.0, 1.2, 0.0])
    assert height(start) > 0.05
    low, high = 0.0, 0.6
    refusals = []
    for _ in range(14):
        middle = (low + high) / 2
        try:
            ADMISSION.admit(move(one_joint(1, middle), 6.0, start), start)
            low = middle
        except CommandRefusedError as error:
            refusals.append(error)
            high = middle
    assert {error.code for error in refusals} == {Refusal.COLLISION}
    assert all("table" in error.quantity for error in refusals)
    assert -0.002 < height(start + one_joint(1, low)) < 0.01
