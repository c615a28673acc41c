"""One stage of the cascade: from the start pose to a held target, or to the reason why it is not reached."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from s2r_host.planning.course import Course
from s2r_host.planning.execution import FineWorld, Report
from s2r_host.planning.hook import Hook
from s2r_host.planning.lookahead import Lookahead
from s2r_host.planning.patience import Patience
from s2r_host.planning.proposals import Route
from s2r_host.planning.rewards import Task
from s2r_host.planning.rollouts import ramp
from s2r_host.planning.sampler import SamplerFactory
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings, Stage
from s2r_host.planning.task import PlanResult, StepTrace

_STILL_STEPS, _STILL_M = 15, 5e-4  # control steps without motion after which an attempt is given up
# The same without progress: neither the part nearer to its target nor the fingertip to its place, by so much.
_IDLE_STEPS, _IDLE_M, _IDLE_BANDS = 25, 0.002, 2.0
_NEAR_BANDS = 5.0  # success bands around the target within which landing takes its time
_BACK_STEPS = 3  # how far the first step back goes; the second goes twice as far, and so on
_LEAST_ACTION = 0.05  # share of the largest action that is left where the way with a hinge's part is short
_USUAL_WAY_RAD = 1.5  # of the arm with the part; a longer one is granted more control steps
_LANDING_STEPS = 9  # shares of the last action tried until the hold ends on target


@dataclass
class Attempt:
    """One stage of the cascade, from the start pose to the held target or to a reason for failing."""

    # Of the full speed to the place; the next where the arm lags into something on its way.
    lead_in_shares: ClassVar[tuple[float, ...]] = (1.0, 0.4)

    scene: Scene
    stage: Stage
    index: int
    settings: PlanSettings
    task: Task
    hook: Hook
    world: FineWorld
    seed: int
    patience: Patience
    make_sampler: SamplerFactory
    course: Course = field(default_factory=Course)
    trace: list[StepTrace] = field(default_factory=list)
    env_steps: int = 0
    reason: str | None = "not run"
    steps_done: int = 0
    arrived: bool = True  # the fingertip came to its place
    stuck: bool = False  # from there it got nowhere, or not far enough
    _rest: float | None = None  # s_target - s after holding the target in force, where that has been tried

    def run(self) -> None:
        """Plan and execute until the target is held, or give up."""
        self.course = Course.beginning(self.world)
        try:
            self.reason = self._search() or self._hold_the_target()
        finally:
            self.world.restore(self.course.states[0])

    def _search(self) -> str | None:
        """Choose and execute actions until standing still would end on target; the landing is the last target."""
        settings, course = self.settings, self.course
        if settings.lead_in:
            problem = self._lead_in()
            if problem is not None:
                self.arrived = False
                return problem
        at_part = replace(settings, action_max_rad=self._action_rad())
        ahead = Lookahead(
            self.scene, self.stage, at_part, self.task, self.hook, course.targets[0], (self.seed, self.index),
            self.make_sampler, self.world.others,
        )  # fmt: skip
        first, backtracks = len(course), 0
        for step in range(self._most_steps()):
            self.patience.step(f"attempt {self.index + 1}, step {step}, s = {self.world.s:.4f}")
            before, target = course.states[-1], course.targets[-1]
            ranked, values = ahead.ranked(self.world.data, target)
            self.env_steps = ahead.env_steps
            goals = ahead.targets(target, ranked[:, :1])[:, 1]
            goal, rank, report = self._execute(target, goals, before)
            self._note(step, float(values[rank]), rank, report)
            if report.contact is not None or report.press_N > settings.press_max_N:
                backtracks += 1
                if backtracks > settings.backtracks:
                    return harm_of(report)
                course.cut(max(first, len(course) - _BACK_STEPS * backtracks), self.world)
                self._rest = None
                ahead.sampler.forget()
                continue
            if self._land(before, target, goal):
                return None
            course.add(goal, self.world, report)
            ahead.sampler.advance()
            if self._is_stuck():
                self.stuck = True
                return f"no progress any more after {step + 1} control steps: s = {self.world.s:.4f}"
        self.stuck = True
        unit = "m" if self.scene.prismatic else "rad"
        return (
            f"the target was not reached in {self._most_steps()} control steps: s = {self.world.s:.4f} {unit}, "
            f"target {self.task.s_target:.4f} {unit}, fingertip {self.trace[-1].distance_m:.3f} m from its place"
        )

    def _most_steps(self) -> int:
        """Control steps after which to give up; more where the arm has a long way to go with the part."""
        if not self.settings.lead_in:
            return self.settings.max_steps
        return int(np.ceil(self.settings.max_steps * max(1.0, self._way_rad() / _USUAL_WAY_RAD)))

    def _way_rad(self) -> float:
        """Way of the arm with the part, of the joint that goes farthest [rad]."""
        route = self.hook.whole_route[self.hook.touch_row :]
        return float(np.abs(np.diff(route, axis=0)).max(axis=1).sum())

    def _action_rad(self) -> float:
        """Largest action at the part [rad]."""
        most, steps = self.settings.action_max_rad, self.settings.turn_steps
        if steps is None or self.scene.prismatic or not self.settings.lead_in:
            return most
        return most * float(np.clip(self._way_rad() / (steps * most), _LEAST_ACTION, 1.0))

    def _is_stuck(self) -> bool:
        """Neither part nor fingertip got anywhere lately: the sampler finds nothing better than to stay or fumble."""
        lately = self.trace[-_STILL_STEPS:]
        ways = np.ptp([(entry.s, entry.distance_m) for entry in lately], axis=0)
        if len(lately) == _STILL_STEPS and ways[0] < 0.1 * self.task.tolerance and ways[1] < _STILL_M:
            return True
        if not self.settings.lead_in:
            return False  # free space without a way takes detours
        left = np.array([(abs(self.task.s_target - entry.s), entry.distance_m) for entry in self.trace])
        if len(left) <= _IDLE_STEPS or left[-1, 0] < _NEAR_BANDS * self.task.tolerance:
            return False
        gained = left[:-_IDLE_STEPS].min(axis=0) - left[-_IDLE_STEPS:].min(axis=0)
        return bool(gained[0] < _IDLE_BANDS * self.task.tolerance and gained[1] < _IDLE_M)

    def _lead_in(self) -> str | None:
        """Go through free space to the place behind the part, or say what is in the way.

        The sampler is for contact. Through free space it finds its way too, more slowly and not everywhere.
        """
        waypoints = np.concatenate([self.course.targets, self.hook.whole_route[: self.hook.touch_row]])
        report = Report()
        for share in self.lead_in_shares:
            self.course.cut(1, self.world)
            report = self._go(waypoints, share * self.settings.action_max_rad)
            if report.contact is None:
                return None
        return f"on the way to the part it {harm_of(report)}"

    def _go(self, waypoints: np.ndarray, action_rad: float) -> Report:
        """Follow a polyline (n, dof) [rad] with changes of the joint targets of a given size, up to a contact."""
        report = Report()
        for goal in Route(waypoints, action_rad).points[1:]:
            report = self._play(self.course.targets[-1], goal)
            self.course.add(goal, self.world, report)
            if report.contact is not None:
                break
        return report

    def _execute(
        self, target: np.ndarray, goals: np.ndarray, before: np.ndarray
    ) -> tuple[np.ndarray, int, Report]:
        """Execute the best-ranked action that the fine model finds harmless; if none is, the least harmful one.

        A contact is worse than pressing, and pressing than a saturated motor, which the timed motion, slower than the
        plan, may not have.
        """
        tried: list[tuple[tuple[bool, bool, bool], int, np.ndarray]] = []
        for rank, goal in enumerate(goals[: self.settings.retries]):
            report = self._play(target, goal)
            harm = (
                report.contact is not None,
                report.press_N > self.settings.press_max_N,
                report.torque_share > self.settings.torque_margin,
            )
            if not any(harm):
                return goal, rank, report
            tried.append((harm, rank, goal))
            self.world.restore(before)
        _, rank, goal = min(tried, key=lambda entry: entry[:2])
        return goal, rank, self._play(target, goal)

    def _play(self, start: np.ndarray, goal: np.ndarray) -> Report:
        substeps = round(self.settings.control_dt_s / self.settings.fine_timestep_s)
        return self.world.play(ramp(np.stack([start, goal])[None], substeps)[0])

    def _land(self, before: np.ndarray, target: np.ndarray, goal: np.ndarray) -> bool:
        """Whether standing still after some share of the action just executed ends on target; that becomes the motion.

        Leaves the world after the whole action when there is none.
        """
        after = self.world.save()
        if self._missing() > 0.25 * abs(self.task.s_target - self.task.s_initial) + 5.0 * self.task.tolerance:
            self._rest = None
            return False
        low = self._held(before, target, target) if self._rest is None else self._rest
        high = self._rest = self._held(before, target, goal)
        landed: np.ndarray | None = None
        if min(abs(low), abs(high)) < 0.8 * self.task.tolerance:
            landed = goal if abs(high) < abs(low) else target
        elif low * high <= 0.0:
            landed = self._between(before, target, goal, low, high)
        if landed is None:
            self.world.restore(after)
            return False
        self.world.restore(before)
        self.course.add(landed, self.world, self._play(target, landed))
        return True

    def _between(
        self, before: np.ndarray, target: np.ndarray, goal: np.ndarray, low: float, high: float
    ) -> np.ndarray | None:
        """The joint target between two, after which the rests ``low`` and ``high`` have other signs, that lands.

        Regula falsi with the Illinois rule: an end that stays put counts half. Halving where a rest is infinite.
        """
        near, far = 0.0, 1.0
        for _ in range(_LANDING_STEPS):
            finite = np.isfinite(low) and np.isfinite(high)
            middle = near + (far - near) * (low / (low - high) if finite else 0.5)
            candidate = target + middle * (goal - target)
            missing = self._held(before, target, candidate)
            if abs(missing) < 0.5 * self.task.tolerance:
                return candidate
            if missing * low > 0.0:
                near, low, high = middle, missing, 0.5 * high
            else:
                far, high, low = middle, missing, 0.5 * low
        return None

    def _missing(self) -> float:
        return abs(self.task.s_target - self.world.s)

    def _held(self, before: np.ndarray, target: np.ndarray, goal: np.ndarray) -> float:
        """Signed rest ``s_target - s`` after going to ``goal`` and holding it; infinite if that touches anything."""
        self.world.restore(before)
        substeps = round(self.settings.hold_s / self.settings.fine_timestep_s)
        report = self._play(target, goal)
        report = report.merged(self.world.play(np.broadcast_to(goal, (substeps, len(goal)))))
        return np.inf if report.contact is not None else self.task.s_target - self.world.s

    def _hold_the_target(self) -> str | None:
        """Hold the last target, and say what of the whole motion keeps it from being delivered."""
        hold_steps = round(self.settings.hold_s / self.settings.control_dt_s)
        target = self.course.targets[-1]
        for _ in range(hold_steps):
            self.course.add(target, self.world, self._play(target, target))
        report = self.course.whole_report()
        if report.contact is not None or report.press_N > self.settings.press_max_N:
            return harm_of(report)
        late = [abs(self.task.s_target - s) for _, s in self.course.path[-(hold_steps // 2) :]]
        # A lid on a soft friction creeps a little: it may pass the target during the hold, not leave it.
        if max(late) >= 2.0 * self.task.tolerance or late[-1] >= self.task.tolerance:
            return f"the target is not held: s = {self.world.s:.4f} at the end of the hold"
        return None

    def _note(self, step: int, predicted: float, rank: int, report: Report) -> None:
        data, body = self.world.data, self.scene.part_body
        tip = data.site_xpos[self.scene.tool_site] - data.xpos[body]
        distance_m = float(self.hook.distance((data.xmat[body].reshape(3, 3).T @ tip)[None])[0])
        self.steps_done = step + 1
        self.trace.append(
            StepTrace(
                self.index,
                step,
                self.world.s,
                distance_m,
                predicted,
                rank,
                report.torque_share,
                report.contact,
            )
        )

    def result(self, attempts: list[Attempt]) -> PlanResult:
        """This attempt as the answer, with the costs of all of them."""
        course = self.course
        s = np.array([value for _, value in course.path])
        hold_steps = round(self.settings.hold_s / self.settings.control_dt_s)
        report = course.whole_report()
        return PlanResult(
            success=self.reason is None,
            q_cmd=np.array(course.targets),
            q_meas=np.array([q for q, _ in course.path]),
            s=s,
            control_dt_s=self.settings.control_dt_s,
            s_initial=self.task.s_initial,
            s_target=self.task.s_target,
            final=float(s[-1]),
            error=self.task.s_target - float(s[-1]),
            reason=self.reason or "held on target",
            touch_step=course.touch_step(),
            hold_step=max(len(course.targets) - 1 - hold_steps, 0),
            stage=self.index,
            control_steps=sum(a.steps_done for a in attempts),
            env_steps=sum(a.env_steps for a in attempts),
            cpu_s=0.0,
            wall_s=0.0,
            places_cpu_s=0.0,
            torque_share=report.torque_share,
            contact=report.contact,
            hook=self.hook,
            p_part=self.hook.p_part,
            route=self.hook.whole_route,
            route_touch=self.hook.touch_row,
            trace=tuple(entry for a in attempts for entry in a.trace),
        )


def harm_of(report: Report) -> str:
    """What a motion did that no motion may, for the end of a sentence."""
    if report.contact is not None:
        return f"touches something unexpected: {report.contact}"
    return f"presses on the part with {report.press_N:.0f} N across its motion"
