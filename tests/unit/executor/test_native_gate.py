"""The gate on encoded setpoints: each limit from both sides, and everything that is not a number."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_protocol.faults import Cause

_native = pytest.importorskip("s2r_executor._native", reason="the native core is not built")

DT = 1e-3
COUNT = 4e-9
LIMITS = {"q_min": [-1.0], "q_max": [1.5], "dq_max": [2.0], "ddq_max": [6.0], "dddq_max": [300.0]}
LOOSE = {"q_min": [-2.0], "q_max": [2.0], "dq_max": [6.0], "ddq_max": [1e4], "dddq_max": [1e7]}


def check(q, limits=LIMITS, dq=None, margin: float = 1.02):
    q = np.atleast_2d(np.asarray(q, float).T).T
    dq = np.zeros_like(q) if dq is None else np.atleast_2d(np.asarray(dq, float).T).T
    return _native.gate_check(q, dq, DT, limits, margin)


def only(**limits) -> dict:
    """Limits of which only the given ones can trip."""
    return {**LOOSE, **{name: [value] for name, value in limits.items()}}


@pytest.mark.parametrize(
    ("q", "legal"),
    [(1.5, True), (1.5 + 1.1 * COUNT, False), (-1.0, True), (-1.0 - 1.1 * COUNT, False)],
)
def test_position_limit_has_no_margin_but_half_a_count(q, legal):
    trip = check([q])
    assert (trip is None) == legal
    if trip:
        assert trip[1:3] == (Cause.LIMIT_POSITION, 0)
        assert trip[3] == pytest.approx(q)
        assert trip[4] == pytest.approx(q, abs=1e-8)


def differences(order: int, value: float) -> np.ndarray:
    """Positions at rest, then with one constant n-th difference quotient."""
    steps = np.zeros(40)
    steps[10:] = value * DT**order
    for _ in range(order):
        steps = np.cumsum(steps)
    return steps


@pytest.mark.parametrize(
    ("order", "name", "limit", "cause"),
    [
        (1, "dq_max", 2.0, Cause.LIMIT_VELOCITY),
        (2, "ddq_max", 6.0, Cause.LIMIT_ACCELERATION),
        (3, "dddq_max", 300.0, Cause.LIMIT_JERK),
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_each_derivative_trips_just_outside_its_limit(order, name, limit, cause, sign):
    rounding = 2**order / 2 * COUNT / DT**order
    for value, legal in ((limit, True), (1.019 * limit, True), (1.021 * limit + 2 * rounding, False)):
        trip = check(differences(order, sign * value), only(**{name: limit}))
        assert (trip is None) == legal, value
        if trip:
            assert trip[1] == cause
            assert trip[3] * sign > 1.02 * limit
            assert trip[4] == limit


def test_velocity_field_of_the_frame_is_checked_too():
    q = np.zeros(3)
    assert check(q, dq=[0.0, 2.0, 0.0]) is None
    trip = check(q, dq=[0.0, 2.05, 0.0])
    assert trip[:3] == (1, Cause.LIMIT_VELOCITY, 0)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), float("-inf"), 1e300, 9.0])
@pytest.mark.parametrize("where", ["position", "velocity"])
def test_number_that_cannot_be_sent_trips(bad, where):
    q, dq = np.zeros(3), np.zeros(3)
    (q if where == "position" else dq)[1] = bad
    trip = check(q, only(dq_max=6.5), dq=dq)
    assert trip[:3] == (1, Cause.LIMIT_POSITION, 0)


@pytest.mark.parametrize("name", list(LIMITS))
def test_limit_that_is_not_a_number_trips(name):
    assert check([0.0, 0.0], {**LIMITS, name: [float("nan")]}) is not None


def test_first_violating_joint_is_named():
    limits = {name: value * 3 for name, value in LIMITS.items()}
    q = np.zeros((2, 3))
    q[1, 1] = 1e-3
    assert _native.gate_check(q, np.zeros((2, 3)), DT, limits)[:3] == (1, Cause.LIMIT_ACCELERATION, 1)


def test_a_move_at_exactly_its_limits_passes_however_it_rounds():
    """From rest to full speed and back, every phase at full jerk or full acceleration, without any margin."""
    times = np.arange(0.0, 0.5, DT)
    for offset in np.random.default_rng(9).uniform(-1e-6, 1e-6, 50):
        state = [np.array([x]) for x in (0.0, 2.0, 0.0, 6.0, 300.0)]
        _, stop, _, _ = _native.joint_stop(*state, times)
        assert stop[-1] == stop[-2]
        there_and_on = offset + np.vstack([-stop[::-1], stop[1:]])
        assert check(there_and_on, {**LIMITS, "q_min": [-2.0]}, margin=1.0) is None
