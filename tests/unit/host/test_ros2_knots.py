"""JointTrajectory messages as knots: every way to fill one, and every way to get one wrong."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_host.ros2.knots import RosTrajectoryError, plan_of

NAMES = ("a", "b")
HOLD = np.array([0.1, -0.2])
NOW_S = 1_000.0


def point(t, q=(), dq=(), ddq=(), effort=()):
    whole = int(t // 1)
    return {
        "positions": list(q),
        "velocities": list(dq),
        "accelerations": list(ddq),
        "effort": list(effort),
        "time_from_start": {"sec": whole, "nanosec": round((t - whole) * 1e9)},
    }


def message(*points, names=NAMES, stamp_s=0.0):
    stamp = {"sec": int(stamp_s), "nanosec": round(stamp_s % 1 * 1e9)}
    return {"header": {"stamp": stamp, "frame_id": ""}, "joint_names": list(names), "points": list(points)}


def knots(*points, **more):
    return plan_of(message(*points, **more), NAMES, HOLD, NOW_S)


def test_positions_alone_become_a_smooth_path_through_all_points_at_rest_at_both_ends():
    found = knots(point(1.0, (0.3, 0.0)), point(1.5, (0.2, 0.1)), point(3.0, (0.5, 0.4)))
    np.testing.assert_allclose(found.t, [0.0, 1.0, 1.5, 3.0])
    np.testing.assert_allclose(found.q, [HOLD, (0.3, 0.0), (0.2, 0.1), (0.5, 0.4)])
    for rates in (found.dq, found.ddq):
        assert not rates[[0, -1]].any()
        assert np.abs(rates[1:-1]).min() > 0
    # The third derivative is continuous at inner knots, so the quintic Hermite segments are the spline itself.
    jerk_end, jerk_start = _jerk_at_ends(found)
    np.testing.assert_allclose(jerk_end[:-1], jerk_start[1:], rtol=1e-9)


def _jerk_at_ends(found):
    T = np.diff(found.t)[:, None]
    step = np.diff(found.q, axis=0)
    v0, v1, a0, a1 = found.dq[:-1], found.dq[1:], found.ddq[:-1], found.ddq[1:]
    start = (60 * step - (36 * v0 + 24 * v1) * T - (9 * a0 - 3 * a1) * T**2) / T**3
    end = (60 * step - (24 * v0 + 36 * v1) * T + (9 * a1 - 3 * a0) * T**2) / T**3
    return end, start


def test_one_point_is_a_minimum_jerk_motion_to_it():
    found = knots(point(2.0, (0.5, 0.5)))
    assert found.q.shape == (2, 2)
    assert not found.dq.any()
    assert not found.ddq.any()


def test_joints_may_come_in_any_order():
    found = knots(point(1.0, (7.0, 8.0)), names=("b", "a"))
    np.testing.assert_array_equal(found.q[1], (8.0, 7.0))


def test_a_first_point_at_zero_is_replaced_by_the_held_reference():
    found = knots(point(0.0, HOLD + 0.004), point(1.0, (0.3, 0.0)))
    np.testing.assert_array_equal(found.q[0], HOLD)
    assert len(found.t) == 2


def test_velocities_get_the_accelerations_of_a_parabola_exactly():
    t = np.array([0.0, 1.0, 1.5, 3.0])  # q = t²/2 - offset: acceleration 1 wherever it is not an end
    points = [point(x, HOLD + x**2 / 2, (x, x)) for x in t]
    found = knots(*points)
    np.testing.assert_allclose(found.ddq[1:-1], 1.0)
    np.testing.assert_array_equal(found.dq[1:], np.column_stack([t[1:], t[1:]]))


def test_accelerations_are_taken_as_sent():
    found = knots(point(1.0, (0.3, 0.0), (0.1, 0.2), (3.0, 4.0)), point(2.0, (0.4, 0.1), (0, 0), (0, 0)))
    np.testing.assert_array_equal(found.ddq, [(0, 0), (3.0, 4.0), (0, 0)])


@pytest.mark.parametrize(
    ("points", "more", "text"),
    [
        ([point(1, (1, 2))], {"names": ("a", "c")}, "missing b; unknown c; it has a, b"),
        ([point(1, (1, 2))], {"names": ("a", "a")}, "missing b; a more than once; it has"),
        ([point(1, (1, 2))], {"names": ("a", "b", "a")}, "the arm: a more than once; it has"),
        ([point(1, (1, 2), (), (0, 0))], {}, "accelerations without velocities; send both, or neither"),
        ([point(1, (1, 2, 3))], {}, "point 0 has 3 positions, expected 2"),
        ([point(1, (1, 2)), point(2, ())], {}, "point 1 has 0 positions, expected 2"),
        ([point(1, (1, 2), (0, 0)), point(2, (1, 2))], {}, "point 1 has 0 velocities"),
        ([point(1, (), (1, 2))], {}, "no positions"),
        ([point(1, (1, np.nan))], {}, "joint 'b': positions of point 0 is nan"),
        ([point(1, (1, 2), effort=(1, 1))], {}, "leave effort empty"),
        ([point(1, (1, 2)), point(1, (2, 2))], {}, "does not rise: point 0 at 1 s, point 1 at 1 s"),
        ([point(-1, (1, 2))], {}, "point 0 lies at -1 s"),
        ([point(0, HOLD)], {}, "the only point lies at 0 s"),
        (
            [point(0, HOLD + np.array([0.01, 0.0])), point(1, (1, 2))],
            {},
            "joint 'a': point 0 at 0 s is 0.1100 rad, the arm holds 0.1000",
        ),
        ([point(0, HOLD, (0.1, 0)), point(1, (1, 2), (0, 0))], {}, "the arm begins at rest"),
        ([point(1, (1, 2))], {"stamp_s": NOW_S + 2}, "lies 2.000 s ahead"),
        ([point(1, (1, 2))], {"stamp_s": NOW_S - 5}, "5.000 s old, limit 1 s"),
    ],
)
def test_a_wrong_message_is_refused_by_name(points, more, text):
    with pytest.raises(RosTrajectoryError) as refused:
        knots(*points, **more)
    assert text in str(refused.value)


def test_a_stamp_of_just_now_is_now():
    assert len(knots(point(1.0, (0.3, 0.0)), stamp_s=NOW_S - 0.5).t) == 2
