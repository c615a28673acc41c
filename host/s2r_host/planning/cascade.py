"""The attempts at one request: stage by stage, place by place, until the target is held or nothing is left to try."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

from s2r_host.planning.along_route import AlongRoute
from s2r_host.planning.attempt import Attempt
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.hook import Hook
from s2r_host.planning.patience import Patience
from s2r_host.planning.rewards import Task
from s2r_host.planning.sampler import SamplerFactory
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import Stage
from s2r_host.planning.task import PlanRequest

logger = logging.getLogger(__name__)


@dataclass
class Cascade:
    """What all attempts at a request share, and those that were made.

    Attributes:
        request: The task as asked.
        scene: Its models.
        task: The motion of the part.
        world: The fine model where the request begins; every attempt leaves it there.
        hooks: Places for the fingertip, the best first; the arm may not get to some of them, which are dropped.
        patience: The limit on the time.
        sampler: What draws the action sequences.
        attempts: Made so far, in order; the last one is the answer.
    """

    request: PlanRequest
    scene: Scene
    task: Task
    world: FineWorld
    hooks: list[Hook]
    patience: Patience
    sampler: SamplerFactory
    attempts: list[Attempt] = field(default_factory=list)

    def run(self) -> None:
        """Try the stages until one holds the target, or the arm does not get to any place."""
        for index, stage in enumerate(self.request.settings.cascade):
            self.try_stage(index, stage)
            if self.attempts[-1].reason is None or not self.attempts[-1].arrived:
                return

    def try_stage(self, index: int, stage: Stage) -> None:
        """Make one attempt and, if wanted where that got stuck, one along the route it was offered.

        A place that the arm does not get to is dropped and the next one taken.
        """
        settings = self.request.settings
        along_too = settings.along_route and settings.lead_in and not self.request.leave
        while True:
            hook = self.hooks[index % len(self.hooks)]
            attempt = self._made(Attempt, index, stage, hook)
            self.attempts.append(attempt)
            if attempt.reason is not None:
                logger.info("stage %d of the plan failed: %s", index, attempt.reason)
            if along_too and attempt.stuck:
                along = self._made(AlongRoute, index, stage, hook)
                if along.reason is None:
                    self.attempts.append(along)
                else:
                    logger.info("nor along the route: %s", along.reason)
            if attempt.arrived or len(self.hooks) == 1:
                return
            self.hooks.remove(hook)

    def _made(self, kind: type[Attempt], index: int, stage: Stage, hook: Hook) -> Attempt:
        attempt = kind(
            scene=self.scene,
            stage=stage,
            index=index,
            settings=self.request.settings,
            task=self.task,
            hook=hook,
            world=self.world,
            seed=self.request.seed,
            patience=self.patience,
            make_sampler=self.sampler,
        )
        attempt.run()
        return attempt
