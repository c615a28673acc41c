"""Where to push: the push network's verdict on one depth view, without torch.

Points with the highest actionability, kept apart from each other, get several proposed directions each; the
critic orders them. Ten points times ten directions as in Where2Act (Mo et al., ICCV 2021).
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
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.object_cloud import ObjectCloud, object_cloud, pyramid

Array = NDArray[np.floating]

WEIGHTS = Path(__file__).parent / "weights" / "affordance"
PLACES, DIRECTIONS = 10, 10
APART_M = 0.015
NOISE = 3


@dataclass(frozen=True, eq=False)
class PushProposal:
    """One push.

    Attributes:
        point: Where the fingertip should touch, base frame [m], shape (3,).
        normal: Surface normal there, shape (3,).
        direction: Unit direction of the push, which is also the finger's axis, shape (3,).
        likelihood: Of a useful motion (3 cm or 15 degrees), 0 to 1.
    """

    point: Array
    normal: Array
    direction: Array
    likelihood: float


@dataclass(frozen=True, eq=False)
class Affordance:
    """What the network says about one view.

    Attributes:
        cloud: The object's points.
        actionability: Per point, 0 to 1, shape (points,).
        proposals: Best first.
    """

    cloud: ObjectCloud
    actionability: Array
    proposals: tuple[PushProposal, ...]


class PushNetworkRuntime:
    """The exported network on ONNX Runtime, one thread. Make one and keep it."""

    def __init__(self, folder: Path = WEIGHTS) -> None:
        """Load the graphs.

        Raises:
            InputError: A file is missing.
        """
        self.folder = folder
        for name in ("encoder.onnx", "heads.onnx", "about.json"):
            if not (folder / name).exists():
                raise InputError(
                    f"no push network in {folder} ({name} is missing); train one: s2r train affordance --out {folder}"
                )
        self._encoder = _session(folder / "encoder.onnx")
        self._heads = _session(folder / "heads.onnx")

    @cached_property
    def about(self) -> dict[str, Any]:
        """Where the weights come from: data hash, size of the data, settings, validation."""
        return json.loads((self.folder / "about.json").read_text())

    def affordance(
        self, frame: DepthFrame, rng: np.random.Generator, places: int = PLACES, directions: int = DIRECTIONS
    ) -> Affordance:
        """Judge one view.

        Args:
            frame: The view; its pose must be that of the camera over the table, z up.
            rng: For the choice of points and the proposals.
            places, directions: How many points, and directions at each.

        Raises:
            BadViewError: There is no object in the view.
        """
        cloud = object_cloud(frame, rng)
        return self.judge(cloud, rng, places, directions)

    def judge(
        self, cloud: ObjectCloud, rng: np.random.Generator, places: int = PLACES, directions: int = DIRECTIONS
    ) -> Affordance:
        """Judge a prepared cloud; see `affordance`."""
        near = pyramid(cloud.points)
        inputs = (cloud.features(), *near.down, *near.up[::-1], *near.weight[::-1])
        names = [node.name for node in self._encoder.get_inputs()]
        feeds = {name: value[None] for name, value in zip(names, inputs, strict=True)}
        feature, logit = self._encoder.run(None, feeds)
        action = _sigmoid(logit[0])
        chosen = np.repeat(_apart(cloud.points, action, places), directions)
        noise = rng.standard_normal((len(chosen), NOISE)).astype(np.float32)
        names = [node.name for node in self._heads.get_inputs()]
        direction, verdict = self._heads.run(None, dict(zip(names, (feature[0][chosen], noise), strict=True)))
        likelihood = _sigmoid(verdict)
        order = np.argsort(-likelihood, kind="stable")
        found = tuple(
            PushProposal(
                cloud.points[chosen[i]],
                cloud.normals[chosen[i]],
                np.asarray(direction[i], float),
                float(likelihood[i]),
            )
            for i in order
        )
        return Affordance(cloud, action, found)


def _apart(points: Array, score: Array, most: int) -> NDArray[np.int64]:
    """Best points first, none within `APART_M` of a better one."""
    chosen: list[int] = []
    for i in np.argsort(-score, kind="stable"):
        if all(np.linalg.norm(points[i] - points[j]) > APART_M for j in chosen):
            chosen.append(int(i))
            if len(chosen) == most:
                break
    return np.array(chosen, dtype=np.int64)


def _session(path: Path) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def _sigmoid(x: Array) -> Array:
    return 1.0 / (1.0 + np.exp(-x))
