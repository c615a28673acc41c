"""Drives and physics together: what one communication period does to the world."""

from __future__ import annotations

from collections.abc import Callable

from s2r_protocol.arms import ArmDescription
from s2r_sim.drives import Drive, drive_parameters
from s2r_sim.physics import STEP_NS, Physics
from s2r_sim.world import WorldSpec


class Plant:
    """The hidden world with its drives on. Time moves only in :meth:`advance`.

    Attributes:
        t_ns: Simulated time since the start.
        master_tick: The bus master's tick of the newest set-point.
        observers: Called after every physics step (truth log, snapshot for the camera).
    """

    def __init__(self, arm: ArmDescription, world: WorldSpec) -> None:
        self.physics = Physics(arm, world)
        q = self.physics.q
        self.drives = [Drive(i + 1, p, q[i]) for i, p in enumerate(drive_parameters(arm))]
        self.t_ns = 0
        self.master_tick = 0
        self.observers: list[Callable[[Plant], None]] = []
        self._measure()

    @property
    def at_rest(self) -> bool:
        """All brakes on, nothing moves."""
        return all(drive.stopped for drive in self.drives)

    def advance(self, period_ns: int) -> None:
        """One communication period: drives first, then physics step by step."""
        period_s, dt = period_ns * 1e-9, STEP_NS * 1e-9
        for drive in self.drives:
            drive.period(period_s)
        steps = period_ns // STEP_NS
        physics, drives = self.physics, self.drives
        for k in range(steps):
            phase = (k + 1) / steps
            bias = physics.nominal_torque(
                [d.q_meas for d in drives], [d.dq_meas for d in drives], [d.ddq_set for d in drives]
            )
            physics.step([d.torque(b, phase, dt) for d, b in zip(drives, bias, strict=True)])
            self._measure()
            self.t_ns += STEP_NS
            for observer in self.observers:
                observer(self)

    def _measure(self) -> None:
        for drive, q, dq in zip(self.drives, self.physics.q, self.physics.dq, strict=True):
            drive.measure(q, dq)
