"""The trained pair network at work: votes of the points of two views, on ONNX Runtime.

The pair is looked at several times, with other points and turned a little about the vertical; all votes make one poll
(`pair_votes`), by which the candidates of `estimate.estimate_joint` are weighed (`pair_belief`).
"""

from __future__ import annotations

import json
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.errors import InputError
from s2r_host.perception.evidence import Scene
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.network_belief import Trust
from s2r_host.perception.object_cloud import pyramid
from s2r_host.perception.pair_belief import PairBelief
from s2r_host.perception.pair_cloud import COARSE, NEIGHBOURS, PairCloud, PairPool, facing, pool, sample
from s2r_host.perception.pair_space import beside
from s2r_host.perception.pair_votes import PART, Votes

Array = NDArray[np.floating]

WEIGHTS = Path(__file__).parent / "weights" / "pair"
GRAPH, SPACE, ABOUT = "pair.onnx", "space.onnx", "about.json"
PASSES = 4
TURNED_RAD = np.radians(15)  # about the frame that faces the camera, at random


class PairNetworkRuntime:
    """The exported network on ONNX Runtime, one thread. Make one and keep it."""

    def __init__(self, folder: Path = WEIGHTS) -> None:
        """Load the graph.

        Raises:
            InputError: A file is missing.
        """
        for name in (GRAPH, SPACE, ABOUT):
            if not (folder / name).exists():
                raise InputError(
                    f"no pair network in {folder} ({name} is missing); train one: s2r train model --out {folder}"
                )
        import onnxruntime

        self.folder = folder
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self._session: Any
        self._space_session: Any
        self._session, self._space_session = (
            onnxruntime.InferenceSession(str(folder / name), options, providers=["CPUExecutionProvider"])
            for name in (GRAPH, SPACE)
        )

    @cached_property
    def about(self) -> dict[str, Any]:
        """Where the weights come from: data hash, size of the data, settings, validation."""
        return json.loads((self.folder / ABOUT).read_text())

    def belief(self, scene: Scene, rng: np.random.Generator) -> PairBelief | None:
        """What the network makes of two views.

        None if one of them shows nothing there, or hardly a point is believed to have moved with a part.

        Args:
            scene: Both views with their changes, z up; a view without a camera is none that the network knows.
            rng: For the choice of points and the turns.

        Raises:
            NothingMovedError: Hardly anything changed between the views.
        """
        if scene.before.p_camera is None or scene.after.p_camera is None:
            return None
        pools = pool(scene, rng)
        if pools.one_sided():
            return None
        votes = Votes.joined([self._pass(sample(pools, rng), rng) for _ in range(PASSES)])
        opinion = votes.opinion()
        return None if opinion is None else PairBelief(opinion, votes, self.trust)

    def space(
        self, pools: PairPool, motion: JointMotion, query: Array, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """Probability that the part is at points of space [m] (Q, 3) in its pose of the first view, (Q,).

        Args:
            pools: Both views.
            motion: Of the part from the first view to the second.
            query: The points.
            rng: For the choice of points and the turns.
        """
        logit = np.zeros(len(query))
        for _ in range(PASSES):
            cloud = sample(pools, rng)
            R = facing(cloud.heading + rng.uniform(-TURNED_RAD, TURNED_RAD))
            votes, feature = self._session.run(None, dict(zip(self._names, _inputs(cloud, R), strict=True)))
            part = 1.0 / (1.0 + np.exp(-votes[0, ..., PART].astype(float)))
            near = beside(query, cloud, part, motion).turned(R)
            feature = feature[0].reshape(-1, feature.shape[-1])
            rows = np.concatenate([feature[near.index], near.geometry], axis=2)
            (found,) = self._space_session.run(None, {"beside": rows.astype(np.float32)})
            logit += found / PASSES
        return (1.0 / (1.0 + np.exp(-logit))).astype(np.float32)

    @cached_property
    def trust(self) -> Trust:
        """What the votes are worth beside geometry, as fitted; cautious where nothing was."""
        return Trust(**self.about.get("trust", {}))

    def _pass(self, cloud: PairCloud, rng: np.random.Generator) -> Votes:
        R = facing(cloud.heading + rng.uniform(-TURNED_RAD, TURNED_RAD))
        found, _ = self._session.run(None, dict(zip(self._names, _inputs(cloud, R), strict=True)))
        return Votes.of(cloud, found[0], R)

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
