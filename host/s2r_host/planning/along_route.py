"""The offered route played as it is, without a sampler: the last resort where sampling got stuck.

A hand that fits into a ring by a millimetre has one way to go, and noise leaves it; a gate of 40 kg starts so slowly
that no sample sees it come nearer within the horizon. The route is known to be free, so it is played.
"""

from __future__ import annotations

import numpy as np

from s2r_host.planning.attempt import Attempt, harm_of
from s2r_host.planning.proposals import Route

_SPEED = 0.4  # of the largest action: the servos lag little
_SETTLE_STEPS = 4  # at the place: what the servos still lag would scrape along the part
_BEYOND = 0.5  # of the way of the part: how far the route's last direction is followed, for what servos and part give


class AlongRoute(Attempt):
    """Goes to the place and on along the hook's route until the part lands on target, or something is in the way."""

    lead_in_shares = (_SPEED,)

    def _search(self) -> str | None:
        problem = self._lead_in()
        if problem is not None:
            self.arrived = False
            return problem
        waiting = np.tile(self.course.targets[-1], (_SETTLE_STEPS, 1))
        for step, goal in enumerate(np.concatenate([waiting, self._goals()])):
            self.patience.step(f"along the route, step {step}, s = {self.world.s:.4f}")
            before, target = self.course.states[-1], self.course.targets[-1]
            report = self._play(target, goal)
            self._note(step, np.nan, 0, report)
            if report.contact is not None or report.press_N > self.settings.press_max_N:
                return harm_of(report)
            if self._land(before, target, goal):
                return None
            self.course.add(goal, self.world, report)
        return f"the route ends at s = {self.world.s:.4f}"

    def _goals(self) -> np.ndarray:
        """Joint targets from the place to the target and beyond, (n, dof) [rad]."""
        way = self.hook.whole_route[self.hook.touch_row - 1 :]
        beyond = way[-1] + _BEYOND * (len(way) - 2) * (way[-1] - way[-2])
        limits, margin = self.scene.arm.limits, self.settings.joint_margin_rad
        last = np.clip(beyond, limits.q_min + margin, limits.q_max - margin)
        return Route(np.concatenate([way, last[None]]), _SPEED * self.settings.action_max_rad).points[1:]
