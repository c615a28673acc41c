"""The closed-form joint-space stop against Ruckig's velocity interface."""

from __future__ import annotations

import numpy as np
import pytest
import ruckig

_native = pytest.importorskip("s2r_executor._native", reason="the native core is not built")


def ruckig_stop(q: float, dq: float, ddq: float, ddq_max: float, dddq_max: float) -> ruckig.Trajectory:
    request = ruckig.InputParameter(1)
    request.control_interface = ruckig.ControlInterface.Velocity
    request.current_position, request.current_velocity, request.current_acceleration = [q], [dq], [ddq]
    request.target_velocity, request.target_acceleration = [0.0], [0.0]
    request.max_acceleration, request.max_jerk = [ddq_max], [dddq_max]
    trajectory = ruckig.Trajectory(1)
    assert ruckig.Ruckig(1).calculate(request, trajectory) >= 0
    return trajectory


def states() -> list[tuple[float, float]]:
    rng = np.random.default_rng(7)
    drawn = [(rng.uniform(-3.0, 3.0), rng.uniform(-6.0, 6.0)) for _ in range(300)]
    edges = [(v, a) for v in (-3.0, -1e-6, 0.0, 0.06, 3.0) for a in (-6.0, -0.1, 0.0, 0.1, 6.0)]
    above = [(1.0, 7.0), (-0.2, 8.0), (0.0, -9.0)]  # more acceleration than allowed
    return drawn + edges + above


def test_stop_is_ruckigs_stop():
    for dq, ddq in states():
        expected = ruckig_stop(0.4, dq, ddq, 6.0, 300.0)
        times = np.linspace(0.0, expected.duration + 0.05, 40)
        arrays = [np.array([x]) for x in (0.4, dq, ddq, 6.0, 300.0)]
        duration, q, v, a = _native.joint_stop(*arrays, times)
        assert duration[0] == pytest.approx(expected.duration, abs=1e-9), (dq, ddq)
        inside = times <= expected.duration
        reference = np.array([expected.at_time(t) for t in times[inside]])[:, :, 0]
        for mine, theirs in zip((q, v, a), reference.T, strict=True):
            assert np.abs(mine[inside, 0] - theirs).max() < 1e-8, (dq, ddq)


def test_end_is_exactly_at_rest():
    rng = np.random.default_rng(8)
    for _ in range(200):
        state = [rng.uniform(-1, 1, 7), rng.uniform(-3, 3, 7), rng.uniform(-6, 6, 7)]
        duration, q, v, a = _native.joint_stop(
            *state, np.full(7, 6.0), np.full(7, 300.0), np.array([2.0, 3.0])
        )
        assert (v == 0.0).all()
        assert (a == 0.0).all()
        assert (q[0] == q[1]).all()
        assert duration.max() < 2.0


def test_speed_rises_only_while_acceleration_is_unwound():
    dq, ddq, j = 1.0, 5.0, 300.0
    times = np.linspace(0.0, 1.0, 2001)
    _, _, v, _ = _native.joint_stop(*(np.array([x]) for x in (0.0, dq, ddq, 6.0, j)), times)
    assert v.max() <= dq + ddq**2 / (2 * j) + 1e-12


def test_acceleration_and_jerk_stay_inside_their_limits():
    times = np.linspace(0.0, 1.2, 1201)
    for dq, ddq in states()[:100]:
        _, _, _, a = _native.joint_stop(*(np.array([x]) for x in (0.0, dq, ddq, 6.0, 300.0)), times)
        assert np.abs(a).max() <= 6.0 + 1e-12
        assert np.abs(np.diff(a[:, 0])).max() / 1e-3 <= 300.0 + 1e-6
