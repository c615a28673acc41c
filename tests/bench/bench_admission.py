"""How long admission of a 500-knot, 7-joint plan takes: ``python tests/bench/bench_admission.py [--json]``.

CPU time of one thread, everything included: form, bounds, torque, collision, stops. Median of 40 runs after warm-up.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np

from s2r_executor.admission import Admission
from s2r_executor.config import AdmissionConfig, CoreConfig
from s2r_executor.plan import PlanRequest
from s2r_protocol.arms import load_arm


def plan(knots: int, duration_s: float) -> PlanRequest:
    """A minimum-jerk move of all joints, about a third of the limits."""
    arm = load_arm("xmate3pro")
    t = np.linspace(0.0, duration_s, knots)
    x = t / duration_s
    s, ds = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / duration_s
    dds = 60 * x * (1 - x) * (1 - 2 * x) / duration_s**2
    delta = np.array([0.6, 0.4, -0.4, -0.4, 0.6, 0.4, 0.8])
    q = arm.q_home + s[:, None] * delta
    return PlanRequest(arm.joint_names, t, q, ds[:, None] * delta, dds[:, None] * delta)


def main() -> None:
    arm = load_arm("xmate3pro")
    admission = Admission(arm, AdmissionConfig(), CoreConfig())
    found = {}
    for knots, duration_s in ((40, 2.0), (500, 5.0), (500, 10.0), (4000, 40.0)):
        request = plan(knots, duration_s)
        cost_ms = []
        for _ in range(45):
            begin = time.thread_time()
            admission.admit(request, arm.q_home)
            cost_ms.append(1e3 * (time.thread_time() - begin))
        found[f"{knots} knots, {duration_s:g} s"] = round(float(np.median(cost_ms[5:])), 2)
    if "--json" in sys.argv:
        print(json.dumps(found))
    else:
        for name, value in found.items():
            print(f"{name:>20}: {value:6.2f} ms")


if __name__ == "__main__":
    main()
