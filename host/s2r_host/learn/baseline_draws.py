"""What the baseline sees of a pair: points of both views at random, in a cube about them, and places asked about.

The points are those that the pair network draws from, within 15 cm of what changed, but none is preferred and no label
goes along. The cube is that of the points, a tenth larger, in the frame that faces the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from s2r_host.learn.baseline_network import (
    JOINT,
    SLIDE_DIRECTION,
    SLIDE_DISTANCE,
    TURN_ANGLE,
    TURN_DIRECTION,
    WAY_DIRECTION,
    WAY_LENGTH,
    Size,
)
from s2r_host.learn.pair_draws import exchanged
from s2r_host.learn.pair_files import UNIT_M, PairSample
from s2r_host.learn.pair_loss import INPUTS, random_pose_of_pair, varied
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.object_cloud import pyramid
from s2r_host.perception.pair_cloud import PairCloud, PairPool

Array = NDArray[np.floating]

QUERIES = 128  # points of space per draw
PADDING = 1.1


@dataclass(frozen=True, eq=False)
class BaselineDrawn:
    """One draw of one pair.

    Attributes:
        cloud: The points, P of each view.
        part: Which of those of the first view are the part's, shape (P,).
        motions: Of the part, and the turn the other way that equal spokes make as good.
        pyramid: Neighbourhoods of both views, in the order of the network's inputs.
        query: Points of space [m], the part as in the first view, shape (Q, 3).
        filled: Whether the part is there, shape (Q,).
    """

    cloud: PairCloud
    part: NDArray[np.bool_]
    motions: tuple[JointMotion, ...]
    pyramid: list[NDArray[np.generic]]
    query: Array
    filled: NDArray[np.bool_]


def plain_cloud(pools: PairPool, count: int, rng: np.random.Generator) -> PairCloud:
    """``count`` points of each view, all with the same chance; twice where there are fewer."""
    views = (pools.before, pools.after)
    chosen = []
    for view in views:
        order = rng.permutation(len(view.points))[:count]
        chosen.append(np.concatenate([order, rng.choice(order, count - len(order))]))
    return PairCloud(
        np.stack([view.points[at] for view, at in zip(views, chosen, strict=True)]).astype(np.float32),
        np.stack([view.normals[at] for view, at in zip(views, chosen, strict=True)]).astype(np.float32),
        np.zeros((2, count, 0), np.float32),
        np.zeros((2, count), np.float32),
        np.stack(chosen),
        pools.centre,
        pools.heading,
    )


def draw_plain(one: PairSample, size: Size, rng: np.random.Generator, back: bool = False) -> BaselineDrawn:
    """Draw points and queries; ``back``: with the views exchanged."""
    cloud = plain_cloud(one.pools(), size.points, rng)
    part = one.part()[1 if back else 0][cloud.chosen[1 if back else 0]]
    motions = tuple(m for m in (one.motion, one.other) if m is not None)
    query, filled = one.centre + np.ones((QUERIES, 3)), np.zeros(QUERIES, dtype=bool)
    if len(one.query):
        at = rng.choice(len(one.query), QUERIES, replace=len(one.query) < QUERIES)
        query, filled = one.centre + UNIT_M * one.query[at].astype(float), one.filled[at]
    if back:
        X = one.motion.transform()
        query = query @ X[:3, :3].T + X[:3, 3]
        cloud = exchanged(cloud)
        motions = tuple(replace(m, direction=-m.direction) for m in motions)
    return BaselineDrawn(cloud, part, motions, neighbours_of(cloud, size), query, filled)


def neighbours_of(cloud: PairCloud, size: Size) -> list[NDArray[np.generic]]:
    """Pyramids of both views in the order of the network's inputs, (2, ...) each; indices are small."""
    near = [pyramid(p, size.coarse, size.neighbours) for p in cloud.points]
    order = (("down", 0), ("down", 1), ("up", 1), ("up", 0), ("weight", 1), ("weight", 0))
    both = [np.stack([getattr(one, name)[level] for one in near]) for name, level in order]
    return [v.astype(np.int16) if v.dtype == np.int64 else v for v in both]


def in_cube(p: Array, cloud: PairCloud) -> tuple[NDArray[np.float32], float]:
    """Places p (..., 3) [m] in the cloud's cube, and half its side [m]."""
    half_m = PADDING * float(np.abs(cloud.points - cloud.centre).max())
    return ((p - cloud.centre) / half_m).astype(np.float32), half_m


def baseline_batch(drawn: Sequence[BaselineDrawn], rng: np.random.Generator, vary: bool) -> dict[str, Tensor]:
    """Stack draws, in the network's frame and cube; optionally turned, mirrored, resized as for the pair network.

    Returns:
        The network's inputs; ``part`` (B, P); ``truth`` (B, 2, P, JOINT), first axis after the batch: the motion and
        the turn the other way that equal spokes make as good (else the motion again); ``slides`` (B,); ``query``
        (B, Q, 3); ``filled`` (B, Q).
    """
    rows = []
    for one in drawn:
        turn, mirror, size = random_pose_of_pair(rng) if vary else (0.0, False, 1.0)
        cloud, motions, R = varied(one.cloud, one.motions, turn, mirror, size)
        x, half_m = in_cube(cloud.points, cloud)
        query, _ = in_cube(cloud.centre + size * (one.query - cloud.centre) @ R.T, cloud)
        row = dict(zip(INPUTS, (x, *one.pyramid), strict=True))
        row |= {"part": one.part.astype(np.float32), "query": query, "filled": one.filled.astype(np.float32)}
        both = (motions[0], motions[-1])
        row["truth"] = np.stack([true_joint(cloud.points[0], motion, half_m) for motion in both])
        row["slides"] = np.float32(motions[0].joint_type == "prismatic")
        rows.append(row)
    stacked = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    return {
        name: torch.from_numpy(v.astype(np.int64) if v.dtype == np.int16 else v)
        for name, v in stacked.items()
    }


def true_joint(p: Array, motion: JointMotion, half_m: float) -> NDArray[np.float32]:
    """What should be told of points p (n, 3) [m] of the part, (n, `JOINT`); columns of the other family are 0."""
    told = np.zeros((len(p), JOINT), np.float32)
    if motion.joint_type == "prismatic":
        told[:, SLIDE_DIRECTION], told[:, SLIDE_DISTANCE] = motion.direction, motion.delta / half_m
        return told
    way = motion.origin - p
    way = way - (way @ motion.direction)[:, None] * motion.direction
    length = np.linalg.norm(way, axis=1)
    told[:, TURN_DIRECTION], told[:, TURN_ANGLE] = motion.direction, motion.delta
    told[:, WAY_DIRECTION] = way / np.maximum(length, 1e-6)[:, None]
    told[:, WAY_LENGTH] = length / half_m
    return told


def inputs_of(cloud: PairCloud, size: Size) -> tuple[list[Tensor], PairCloud, float]:
    """The network's inputs for one cloud, (1, 2, ...) each, that cloud in the network's frame, half its cube's side."""
    facing_it, _, _ = varied(cloud, [], 0.0, False, 1.0)
    x, half_m = in_cube(facing_it.points, facing_it)
    near = (v.astype(np.int64) if v.dtype == np.int16 else v for v in neighbours_of(cloud, size))
    return [torch.from_numpy(v[None]) for v in (x, *near)], facing_it, half_m
