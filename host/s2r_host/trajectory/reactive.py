"""Receding-horizon replanning: a better continuation of the motion that runs, from where arm and object are now.

A first plan runs (:func:`s2r_host.trajectory.plan_trajectory`). Several times a second the fine model is set to the
live state: the arm as the running trajectory has it, the object as it was last seen. It foretells where the running
motion will end. When that misses the target, the sampler looks ahead from the state at which a new motion could take
over, and its sequences become motions that begin there, with position, velocity and acceleration of the running one,
and end at rest. The first that the fine model finds harmless and better is handed out. So whatever happens to the
host, the arm comes to rest at the end of a motion that was checked as a whole.

The object stands some millimetres beside its model. So the fine model is not put where the object was seen, which
would press the fingertip into the part or take it off; it follows the running motion by itself, and what the live
joint value differs from it is taken for that offset, as long as it is small. A large one is an object that was moved.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from s2r_host.planning.execution import Report
from s2r_host.planning.hook import Hook
from s2r_host.planning.lookahead import Lookahead
from s2r_host.planning.planner import world_of
from s2r_host.planning.rewards import Task
from s2r_host.planning.sampler import icem_sampler
from s2r_host.planning.scene import Scene
from s2r_host.planning.task import PlanRequest
from s2r_host.trajectory.shift import shift_with_part
from s2r_host.trajectory.to_rest import to_rest
from s2r_host.trajectory.torque import InverseDynamics
from s2r_host.trajectory.trajectory import Trajectory, TrajectoryError

_STILL_M_S = 0.005  # a part slower than this, at the fingertip, is where it was seen


@dataclass(frozen=True)
class ReactiveSettings:
    """How the motion is corrected while it runs.

    Attributes:
        rate_hz: How often the future is looked at.
        lead_s: A new motion takes over this long after the state it was planned from.
        ahead_steps: Control steps of a sampled sequence that become a motion.
        tip_speed_m_s: Mean speed of the fingertip in a new motion; its peak is about twice that.
        tried: Sequences turned into motions before it is given up.
        landings: Halvings of a motion that would go too far.
        hold_s: How long the fine model watches the end of a motion.
        offset_m: Largest difference between live and foretold joint value, at the fingertip, that counts as an object
            beside its model; a larger one is an object that somebody moved.
        gain: A new motion has to end nearer to the target by so many success bands.
    """

    rate_hz: float = 6.0
    lead_s: float = 0.15
    ahead_steps: int = 6
    tip_speed_m_s: float = 0.06
    tried: int = 4
    landings: int = 6
    hold_s: float = 0.3
    offset_m: float = 0.008
    gain: float = 0.5


@dataclass(frozen=True, eq=False)
class Outlook:
    """What one look at the future found.

    Attributes:
        running_end: Where the object's joint ends with the motion that runs, the offset included.
        motion: A better continuation, or None: the running one stays.
        splice_t: Time of the running motion at which it takes over [s].
        new_end: Where the object's joint ends with it; as ``running_end`` without one.
        offset: The object's joint less the model's, taken for a displacement of the object and for what the servos of
            the model lack.
        at_splice: State of the fine model there.
        cpu_s, wall_s: What it took.
    """

    running_end: float
    motion: Trajectory | None
    splice_t: float
    new_end: float
    offset: float
    at_splice: np.ndarray
    cpu_s: float
    wall_s: float


class ReactivePlanner:
    """Looks ahead from live states and offers continuations. Knows no executor; see ``reactive_run``."""

    def __init__(
        self,
        request: PlanRequest,
        scene: Scene,
        hook: Hook,
        settings: ReactiveSettings | None = None,
        yields: float = 0.0,
    ) -> None:
        """Watch over one task.

        Args:
            request: The task.
            scene: Its scene.
            hook: The place at the part (``PlanResult.hook``).
            settings: How.
            yields: How much further than in the model the part is to go with an arm that gets to where it is sent
                [m or rad]; the first motion ends so much short of the target in the model.
        """
        self.settings = settings or ReactiveSettings()
        self._request, self._scene = request, scene
        plan = request.settings
        self.tolerance = plan.tolerance_m if scene.prismatic else plan.tolerance_rad
        self._task = Task(request.s_initial, request.s_target, self.tolerance, scene.prismatic)
        self._world = world_of(request, scene)
        self._ahead = Lookahead(
            scene, plan.cascade[0], plan, self._task, hook, hook.route[0], (request.seed, 99), icem_sampler,
            self._world.others,
        )  # fmt: skip
        self._initial = self._world.save()
        self._dynamics = InverseDynamics(request.arm, scene.gravity)
        self._lead = plan.servo.kd / plan.servo.kp
        self._shadow: tuple[Trajectory, float, np.ndarray] | None = None
        self._yields = self._offset = yields
        self._put = request.s_initial  # where the model's part was put; from there the fingertip pushes it
        lever = 1.0 if scene.prismatic else self._lever(hook)
        self._most_offset = self.settings.offset_m / lever
        self._still = _STILL_M_S / lever

    def look(
        self,
        running: Trajectory,
        t_now: float,
        s_live: float,
        lead_s: float | None = None,
        t_seen: float | None = None,
        half90: float = 0.0,
    ) -> Outlook:
        """Look at the future of the running motion at its time ``t_now`` [s] with the object seen at ``s_live``.

        Call :meth:`begin` before the first look, this regularly, and :meth:`accept` when a continuation was admitted.
        A motion that has ended is continued from its end.

        Args:
            running: The motion.
            t_now: Its time [s].
            s_live: The object's joint [m or rad].
            lead_s: Replaces the settings' one.
            t_seen: When the object was seen, in the motion's time [s]; None: now. What is older than what has been
                seen before is not looked at.
            half90: Half the 90 % interval of ``s_live``: less than that is no miss.
        """
        lead_s = self.settings.lead_s if lead_s is None else lead_s
        t_seen = t_now if t_seen is None else min(t_seen, t_now)
        cpu_s, wall_s = time.process_time(), time.perf_counter()
        world = self._world
        t = self._observe(running, t_seen, s_live)
        target = self._request.s_target - self._offset
        splice_t = max(min(t_now + lead_s, running.duration_s), t)
        report = self._follow(running, t, splice_t)
        at_splice = world.save()
        report = report.merged(self._follow(running, splice_t, running.duration_s + self.settings.hold_s))
        end, motion, new_end = world.s, None, world.s
        if abs(target - end) > max(0.5 * self.tolerance, half90) or report.contact is not None:
            world.restore(at_splice)
            motion, new_end = self._better(running, splice_t, at_splice, target, end, report)
        return Outlook(
            end + self._offset,
            motion,
            splice_t,
            new_end + self._offset,
            self._offset,
            at_splice,
            time.process_time() - cpu_s,
            time.perf_counter() - wall_s,
        )

    def begin(self, first: Trajectory) -> None:
        """The first motion starts now, with arm and object as the task has them."""
        self._shadow = (first, 0.0, self._initial)
        self._offset, self._put = self._yields, self._request.s_initial

    def accept(self, outlook: Outlook) -> None:
        """The continuation runs from its splice on."""
        assert outlook.motion is not None
        self._shadow = (outlook.motion, 0.0, outlook.at_splice)

    def _observe(self, running: Trajectory, t_seen: float, s_live: float) -> float:
        """Bring the fine model to when the object was seen, and learn how far it stands beside its model.

        Returns:
            The model's time in the running motion [s]: ``t_seen``, or later where something newer was seen before.
        """
        world = self._world
        if self._shadow is not None and self._shadow[0] is running:
            world.restore(self._shadow[2])
            if t_seen < self._shadow[1]:
                return self._shadow[1]
            self._follow(running, self._shadow[1], t_seen)
        else:
            self._set(running, t_seen, s_live - self._offset)
        offset = s_live - world.s
        if abs(offset) <= self._most_offset:
            # A live value is older than it looks, by an unknown time: of a part that moves it always seems to fall
            # short. What is believed at once would push too far, and that cannot be taken back.
            # And one that is not pushed yet does not show what the servos will lack.
            way = np.sign(self._request.s_target - self._request.s_initial)
            moving = abs(float(world.data.qvel[self._scene.s_dof])) > self._still
            pushed = abs(world.s - self._put) > 0.5 * self.tolerance
            if pushed and (not moving or way * offset > way * self._offset):
                self._offset = offset
        else:  # somebody moved the object
            self._set(running, t_seen, s_live - self._offset)
        self._shadow = (running, t_seen, world.save())
        return t_seen

    def _lever(self, hook: Hook) -> float:
        """Distance of the place from a hinge's axis [m]."""
        joint = self._scene.joint_id
        axis, anchor = self._scene.fine.jnt_axis[joint], self._scene.fine.jnt_pos[joint]
        return max(0.02, float(np.linalg.norm(np.cross(axis, hook.p_part - anchor))))

    def _set(self, running: Trajectory, t: float, s: float) -> None:
        world, dof = self._world, self._scene.dof
        q, dq, _ = running.sample(t)
        data, self._put = world.data, s
        data.qpos[:dof], data.qvel[:dof] = q, dq
        data.qpos[self._scene.s_qpos], data.qvel[self._scene.s_dof] = s, 0.0
        data.qacc_warmstart[:] = 0.0
        world.check_now()

    def _follow(self, motion: Trajectory, t_from: float, t_to: float) -> Report:
        """Play a motion in the fine model between two of its times; it rests after its end."""
        dt = self._request.settings.fine_timestep_s
        count = round((t_to - t_from) / dt)
        if count < 1:
            return Report()
        q, dq, _ = motion.sample(t_from + dt * np.arange(1, count + 1))
        return self._world.play(q + self._lead * dq)

    def _better(
        self,
        running: Trajectory,
        splice_t: float,
        at_splice: np.ndarray,
        target: float,
        end: float,
        report: Report,
    ) -> tuple[Trajectory | None, float]:
        """The first continuation that is harmless and ends nearer to the target, and where it ends.

        First the running motion's end, moved along with the part by what is missing; then what the sampler finds.
        """
        world, settings = self._world, self.settings
        start = running.sample(splice_t)
        given = self._task
        self._ahead.task = Task(given.s_initial, target, given.tolerance, given.prismatic)
        sequences, _ = self._ahead.ranked(world.data, start[0] + self._lead * start[1])
        self._ahead.sampler.advance()
        ahead = self._ahead.targets(start[0], sequences[: settings.tried])[:, settings.ahead_steps]
        limits, margin = self._request.arm.limits, self._request.settings.joint_margin_rad
        beyond = running.q[-1] + (target - end) * shift_with_part(
            running.q[-1], end, self._scene, world.others
        )
        if np.all((beyond > limits.q_min + margin) & (beyond < limits.q_max - margin)):
            ahead = np.concatenate([beyond[None], ahead])
        # Going on is out of the question when it touches something: then anything harmless is better.
        worst = np.inf if report.contact is not None else abs(target - end)
        for goal in ahead:
            motion, new_end = self._landed(start, goal, at_splice, target)
            if motion is not None and abs(target - new_end) < worst - settings.gain * self.tolerance:
                return motion, new_end
        return None, end

    def _landed(
        self,
        start: tuple[np.ndarray, np.ndarray, np.ndarray],
        goal: np.ndarray,
        at_splice: np.ndarray,
        target: float,
    ) -> tuple[Trajectory | None, float]:
        """The motion to ``goal``, or to a share of the way when all of it goes too far; None if it does harm."""
        self._world.restore(at_splice)
        way = np.sign(target - self._world.s)
        low, high, share = 0.0, 1.0, 1.0
        best: tuple[Trajectory | None, float] = (None, self._world.s)
        for _ in range(self.settings.landings + 1):
            motion = self._motion(start, start[0] + share * (goal - start[0]))
            if motion is None:
                break
            self._world.restore(at_splice)
            report = self._follow(motion, 0.0, motion.duration_s + self.settings.hold_s)
            end, harmful = self._world.s, self._harmful(report)
            if not harmful and (best[0] is None or abs(target - end) < abs(target - best[1])):
                best = motion, end
            missing = way * (target - end)
            if harmful or missing < -0.3 * self.tolerance:
                high = share
            elif missing > 0.3 * self.tolerance and share < 1.0:
                low = share
            else:
                break
            share = (low + high) / 2.0
        return best

    def _harmful(self, report: Report) -> bool:
        plan = self._request.settings
        return (
            report.contact is not None
            or report.press_N > plan.press_max_N
            or report.torque_share > plan.torque_margin
        )

    def _motion(
        self, start: tuple[np.ndarray, np.ndarray, np.ndarray], goal: np.ndarray
    ) -> Trajectory | None:
        tips = self._dynamics.tool_positions(np.stack([start[0], goal]))
        duration_s = float(np.linalg.norm(tips[1] - tips[0])) / self.settings.tip_speed_m_s
        try:
            return to_rest(start, goal, self._request.arm, max(duration_s, 0.2), self._dynamics)
        except TrajectoryError:
            return None
