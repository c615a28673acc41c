"""Stops on the path: legal from anywhere in their segment, found short, refused when there is none."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_executor.checks.dynamics import InverseDynamics
from s2r_executor.plan import CommandRefusedError
from s2r_executor.quintic import sample, spline_through
from s2r_executor.stop_ramps import ALLOWANCE, load_along, stop_durations
from s2r_protocol.faults import Refusal

GATE_MARGIN = 1.02


@pytest.fixture(scope="module")
def dynamics(arm):
    return InverseDynamics(arm)


def durations(spline, arm, dynamics, longest_s=2.0):
    load = load_along(spline, dynamics.torque)
    return stop_durations(spline, load, arm.limits, arm.joint_names, 0.9 * arm.limits.tau_max, longest_s)


def blend(x):
    """S(x) = 6x⁵ − 15x⁴ + 10x³, its first two derivatives, and its integral from 0."""
    s = x**3 * (10 + x * (-15 + 6 * x))
    ds, dds = 30 * x**2 * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x)
    return s, ds, dds, x**4 * (2.5 + x * (-3 + x))


def wavy_spline(arm, seed, share=0.7):
    """A random walk through knots, slowed down until it uses ``share`` of the limits; starts and ends at rest."""
    rng = np.random.default_rng(seed)
    n = 9
    q = arm.q_home + np.cumsum(rng.normal(scale=0.15, size=(n, 7)), axis=0)
    q[0] = arm.q_home
    t = np.arange(n, dtype=float)
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    dq[1:-1] = (q[2:] - q[:-2]) / 2
    dense = sample(spline_through(t, q, dq, ddq), np.linspace(0, t[-1], 4000))
    limits = arm.limits
    factor = max(
        (np.abs(dense.dq) / limits.dq_max).max(),
        (np.abs(dense.ddq) / limits.ddq_max).max() ** (1 / 2),
        (np.abs(dense.dddq) / limits.dddq_max).max() ** (1 / 3),
    ) / share ** (1 / 2)
    return spline_through(t * factor, q, dq / factor, ddq)


def along_stop(spline, start_s, rate, duration_s, points=400):
    """Velocity, acceleration and jerk of a stop, differentiated by the chain rule, in the order of time."""
    x = np.linspace(0.0, 1.0, points)
    s, ds, dds, integral = blend(x)
    r, dr, ddr = (a[:, None] for a in (rate * (1 - s), -rate * ds / duration_s, -rate * dds / duration_s**2))
    path_t = start_s + rate * duration_s * (x - integral)
    inside = (path_t < spline.duration_s)[:, None]
    p = sample(spline, path_t)
    return (
        inside * p.dq * r,
        inside * (p.ddq * r**2 + p.dq * dr),
        inside * (p.dddq * r**3 + 3 * p.ddq * r * dr + p.dq * ddr),
        p.q,
        inside,
    )


@pytest.mark.parametrize("seed", range(6))
def test_stop_from_any_moment_and_rate_stays_inside_the_gate(seed, arm, dynamics):
    spline = wavy_spline(arm, seed)
    found = durations(spline, arm, dynamics)
    rng = np.random.default_rng(100 + seed)
    limits = (arm.limits.dq_max, arm.limits.ddq_max, arm.limits.dddq_max)
    for k, T in enumerate(found):
        for start in rng.uniform(spline.t[k], spline.t[k + 1], 6):
            for rate in (1.0, 0.8, 0.5, 0.2):
                values = along_stop(spline, start, rate, T)
                for value, limit, name in zip(
                    values, limits, ("velocity", "acceleration", "jerk"), strict=False
                ):
                    share = (np.abs(value) / limit).max()
                    assert share <= GATE_MARGIN, (
                        f"segment {k}, start {start:.4f} s, rate {rate}: {name} {share:.4f}"
                    )


@pytest.mark.parametrize("seed", range(3))
def test_stop_keeps_torques_inside_their_limit(seed, arm, dynamics):
    spline = wavy_spline(arm, seed)
    for k, T in enumerate(durations(spline, arm, dynamics)):
        dq, ddq, _, q, _ = along_stop(spline, (spline.t[k] + spline.t[k + 1]) / 2, 1.0, T, points=60)
        assert (np.abs(dynamics.torque(q, dq, ddq)) <= 0.9 * arm.limits.tau_max * 1.001).all()


@pytest.mark.parametrize("seed", [8, 10])
def test_a_short_motion_in_a_long_plan_keeps_torques_inside_their_limit(seed, arm, dynamics):
    motion = wavy_spline(arm, seed)
    dense = sample(motion, np.linspace(0.0, motion.duration_s, 3000))
    tau_limit = 1.1 * np.abs(dynamics.torque(dense.q, dense.dq, dense.ddq)).max(axis=0)
    s = sample(motion, motion.t)
    t = np.concatenate([[0.0], 600.0 - motion.duration_s + motion.t])
    spline = spline_through(t, *(np.concatenate([x[:1], x]) for x in (s.q, s.dq, s.ddq)))
    load = load_along(spline, dynamics.torque)
    found = stop_durations(spline, load, arm.limits, arm.joint_names, tau_limit, 2.0)
    for k, duration_s in enumerate(found[1:], start=1):
        for start_s in np.linspace(t[k], t[k + 1], 7):
            dq, ddq, _, q, inside = along_stop(spline, start_s, 1.0, duration_s, points=60)
            assert (inside * np.abs(dynamics.torque(q, dq, ddq)) <= 1.001 * tau_limit).all()


def test_stops_are_short_where_the_arm_is_slow_and_bounded_by_physics(arm, dynamics, smooth_plan):
    plan = smooth_plan(duration_s=4.0, knots=41)
    spline = spline_through(plan.t, plan.q, plan.dq, plan.ddq)
    found = durations(spline, arm, dynamics)
    middle = found[20]
    assert found[0] < middle
    assert found[-1] < middle
    # The blend's largest deceleration is 1.875 v / T: nothing can stop faster than the acceleration limit allows.
    peak = np.abs(spline.dq[20]) / arm.limits.ddq_max
    assert middle >= 1.0 * peak.max() / ALLOWANCE


def test_a_plan_without_room_to_stop_is_refused_by_joint_and_quantity(arm, dynamics):
    # Joint 1 cruises while braking at its acceleration limit in the middle, far from the end of the plan.
    a = arm.limits.ddq_max[0]
    t = np.array([0.0, 1.0, 1.4, 2.4])
    q, dq, ddq = np.tile(arm.q_home, (4, 1)), np.zeros((4, 7)), np.zeros((4, 7))
    dq[1:3, 0], ddq[1:3, 0] = (3.0, 3.0 - 0.4 * a), (-a, -a)
    q[1:, 0] += (1.0, 1.0 + 0.4 * 3.0 - a * 0.08, 1.9)
    with pytest.raises(CommandRefusedError) as error:
        durations(spline_through(t, q, dq, ddq), arm, dynamics, longest_s=0.3)
    assert error.value.code is Refusal.NO_STOP_PATH
    assert error.value.joint == "joint1"
    assert error.value.quantity in ("acceleration", "jerk")
    assert abs(error.value.value) > error.value.limit


def test_standing_still_needs_only_the_shortest_stop(arm, dynamics):
    t = np.array([0.0, 1.0, 2.0])
    q = np.tile(arm.q_home, (3, 1))
    found = durations(spline_through(t, q, np.zeros_like(q), np.zeros_like(q)), arm, dynamics)
    np.testing.assert_allclose(found, 0.02)
