"""The motion of an attempt so far, as the fine model made it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from s2r_host.planning.execution import FineWorld, Report


@dataclass
class Course:
    """Joint targets one control step apart and what the fine model did between them; both may be taken back.

    The fine model gives the same numbers from a saved state as it gave on the way to it, so this is also what a replay
    of the targets from the start gives.

    Attributes:
        targets: Joint targets (dof,) [rad]; the first was in force at the start.
        states: Of the world, after each of them.
        path: Joint positions (dof,) [rad] and the object's joint [m or rad] in each state.
        reports: What happened on the way to each state but the first.
    """

    targets: list[np.ndarray] = field(default_factory=list)
    states: list[np.ndarray] = field(default_factory=list)
    path: list[tuple[np.ndarray, float]] = field(default_factory=list)
    reports: list[Report] = field(default_factory=list)

    @classmethod
    def beginning(cls, world: FineWorld) -> Course:
        """At rest where the world is now."""
        return cls([world.q], [world.save()], [(world.q, world.s)])

    def __len__(self) -> int:
        return len(self.states)

    def add(self, target: np.ndarray, world: FineWorld, report: Report) -> None:
        """Go on to a target that the world has just been taken to."""
        self.targets.append(target)
        self.states.append(world.save())
        self.path.append((world.q, world.s))
        self.reports.append(report)

    def cut(self, keep: int, world: FineWorld) -> None:
        """Take back all but the first ``keep`` states, and put the world into the last of these."""
        del self.targets[keep:], self.states[keep:], self.path[keep:], self.reports[keep - 1 :]
        world.restore(self.states[-1])

    def whole_report(self) -> Report:
        """What happened on the whole way."""
        report = Report()
        for some in self.reports:
            report = report.merged(some)
        return report

    def touch_step(self) -> int | None:
        """The first step, from 1, in which the fingertip touched the part, or None."""
        return next((step for step, report in enumerate(self.reports, 1) if report.touched), None)
