"""Where to push: the push network's verdict on one depth view, without torch.

Points with the highest actionability, kept apart from each other, get directions from the proposal head, along the
line the point is believed to move on, and straight in; the critic orders them, and ten points with ten directions
each are kept, as in Where2Act (Mo et al., ICCV 2021). The view is judged several times, turned about the vertical
and with other points standing for the whole; the verdicts are averaged, because the best of many guesses is else
often the luckiest mistake.
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
Index = NDArray[np.int64]

WEIGHTS = Path(__file__).parent / "weights" / "affordance"
GRAPHS = ("encoder", "proposal", "critic")
PLACES, DIRECTIONS = 10, 10
CANDIDATES = 48  # points whose directions are judged before ten are kept
PROPOSED = 12  # directions per candidate from the proposal head
PASSES = 4
APART_M, APART_COS = 0.012, float(np.cos(np.radians(10)))
NOISE = 3
ACROSS = 0.23  # worth of a push square to the believed line of motion, against one along it
LINE = (
    6  # the feature ends with the outer product of the line of motion and the logit of "belongs to the part"
)


@dataclass(frozen=True, eq=False)
class PushProposal:
    """One push.

    Attributes:
        point: Where the fingertip should touch, base frame [m], shape (3,).
        normal: Surface normal there, shape (3,).
        direction: Unit direction of the push, which is also the finger's axis, shape (3,).
        likelihood: The critic's of a useful motion (3 cm or 15 degrees), 0 to 1.
        worth: What pushes are ordered by: the likelihood, times the belief that the point belongs to the part, more
            for pushes along the believed line of motion. The two beliefs were taught by every point of the views, the
            critic by few of them; on validation objects the order by all three was right most often.
    """

    point: Array
    normal: Array
    direction: Array
    likelihood: float
    worth: float


@dataclass(frozen=True, eq=False)
class Affordance:
    """What the network says about one view.

    Attributes:
        cloud: The object's points.
        actionability: Per point, 0 to 1, shape (points,).
        part: Belief that a point belongs to the part that moves, 0 to 1, shape (points,).
        line: Unit direction along which a point would move if it did, without sense, shape (points, 3).
        proposals: Best first.
    """

    cloud: ObjectCloud
    actionability: Array
    part: Array
    line: Array
    proposals: tuple[PushProposal, ...]


class PushNetworkRuntime:
    """The exported network on ONNX Runtime, one thread. Make one and keep it."""

    def __init__(self, folder: Path = WEIGHTS) -> None:
        """Load the graphs.

        Raises:
            InputError: A file is missing.
        """
        self.folder = folder
        for name in (*(f"{graph}.onnx" for graph in GRAPHS), "about.json"):
            if not (folder / name).exists():
                raise InputError(
                    f"no push network in {folder} ({name} is missing); train one: s2r train affordance --out {folder}"
                )
        self._encoder, self._proposal, self._critic = (_session(folder / f"{graph}.onnx") for graph in GRAPHS)
        calibration = self.about["calibration"]
        self._slope, self._offset = float(calibration["slope"]), float(calibration["offset"])

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
        passes = [self._look(cloud, rng) for _ in range(PASSES)]
        action = np.mean([p.action for p in passes], axis=0)
        part = np.mean([_sigmoid(p.feature[:, -1]) for p in passes], axis=0)
        line = _line(passes)
        at, direction = self._candidates(cloud, passes, _apart(cloud.points, action, CANDIDATES), line, rng)
        likelihood = np.mean([self._verdict(p, at, direction) for p in passes], axis=0)
        along = np.einsum("ni,ni->n", line[at], direction) ** 2
        worth = likelihood * part[at] * (ACROSS + (1 - ACROSS) * along)
        found = tuple(
            PushProposal(
                cloud.points[at[i]], cloud.normals[at[i]], direction[i], float(likelihood[i]), float(worth[i])
            )
            for i in _best(at, direction, worth, places, directions)
        )
        return Affordance(cloud, action, part, line, found)

    def _look(self, cloud: ObjectCloud, rng: np.random.Generator) -> _Look:
        """Encode the cloud once, turned about the vertical and reordered at random."""
        order = rng.permutation(len(cloud.points))
        angle = rng.uniform(0, 2 * np.pi)
        c, s = np.cos(angle), np.sin(angle)
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        mixed = cloud.reordered(order)
        x = mixed.features()
        x = np.hstack([x[:, :3] @ R.T, x[:, 3:6] @ R.T, x[:, 6:]]).astype(np.float32)
        near = pyramid(mixed.points)
        feature, logit = _run(self._encoder, x, *near.down, *near.up[::-1], *near.weight[::-1], one=True)
        back = np.argsort(order)
        return _Look(R, feature[0][back], _sigmoid(logit[0][back]))

    def _candidates(
        self,
        cloud: ObjectCloud,
        passes: list[_Look],
        points: Index,
        lines: Array,
        rng: np.random.Generator,
    ) -> tuple[Index, Array]:
        """Pushes worth judging: point indices (n,) and unit directions (n, 3)."""
        at = np.repeat(points, PROPOSED)
        proposed = []
        for k, some in enumerate(np.array_split(np.arange(len(at)), len(passes))):
            noise = rng.standard_normal((len(some), NOISE)).astype(np.float32)
            (direction,) = _run(self._proposal, passes[k].feature[at[some]], noise)
            proposed.append(direction @ passes[k].R)
        inward = -cloud.normals[points]
        line = lines[points]
        line = line * np.where(np.einsum("ni,ni->n", line, inward) < 0, -1.0, 1.0)[:, None]
        both = line + inward
        both /= np.maximum(np.linalg.norm(both, axis=1, keepdims=True), 1e-9)
        return (
            np.concatenate([at, points, points, points, points]),
            np.concatenate([*proposed, inward, line, -line, both]).astype(float),
        )

    def _verdict(self, look: _Look, at: Index, direction: Array) -> Array:
        turned = (direction @ look.R.T).astype(np.float32)
        (logit,) = _run(self._critic, look.feature[at], turned)
        return _sigmoid(self._slope * logit + self._offset)


@dataclass(frozen=True, eq=False)
class _Look:
    """One encoding: the turn (3, 3), features and actionability in the order of the cloud."""

    R: Array
    feature: Array
    action: Array


def _line(passes: list[_Look]) -> Array:
    """Unit directions along which points are believed to move, from the mean of the outer products, (points, 3)."""
    total = np.zeros((len(passes[0].feature), 3, 3))
    for look in passes:
        xx, yy, zz, xy, xz, yz = look.feature[:, -1 - LINE : -1].T.astype(float)
        M = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
        total += look.R.T @ M @ look.R
    return np.linalg.eigh(total)[1][:, :, -1]


def _best(at: Index, direction: Array, worth: Array, places: int, directions: int) -> list[int]:
    """The best directions of the points with the best push, directions of one point kept apart."""
    kept: dict[int, list[int]] = {}
    for i in np.argsort(-worth, kind="stable"):
        mine = kept.get(int(at[i]))
        if mine is None:
            if len(kept) == places:
                continue
            mine = kept.setdefault(int(at[i]), [])
        if len(mine) < directions and all(direction[i] @ direction[j] < APART_COS for j in mine):
            mine.append(int(i))
    return sorted((i for mine in kept.values() for i in mine), key=lambda i: -worth[i])


def _run(session: Any, *inputs: Array | Index, one: bool = False) -> list[Any]:
    """Outputs of a graph for its inputs in their order; ``one`` adds a batch axis."""
    names = [node.name for node in session.get_inputs()]
    feeds = {name: value[None] if one else value for name, value in zip(names, inputs, strict=True)}
    return session.run(None, feeds)


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
