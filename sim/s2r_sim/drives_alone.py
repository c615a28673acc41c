"""Drives without a world: every joint turns a load of its own. Fast, for tests of the bus and of the executor."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from s2r_protocol.arms import ArmDescription
from s2r_sim.drives import LOAD_OVER_ROTOR, Drive, drive_parameters
from s2r_sim.physics import STEP_NS, rotor_inertia
from s2r_sim.plant import Plant


class DrivesAlone(Plant):
    """The drives of an arm on uncoupled inertias, without gravity. Time moves only in :meth:`advance`."""

    def __init__(self, arm: ArmDescription, q: np.ndarray | None = None) -> None:
        """Drives off, brakes on, at ``q`` [rad], shape (dof,); home by default."""
        start = arm.q_home if q is None else q
        self.drives = [
            Drive(i + 1, p, float(x))
            for i, (p, x) in enumerate(zip(drive_parameters(arm), start, strict=True))
        ]
        self.t_ns = 0
        self.master_tick = 0
        self.observers: list[Callable[[Plant], None]] = []
        self.q = [float(x) for x in start]
        self.dq = [0.0] * arm.dof
        self._inertia = [LOAD_OVER_ROTOR * float(r) for r in rotor_inertia(arm)]
        for drive, angle in zip(self.drives, self.q, strict=True):
            drive.measure(angle, 0.0)

    def advance(self, period_ns: int) -> None:
        """One communication period: drives first, then the loads step by step (semi-implicit Euler)."""
        period_s, dt = period_ns * 1e-9, STEP_NS * 1e-9
        for drive in self.drives:
            drive.period(period_s)
        steps = period_ns // STEP_NS
        for k in range(steps):
            phase = (k + 1) / steps
            for i, drive in enumerate(self.drives):
                inertia = self._inertia[i]
                self.dq[i] += drive.torque(inertia * drive.ddq_set, phase, dt) / inertia * dt
                self.q[i] += self.dq[i] * dt
                drive.measure(self.q[i], self.dq[i])
            self.t_ns += STEP_NS
