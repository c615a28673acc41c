"""Receding-horizon planning through contact: iCEM in the coarse model, every action executed in the fine one."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field, replace

import numpy as np

from s2r_host.planning.door import check_numbers, check_stays, check_target
from s2r_host.planning.execution import FineWorld, Report
from s2r_host.planning.hook import Hook
from s2r_host.planning.hooking import find_hooks
from s2r_host.planning.lookahead import Lookahead
from s2r_host.planning.patience import Patience
from s2r_host.planning.proposals import Route
from s2r_host.planning.rewards import Task
from s2r_host.planning.rollouts import ramp
from s2r_host.planning.sampler import SamplerFactory, icem_sampler
from s2r_host.planning.scene import Scene, build_scene
from s2r_host.planning.settings import PlanSettings, Stage
from s2r_host.planning.task import PlanRefusedError, PlanRequest, PlanResult, StepTrace

logger = logging.getLogger(__name__)

_STILL_STEPS, _STILL_M = 15, 5e-4  # control steps without progress after which an attempt is given up
_BACK_STEPS = 3  # how far the first step back goes; the second goes twice as far, and so on
_USUAL_WAY_RAD = 1.5  # of the arm with the part; a longer one is granted more control steps
_LANDING_STEPS = 9  # shares of the last action tried until the hold ends on target


def scene_of(request: PlanRequest) -> Scene:
    """The two models that a request is planned in.

    Raises:
        SceneFileError: The object file is unusable.
    """
    return build_scene(
        request.arm, request.object_mjcf, request.joint, request.settings, in_scene=request.in_scene
    )


def world_of(request: PlanRequest, scene: Scene) -> FineWorld:
    """The fine model where a request begins."""
    return FineWorld(scene, np.asarray(request.q_initial, dtype=float), request.s_initial, request.others)


def plan_manipulation(
    request: PlanRequest,
    scene: Scene | None = None,
    patience: Patience | None = None,
    sampler: SamplerFactory = icem_sampler,
) -> PlanResult:
    """Plan how the arm moves the object's joint from ``s_initial`` to ``s_target``.

    Every action is chosen by rollouts in the coarse model and executed in the fine model, whose state the next
    rollouts start from. The plan is delivered only after the fine model has held the target for ``hold_s`` and a
    replay has found no unexpected contact at any substep and no torque beyond its limit; else the next stage of
    the cascade tries, and after the last one the result says why there is no plan.

    Args:
        request: The task.
        scene: Its scene, if it has been built already.
        patience: A limit on the time, and who is told about progress.
        sampler: What draws the action sequences.

    Raises:
        PlanRefusedError: The request is impossible or absurd; the text says which.
        OutOfReachError: The arm cannot get its fingertip behind the part.
        SceneFileError: The object file is unusable.
        TimeIsUpError: The time limit has passed.
    """
    start_wall, start_cpu = time.perf_counter(), time.process_time()
    patience = patience or Patience()
    check_numbers(request)
    settings = request.settings
    scene = scene or scene_of(request)
    tolerance = settings.tolerance_m if scene.prismatic else settings.tolerance_rad
    world = world_of(request, scene)
    _check_possible(request, scene, world, tolerance)
    patience.check("looking for places for the fingertip")
    before_places = time.process_time()
    hooks = find_hooks(scene, world, request.object_mjcf, request.s_target, settings, leave=request.leave)
    places_cpu_s = time.process_time() - before_places
    task = Task(request.s_initial, request.s_target, tolerance, scene.prismatic)
    attempts = []
    for index, stage in enumerate(settings.cascade):
        attempt = _Attempt(
            scene,
            stage,
            index,
            settings,
            task,
            hooks[index % len(hooks)],
            world,
            request.seed,
            patience,
            sampler,
        )
        attempt.run()
        attempts.append(attempt)
        if attempt.reason is None:
            break
        logger.info("stage %d of the plan failed: %s", index, attempt.reason)
    result = attempts[-1].result(attempts)
    return replace(
        result,
        cpu_s=time.process_time() - start_cpu,
        wall_s=time.perf_counter() - start_wall,
        places_cpu_s=places_cpu_s,
    )


def is_possible(request: PlanRequest, scene: Scene) -> bool:
    """Whether a request passes the door: what then fails is the search for a plan."""
    tolerance = request.settings.tolerance_m if scene.prismatic else request.settings.tolerance_rad
    try:
        check_numbers(request)
        _check_possible(request, scene, world_of(request, scene), tolerance)
    except PlanRefusedError:
        return False
    return True


def _check_possible(request: PlanRequest, scene: Scene, world: FineWorld, tolerance: float) -> None:
    check_target(request, scene, tolerance)
    check_stays(request, scene, tolerance)
    contact = world.check_now().contact
    if contact is not None:
        raise PlanRefusedError(
            f"the start pose is in contact: {contact}; move the arm away from the object first"
        )


@dataclass
class _Attempt:
    """One stage of the cascade, from the start pose to the held target or to a reason for failing."""

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
    targets: list[np.ndarray] = field(default_factory=list)
    trace: list[StepTrace] = field(default_factory=list)
    env_steps: int = 0
    reason: str | None = "not run"
    played: Report = field(default_factory=Report)
    path: list[tuple[np.ndarray, float]] = field(default_factory=list)
    touch_step: int | None = None
    steps_done: int = 0
    _rest: float | None = None  # s_target - s after holding the target in force, where that has been tried

    def run(self) -> None:
        """Plan and execute until the target is held, or give up."""
        initial = self.world.save()
        try:
            self.reason = self._search()
            if self.reason is None:
                self.world.restore(initial)
                self.reason = self._replay()
        finally:
            self.world.restore(initial)

    def _search(self) -> str | None:
        settings = self.settings
        target = self.world.q
        ahead = Lookahead(
            self.scene, self.stage, settings, self.task, self.hook, target, (self.seed, self.index),
            self.make_sampler,
        )  # fmt: skip
        self.targets = [target]
        states = [self.world.save()]
        if settings.lead_in:
            problem = self._lead_in(states)
            if problem is not None:
                return problem
            target = self.targets[-1]
        first, backtracks = len(states), 0
        for step in range(self._most_steps()):
            self.patience.step(f"attempt {self.index + 1}, step {step}, s = {self.world.s:.4f}")
            ranked, values = ahead.ranked(self.world.data, target)
            self.env_steps = ahead.env_steps
            goals = ahead.targets(target, ranked[:, :1])[:, 1]
            goal, rank, report = self._execute(target, goals, states[-1])
            self._note(step, float(values[rank]), rank, report)
            if report.contact is not None or report.press_N > settings.press_max_N:
                backtracks += 1
                if backtracks > settings.backtracks:
                    return _harm(report)
                keep = max(first, len(states) - _BACK_STEPS * backtracks)
                del states[keep:], self.targets[keep:]
                self.world.restore(states[-1])
                target = self.targets[-1]
                self._rest = None
                ahead.sampler.forget()
                continue
            landed = self._land(states[-1], target, goal)
            if landed is not None:
                self.targets.append(landed)
                return None
            target = goal
            self.targets.append(goal)
            states.append(self.world.save())
            ahead.sampler.advance()
            if self._stands_still():
                return f"nothing moves any more after {step + 1} control steps: s = {self.world.s:.4f}"
        unit = "m" if self.scene.prismatic else "rad"
        return (
            f"the target was not reached in {self._most_steps()} control steps: s = {self.world.s:.4f} {unit}, "
            f"target {self.task.s_target:.4f} {unit}, fingertip {self.trace[-1].distance_m:.3f} m from its place"
        )

    def _most_steps(self) -> int:
        """Control steps after which to give up; more where the arm has a long way to go with the part."""
        if not self.settings.lead_in:
            return self.settings.max_steps
        way_rad = np.abs(np.diff(self.hook.whole_route[self.hook.touch_row :], axis=0)).max(axis=1).sum()
        return int(np.ceil(self.settings.max_steps * max(1.0, way_rad / _USUAL_WAY_RAD)))

    def _stands_still(self) -> bool:
        """Neither part nor fingertip got anywhere lately: the sampler finds nothing better than to stay."""
        lately = self.trace[-_STILL_STEPS:]
        ways = np.ptp([(entry.s, entry.distance_m) for entry in lately], axis=0)
        return len(lately) == _STILL_STEPS and ways[0] < 0.1 * self.task.tolerance and ways[1] < _STILL_M

    def _lead_in(self, states: list[np.ndarray]) -> str | None:
        """Go through free space to the place behind the part, or say what is in the way.

        The sampler is for contact. Through free space it finds its way too, more slowly and not everywhere.
        """
        waypoints = np.concatenate([self.targets[:1], self.hook.whole_route[: self.hook.touch_row]])
        for goal in Route(waypoints, self.settings.action_max_rad).points[1:]:
            report = self._play(self.targets[-1], goal)
            self.targets.append(goal)
            states.append(self.world.save())
            if report.contact is not None:
                return _harm(report)
        return None

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

    def _land(self, before: np.ndarray, target: np.ndarray, goal: np.ndarray) -> np.ndarray | None:
        """The share of the action just executed after which standing still ends on target, as a joint target.

        Leaves the world after the whole action when there is none.
        """
        after = self.world.save()
        if self._missing() > 0.25 * abs(self.task.s_target - self.task.s_initial) + 5.0 * self.task.tolerance:
            self._rest = None
            return None
        low = self._held(before, target, target) if self._rest is None else self._rest
        high = self._rest = self._held(before, target, goal)
        landed: np.ndarray | None = None
        if min(abs(low), abs(high)) < 0.8 * self.task.tolerance:
            landed = goal if abs(high) < abs(low) else target
        elif low * high <= 0.0:
            landed = self._between(before, target, goal, low, high)
        self.world.restore(after)
        return landed

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
        report = self._play(target, goal).merged(self._hold(goal))
        return np.inf if report.contact is not None else self.task.s_target - self.world.s

    def _hold(self, goal: np.ndarray) -> Report:
        substeps = round(self.settings.hold_s / self.settings.fine_timestep_s)
        return self.world.play(np.broadcast_to(goal, (substeps, len(goal))))

    def _replay(self) -> str | None:
        """Play the whole plan again from the start and check what the delivery promises."""
        self.played, self.path, self.touch_step = Report(), [(self.world.q, self.world.s)], None
        hold_steps = round(self.settings.hold_s / self.settings.control_dt_s)
        self.targets += [self.targets[-1]] * hold_steps
        for step, (start, goal) in enumerate(zip(self.targets[:-1], self.targets[1:], strict=True)):
            report = self._play(start, goal)
            self.played = self.played.merged(report)
            self.path.append((self.world.q, self.world.s))
            if report.touched and self.touch_step is None:
                self.touch_step = step + 1
        if self.played.contact is not None or self.played.press_N > self.settings.press_max_N:
            return _harm(self.played)
        late = [abs(self.task.s_target - s) for _, s in self.path[-(hold_steps // 2) :]]
        # A lid on a soft friction creeps a little: it may pass the target during the hold, not leave it.
        if max(late) >= 2.0 * self.task.tolerance or late[-1] >= self.task.tolerance:
            return f"the target is not held: s = {self.world.s:.4f} at the end of the hold"
        return None

    def _note(self, step: int, predicted: float, rank: int, report: Report) -> None:
        data, body = self.world.data, self.scene.part_body
        tip = data.site_xpos[self.scene.tool_site] - data.xpos[body]
        distance_m = float(self.hook.distance(data.xmat[body].reshape(3, 3).T @ tip))
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

    def result(self, attempts: list[_Attempt]) -> PlanResult:
        """This attempt as the answer, with the costs of all of them."""
        path = self.path or [(self.targets[0], self.task.s_initial)]
        s = np.array([value for _, value in path])
        hold_steps = round(self.settings.hold_s / self.settings.control_dt_s)
        return PlanResult(
            success=self.reason is None,
            q_cmd=np.array(self.targets),
            q_meas=np.array([q for q, _ in path]),
            s=s,
            control_dt_s=self.settings.control_dt_s,
            s_initial=self.task.s_initial,
            s_target=self.task.s_target,
            final=float(s[-1]),
            error=self.task.s_target - float(s[-1]),
            reason=self.reason or "held on target",
            touch_step=self.touch_step,
            hold_step=max(len(self.targets) - 1 - hold_steps, 0),
            stage=self.index,
            control_steps=sum(a.steps_done for a in attempts),
            env_steps=sum(a.env_steps for a in attempts),
            cpu_s=0.0,
            wall_s=0.0,
            places_cpu_s=0.0,
            torque_share=self.played.torque_share,
            hook=self.hook,
            p_part=self.hook.p_part,
            route=self.hook.whole_route,
            route_touch=self.hook.touch_row,
            trace=tuple(entry for a in attempts for entry in a.trace),
        )


def _harm(report: Report) -> str:
    if report.contact is not None:
        return f"touches something unexpected: {report.contact}"
    return f"presses on the part with {report.press_N:.0f} N across its motion"
