"""Pauses, resumes and a stop on admitted plans of the host, whose segments differ in how long a stop takes them."""

from __future__ import annotations

import numpy as np
import pytest
from hil_bench import ARM, PAUSE, RESUME, STOP, Plan, Stepped

from s2r_executor.checks.dynamics import InverseDynamics
from s2r_executor.config import AdmissionConfig
from s2r_executor.quintic import spline_through
from s2r_executor.stop_ramps import load_along, stop_durations
from s2r_host.trajectory import time_law
from s2r_protocol.faults import ExecutorState

SETTINGS = AdmissionConfig()
DYNAMICS = InverseDynamics(ARM)
HOLD, RUN, PAUSED = ExecutorState.HOLD, ExecutorState.RUN, ExecutorState.PAUSED
MOVING = (RUN, PAUSED, ExecutorState.STOPPING)


def host_plan(rng: np.random.Generator, start: np.ndarray) -> Plan:
    """A few bends between two postures, with the stops that admission finds."""
    way = start + np.linspace(0.0, 1.0, int(rng.integers(3, 7)))[:, None] * rng.normal(
        scale=0.6, size=ARM.dof
    )
    way[1:-1] += rng.normal(scale=0.1, size=way[1:-1].shape)
    way[1:] = np.clip(way[1:], ARM.limits.q_min + 0.02, ARM.limits.q_max - 0.02)
    motion = time_law(way, ARM)
    spline = spline_through(motion.t, motion.q, motion.dq, motion.ddq)
    load = load_along(spline, DYNAMICS.torque)
    tau_limit = (1 - SETTINGS.torque_margin) * ARM.limits.tau_max
    stops = stop_durations(spline, load, ARM.limits, ARM.joint_names, tau_limit, SETTINGS.stop_duration_max_s)
    return Plan(motion.t, motion.q, motion.dq, motion.ddq, stops)


def wait(bench: Stepped, ticks: int) -> None:
    for _ in range(ticks):
        bench.motion_ticks.append(bench.now.tick)  # motion may begin again after any of these
        bench.step()
        if bench.now.state not in MOVING:
            return


@pytest.mark.parametrize("part", range(4))
def test_a_stop_amid_pauses_and_resumes_of_a_hosts_plan_ends_in_hold(part):
    for case in range(15 * part, 15 * part + 15):
        rng = np.random.default_rng([77, case])
        bench = Stepped(path_tolerance_rad=1.0, frozen_rad=1.0)  # what the drives do is not the question here
        bench.step(1)
        plan = host_plan(rng, np.array([d.q_meas for d in bench.plant.drives]))
        bench.moving(0, plan)
        wait(bench, int(rng.integers(20, max(30, plan.t[-1] * 700))))
        for _ in range(int(rng.integers(1, 4))):
            if bench.now.state == RUN:
                bench.command(PAUSE)
                wait(bench, int(rng.integers(20, 500)))
            if bench.now.state in (RUN, PAUSED):
                bench.command(RESUME)
                wait(bench, int(rng.integers(5, 250)))
        bench.command(STOP)
        rates = [0.0]
        while bench.now.state in MOVING:
            bench.step()
            rates.append(bench.now.speed_scale if bench.now.state in MOVING else 0.0)
        assert bench.now.state == HOLD, (case, bench.now.cause, bench.now.cause_value, bench.now.cause_limit)
        assert max(rates) <= 1.0 + 1e-9, case
        bench.judge()
