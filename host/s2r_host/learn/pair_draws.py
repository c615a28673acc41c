"""Samples of a pair with everything that costs time already done: points drawn, neighbours looked up.

A pair is drawn once forwards and once with its views exchanged; epochs take turns. What is left for every step is a
turn, a mirror image and a change of size, under which neighbours stay neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_host.learn.pair_files import UNIT_M, PairSample
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.pair_cloud import PairCloud, sample
from s2r_host.perception.pair_network import neighbourhoods
from s2r_host.perception.pair_space import Beside, beside

QUERIES = 96  # points of space per draw
TAKEN_WRONG = 0.05  # share of points of which it is not known rightly whether they are the part's
SHAKEN_M = 0.002  # the motion that carries the second view back is known this well


@dataclass(frozen=True, eq=False)
class Drawn:
    """One draw of one pair.

    Attributes:
        cloud: The points.
        part: Which of them are the part's, shape (2, P).
        motions: Of the part, and the turn the other way that equal spokes make as good.
        pyramid: Neighbourhoods of both views, see `pair_network.neighbourhoods`.
        beside: Points beside queries of space.
        filled: Whether the part is at these queries, shape (Q,).
    """

    cloud: PairCloud
    part: NDArray[np.bool_]
    motions: tuple[JointMotion, ...]
    pyramid: list[NDArray[np.generic]]
    beside: Beside
    filled: NDArray[np.bool_]


def draw(one: PairSample, rng: np.random.Generator, back: bool = False) -> Drawn:
    """Draw points and queries; ``back``: with the views exchanged."""
    cloud = sample(one.pools(), rng)
    part = np.stack([mine[at] for mine, at in zip(one.part(), cloud.chosen, strict=True)])
    motions = tuple(m for m in (one.motion, one.other) if m is not None)
    query, filled = _queries(one, rng)
    if back:
        X = one.motion.transform()
        query = query @ X[:3, :3].T + X[:3, 3]
        cloud, part = exchanged(cloud), part[::-1]
        motions = tuple(replace(m, direction=-m.direction) for m in motions)
    told = part ^ (rng.uniform(size=part.shape) < TAKEN_WRONG)
    shaken = _shaken(motions[0], rng)
    return Drawn(
        cloud,
        part,
        motions,
        [_small(value) for value in neighbourhoods(cloud)],
        beside(query, cloud, told.astype(np.float32), shaken),
        filled,
    )


def exchanged(cloud: PairCloud) -> PairCloud:
    """The second view first."""
    return replace(
        cloud,
        points=cloud.points[::-1],
        normals=cloud.normals[::-1],
        flags=cloud.flags[::-1],
        gap_m=cloud.gap_m[::-1],
        chosen=cloud.chosen[::-1],
    )


def _queries(one: PairSample, rng: np.random.Generator) -> tuple[NDArray[np.floating], NDArray[np.bool_]]:
    """`QUERIES` of the kept points of space; without any, places far from the part, which are empty."""
    if not len(one.query):
        return one.centre + np.ones((QUERIES, 3)), np.zeros(QUERIES, dtype=bool)
    at = rng.choice(len(one.query), QUERIES, replace=len(one.query) < QUERIES)
    return one.centre + UNIT_M * one.query[at].astype(float), one.filled[at]


def _shaken(motion: JointMotion, rng: np.random.Generator) -> JointMotion:
    return replace(motion, origin=motion.origin + rng.normal(0.0, SHAKEN_M, 3))


def _small(value: NDArray[np.generic]) -> NDArray[np.generic]:
    return value.astype(np.int16) if value.dtype == np.int64 else value
