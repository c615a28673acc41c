"""Wherever on a host's motion a stop or a resume begins, no setpoint leaves the limits."""

import os

import numpy as np
import pytest

from s2r_executor.checks.dynamics import InverseDynamics
from s2r_executor.config import AdmissionConfig, CoreConfig
from s2r_executor.quintic import Spline, sample, spline_through
from s2r_executor.stop_ramps import load_along, stop_durations
from s2r_host.trajectory import Trajectory, time_law
from s2r_host.trajectory.time_law import limit_stretch
from s2r_host.trajectory.torque import InverseDynamics as HostDynamics
from s2r_host.trajectory.torque import torque_stretch
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
DYNAMICS = InverseDynamics(ARM)
SETTINGS = AdmissionConfig()
GATE_MARGIN = CoreConfig().gate_margin
# Every case looks at every millisecond of one motion; S2R_STOPS=100 is the long form.
CASES = int(os.environ.get("S2R_STOPS", "6"))
TICK_S = 1e-3


def postures(rng: np.random.Generator, count: int) -> np.ndarray:
    """Bends of a few tenths of a radian on the way between two postures."""
    low, high = ARM.limits.q_min + 0.05, ARM.limits.q_max - 0.05
    start = ARM.q_home + rng.normal(scale=0.3, size=ARM.dof)
    end = start + rng.normal(scale=0.6, size=ARM.dof)
    way = np.linspace(start, end, count)
    way[1:-1] += rng.normal(scale=0.1, size=(count - 2, ARM.dof))
    return np.clip(way, low, high)


def straight(q0: np.ndarray, q1: np.ndarray) -> Trajectory:
    """As fast as the limits allow, without a knot between its ends, as other clients than ours may send it."""
    rest = np.zeros((2, ARM.dof))
    line = Trajectory(np.array([0.0, 1.0]), np.array([q0, q1]), rest, rest)
    line = line.stretched(limit_stretch(line, ARM, 0.9))
    return line.stretched(torque_stretch(line, ARM, HostDynamics(ARM), 0.9))


def durations(spline: Spline) -> np.ndarray:
    """As admission finds them."""
    tau_limit = (1 - SETTINGS.torque_margin) * ARM.limits.tau_max
    load = load_along(spline, DYNAMICS.torque)
    return stop_durations(spline, load, ARM.limits, ARM.joint_names, tau_limit, SETTINGS.stop_duration_max_s)


def covered(x: np.ndarray) -> np.ndarray:
    """Integral of S(x) = 6x⁵ − 15x⁴ + 10x³ from 0; beyond 1 the rate is 1."""
    inside = np.clip(x, 0.0, 1.0)
    return inside**4 * (2.5 + inside * (-3 + inside)) + np.maximum(0.0, x - 1.0)


def largest_shares(spline: Spline, path_t: np.ndarray) -> tuple[float, float]:
    """Of the limits of acceleration and jerk, by differences over ticks; path times (starts, ticks)."""
    q = sample(spline, np.clip(path_t, 0.0, spline.duration_s).ravel()).q.reshape(*path_t.shape, ARM.dof)
    acceleration = np.diff(q, n=2, axis=1) / TICK_S**2
    jerk = np.diff(q, n=3, axis=1) / TICK_S**3
    return (
        float((np.abs(acceleration) / ARM.limits.ddq_max).max()),
        float((np.abs(jerk) / ARM.limits.dddq_max).max()),
    )


@pytest.mark.parametrize("law", ["path", "straight"])
@pytest.mark.parametrize("case", range(CASES))
def test_a_stop_or_a_resume_from_every_millisecond_stays_inside_the_gate(case, law):
    rng = np.random.default_rng([11, case])
    way = postures(rng, int(rng.integers(3, 8)))
    motion = time_law(way, ARM) if law == "path" else straight(way[0], way[-1])
    spline = spline_through(motion.t, motion.q, motion.dq, motion.ddq)

    starts = np.arange(0.0, spline.duration_s, TICK_S) + rng.uniform(0.0, TICK_S)
    segment = np.clip(np.searchsorted(spline.t, starts, side="right") - 1, 0, len(spline.t) - 2)
    duration = durations(spline)[segment]
    for many in np.array_split(np.arange(len(starts)), 20):  # a few hundred megabytes otherwise
        s, T = starts[many, None], duration[many, None]
        tick = TICK_S * np.arange(-3, int(T.max() / TICK_S) + 4)
        x = tick / T
        stop = np.where(tick < 0, s + tick, s + T * (np.minimum(x, 1.0) - covered(np.minimum(x, 1.0))))
        resume = np.where(tick < 0, s, s + T * covered(x))
        for name, path_t in (("stop", stop), ("resume", resume)):
            acceleration, jerk = largest_shares(spline, path_t)
            assert acceleration <= GATE_MARGIN, f"{name}: {acceleration:.4f} of the acceleration limit"
            assert jerk <= GATE_MARGIN, f"{name}: {jerk:.4f} of the jerk limit"
