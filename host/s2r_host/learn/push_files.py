"""Push data as ``s2r data pushes`` writes it, prepared once and kept in memory."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from s2r_host.perception.errors import BadViewError, InputError
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.object_cloud import ObjectCloud, Pyramid, object_cloud, pyramid

FARTHEST_M = 0.02  # a push at a point the noisy view does not show is left out


@dataclass(frozen=True, eq=False)
class PushSample:
    """One view with its pushes.

    Attributes:
        cloud, neighbours: The prepared view.
        at: Cloud point nearest to each push, shape (pushes,).
        direction: Unit push directions, shape (pushes, 3).
        useful: Outcomes, shape (pushes,).
        kind: Kind of object.
    """

    cloud: ObjectCloud
    neighbours: Pyramid
    at: NDArray[np.int64]
    direction: NDArray[np.float32]
    useful: NDArray[np.bool_]
    kind: str


def push_files(folder: Path, split: str) -> list[Path]:
    """The files of one split, sorted.

    Raises:
        InputError: There are none.
    """
    files = sorted(folder.glob(f"*-{split}-*.npz"))
    if not files:
        raise InputError(
            f"no push data of split {split!r} in {folder}; make some: s2r data pushes --split {split} --out {folder}"
        )
    return files


def data_hash(files: list[Path]) -> str:
    """SHA-256 (hex) over names and contents: which data a set of weights comes from."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def load_pushes(file: Path, seed: int) -> PushSample | None:
    """Read and prepare one file; None if its object cannot be seen."""
    with np.load(file) as content:
        frame = DepthFrame(content["depth"], content["K"], content["T_base_camera"], None)
        point, direction, useful = content["point"], content["direction"], content["useful"]
        kind = str(content["kind"])
    try:
        cloud = object_cloud(frame, np.random.default_rng([seed, 7]))
    except BadViewError:
        return None  # the part may be out of sight of its camera; nothing to learn there
    if len(point) == 0:
        return None
    distance, at = cKDTree(cloud.points).query(point)
    near = np.asarray(distance) < FARTHEST_M
    if not near.any():
        return None
    return PushSample(
        cloud,
        pyramid(cloud.points),
        np.asarray(at)[near],
        direction[near].astype(np.float32),
        useful[near].astype(bool),
        kind,
    )
