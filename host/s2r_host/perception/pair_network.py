"""The trained pair network at work: votes of the points of two views, on ONNX Runtime.

The pair is looked at several times, with other points and turned a little about the vertical; all votes make one poll
(`pair_votes`). The poll's motion of either family, and those of the single passes, can join the hypotheses of
`estimate.estimate_joint` as ``extra_axes``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.errors import InputError
from s2r_host.perception.estimate import Region, prepare
from s2r_host.perception.evidence import Scene
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.hypotheses import Axis
from s2r_host.perception.object_cloud import pyramid
from s2r_host.perception.pair_cloud import COARSE, NEIGHBOURS, PairCloud, PairPool, facing, pool, sample
from s2r_host.perception.pair_votes import Opinion, Votes, turned_back

Array = NDArray[np.floating]

WEIGHTS = Path(__file__).parent / "weights" / "pair"
GRAPH, ABOUT = "pair.onnx", "about.json"
PASSES = 4
TURNED_RAD = np.radians(15)  # about the frame that faces the camera, at random
LEAST_BELIEF = 0.02  # in a family, below which its axes are not worth a look


@dataclass(frozen=True, eq=False)
class PairOpinion:
    """What the network makes of a pair: the poll over all passes, and the passes one by one."""

    poll: Opinion
    passes: tuple[Opinion, ...]

    def axes(self) -> list[Axis]:
        """Candidate axes of every family that is believed in at all, the poll's first."""
        found = []
        for opinion, source in [(self.poll, "network"), *((one, "network, one pass") for one in self.passes)]:
            if opinion.slides < 1 - LEAST_BELIEF:
                found.append(Axis("revolute", opinion.turn.origin, opinion.turn.direction, source))
            if opinion.slides > LEAST_BELIEF:
                found.append(Axis("prismatic", opinion.slide.origin, opinion.slide.direction, source))
        return found


class PairNetworkRuntime:
    """The exported network on ONNX Runtime, one thread. Make one and keep it."""

    def __init__(self, folder: Path = WEIGHTS) -> None:
        """Load the graph.

        Raises:
            InputError: A file is missing.
        """
        for name in (GRAPH, ABOUT):
            if not (folder / name).exists():
                raise InputError(
                    f"no pair network in {folder} ({name} is missing); train one: s2r train model --out {folder}"
                )
        import onnxruntime

        self.folder = folder
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self._session: Any = onnxruntime.InferenceSession(
            str(folder / GRAPH), options, providers=["CPUExecutionProvider"]
        )

    @cached_property
    def about(self) -> dict[str, Any]:
        """Where the weights come from: data hash, size of the data, settings, validation."""
        return json.loads((self.folder / ABOUT).read_text())

    def look(self, scene: Scene, rng: np.random.Generator) -> PairOpinion | None:
        """Judge two views whose changes are labelled; None if hardly a point is believed to have moved with a part.

        Args:
            scene: Both views, z up.
            rng: For the choice of points and the turns.

        Raises:
            NothingMovedError: Hardly anything changed between the views.
        """
        return self.judge(pool(scene, rng), rng)

    def judge(self, pools: PairPool, rng: np.random.Generator) -> PairOpinion | None:
        """Judge prepared points; see `look`."""
        votes = [self._pass(sample(pools, rng), rng) for _ in range(PASSES)]
        poll = Votes.joined(votes).opinion()
        if poll is None:
            return None
        alone = (one.opinion() for one in votes)
        return PairOpinion(poll, tuple(one for one in alone if one is not None))

    def axes_between(
        self,
        before: DepthFrame,
        after: DepthFrame,
        rng: np.random.Generator,
        region: Region | None = None,
    ) -> list[Axis]:
        """Candidate axes for `estimate.estimate_joint`; none where the network has no opinion.

        Args:
            before, after: The views, z up.
            rng: As for `look`.
            region: Box in which to look for motion.

        Raises:
            NothingMovedError: Hardly anything changed between the views.
            BadViewError: The views are no usable pair.
        """
        scene, _ = prepare(before, after, region, None, None, rng)
        opinion = self.look(scene, rng)
        return [] if opinion is None else opinion.axes()

    def _pass(self, cloud: PairCloud, rng: np.random.Generator) -> Votes:
        R = facing(cloud.heading + rng.uniform(-TURNED_RAD, TURNED_RAD))
        (found,) = self._session.run(None, dict(zip(self._names, _inputs(cloud, R), strict=True)))
        return Votes(cloud.points.reshape(-1, 3), turned_back(found[0].reshape(-1, found.shape[-1]), R))

    @cached_property
    def _names(self) -> list[str]:
        return [node.name for node in self._session.get_inputs()]


def _inputs(cloud: PairCloud, R: Array) -> list[NDArray[np.generic]]:
    """The network's inputs for a cloud turned by R (3, 3), (1, 2, ...) each."""
    x = cloud.features()
    x = np.concatenate([x[..., :3] @ R.T, x[..., 3:6] @ R.T, x[..., 6:]], axis=2).astype(np.float32)
    return [value[None] for value in (x, *neighbourhoods(cloud))]


def neighbourhoods(cloud: PairCloud) -> list[NDArray[np.generic]]:
    """Pyramids of both views in the order of the network's inputs: down 1, 2, up 1, 0, their weights; (2, ...) each."""
    near = [pyramid(p, COARSE, NEIGHBOURS) for p in cloud.points]
    order = (("down", 0), ("down", 1), ("up", 1), ("up", 0), ("weight", 1), ("weight", 0))
    return [np.stack([getattr(one, name)[level] for one in near]) for name, level in order]
