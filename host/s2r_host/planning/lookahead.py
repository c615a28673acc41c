"""One control step of sampling: action sequences from a state of the world, rolled out, judged, ranked."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.planning.belief import draw_ensemble
from s2r_host.planning.hook import Hook
from s2r_host.planning.proposals import Route
from s2r_host.planning.rewards import Task
from s2r_host.planning.rollouts import Rollouts
from s2r_host.planning.sampler import SamplerFactory
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings, Stage


class Lookahead:
    """A sampler with its rollouts, reward, proposals and joint range, for one place of the fingertip."""

    def __init__(
        self,
        scene: Scene,
        stage: Stage,
        settings: PlanSettings,
        task: Task,
        hook: Hook,
        q_start: np.ndarray,
        chance: tuple[int, ...],
        make_sampler: SamplerFactory,
        others: np.ndarray | None = None,
    ) -> None:
        """Args: the models and settings; place; where the route to it begins, (dof,) [rad]; seed; sampler.

        ``others`` as in PlanRequest.
        """
        limits = scene.arm.limits
        self.sampler = make_sampler(settings, stage, scene.dof, np.random.default_rng([*chance]))
        self._low = np.tile(limits.q_min + settings.joint_margin_rad, (self.sampler.horizon, 1))
        self._high = np.tile(limits.q_max - settings.joint_margin_rad, (self.sampler.horizon, 1))
        self.task = task  # may be replaced between control steps
        self._settings = settings
        self._route = Route(np.concatenate([q_start[None], hook.whole_route]), settings.action_max_rad)
        beliefs = ()
        if settings.ensemble > 1:  # drawn apart from the sampler's noise
            beliefs = draw_ensemble(settings.doubt, settings.ensemble, np.random.default_rng([*chance, 1]))
        capacity = self.sampler.capacity(len(settings.proposal_speeds))
        self._rollouts = Rollouts(scene, stage, settings, hook, capacity, beliefs, others)

    @property
    def env_steps(self) -> int:
        """Control steps simulated so far."""
        return self._rollouts.env_steps

    def ranked(self, data: mujoco.MjData, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Action sequences from a state, best first, (n, horizon, dof), and their rewards, (n,).

        Args:
            data: State of arm and object.
            target: The joint target in force, (dof,) [rad].
        """
        sampler, rollouts = self.sampler, self._rollouts
        sampler.begin()
        qpos, qvel = data.qpos, data.qvel
        proposals = self._route.proposals(target, sampler.horizon, self._settings.proposal_speeds)
        for _ in range(sampler.iterations):
            samples = sampler.sample(proposals)
            targets = self.targets(target, samples)
            values = rollouts.values(qpos, qvel, targets, self.task)
            sampler.update(samples, values)
        return sampler.ranked()

    def targets(self, target: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Joint targets that follow from actions, (n, steps + 1, dof): previous target + action, within the range.

        Not measured position plus action: servo lag would then add up, and the plan would not be a list of targets.
        """
        count, steps, dof = actions.shape
        found = np.empty((count, steps + 1, dof))
        found[:, 0], found[:, 1:] = target, actions
        np.add.accumulate(found, axis=1, out=found)
        following = found[:, 1:]
        np.maximum(following, self._low[:steps], out=following)
        np.minimum(following, self._high[:steps], out=following)
        return found
