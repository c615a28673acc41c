"""Push data as ``s2r data pushes`` writes it, prepared once and kept in memory."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from s2r_host.learn.archive import read_archive
from s2r_host.perception.errors import BadViewError, InputError
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.object_cloud import ObjectCloud, Pyramid, SeenObject, pyramid

FARTHEST_M = 0.01  # a push farther from every point of the cloud is left out
UNIT_M = 1e-4  # of the depths in the files
AROUND_PX = 24  # about the object
NEITHER, PART = 0, 2  # labels of the pixels of other things, and of the part that moves
_NEEDED = (
    "depth",
    "K",
    "T_base_camera",
    "point",
    "direction",
    "useful",
    "blocked",
    "on_part",
    "label",
    "kind",
)


@dataclass(frozen=True, eq=False)
class PushSample:
    """One view, once sampled, with its pushes.

    Attributes:
        cloud, neighbours: The prepared view.
        part: Points of the part that moves, shape (POINTS,).
        motion: Unit directions of motion of those points, either sense; 0 elsewhere, shape (POINTS, 3).
        at: Cloud point nearest to each push, shape (pushes,).
        direction: Unit push directions, shape (pushes, 3).
        useful: Outcomes, shape (pushes,).
        kind: Kind of object.
    """

    cloud: ObjectCloud
    neighbours: Pyramid
    part: NDArray[np.bool_]
    motion: NDArray[np.float32]
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


def load_pushes(file: Path, seed: int, times: int = 1) -> list[PushSample]:
    """Read one file and sample its view several times; none if its object or all of its pushes are out of sight.

    Pushes whose finger touched something before it began are left out: they never happen.

    Raises:
        InputError: The file is damaged, or lacks something, as files of older versions do.
    """
    content = read_archive(file, _NEEDED, "s2r data pushes")
    if content["depth"].dtype != np.uint16:
        raise InputError(f"{file} has depth of an older version; make it anew with 's2r data pushes'")
    content = _cropped(content)
    try:
        depth_m = UNIT_M * content["depth"].astype(np.float32)
        seen = SeenObject(DepthFrame(depth_m, content["K"], content["T_base_camera"], None))
    except BadViewError:
        return []  # the part may be out of sight of its camera; nothing to learn there
    samples = (_sample(seen, content, np.random.default_rng([seed, k, 7])) for k in range(times))
    return [sample for sample in samples if sample is not None]


def _cropped(content: dict[str, NDArray[np.generic]]) -> dict[str, NDArray[np.generic]]:
    """Only the object and what is next to it: the rest of a view would be prepared for nothing."""
    rows, columns = (np.flatnonzero((content["label"] != NEITHER).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return content
    top, left = (max(0, int(some[0]) - AROUND_PX) for some in (rows, columns))
    box = slice(top, rows[-1] + 1 + AROUND_PX), slice(left, columns[-1] + 1 + AROUND_PX)
    K = np.array(content["K"], dtype=float)
    K[:2, 2] -= left, top
    return content | {"depth": content["depth"][box], "label": content["label"][box], "K": K}


def _sample(
    seen: SeenObject, content: dict[str, NDArray[np.generic]], rng: np.random.Generator
) -> PushSample | None:
    cloud = seen.sample(rng)
    part = content["label"].ravel()[cloud.pixels] == PART
    point = np.asarray(content["point"], dtype=float)
    if len(point) == 0:
        return None
    distance, nearest = cKDTree(cloud.points).query(point)
    at = np.asarray(nearest, dtype=np.int64)
    fit = (np.asarray(distance) < FARTHEST_M) & ~content["blocked"] & (part[at] == content["on_part"])
    if not fit.any():
        return None
    return PushSample(
        cloud,
        pyramid(cloud.points),
        part,
        _motion(cloud.points, part, content),
        at[fit],
        np.asarray(content["direction"][fit], dtype=np.float32),
        np.asarray(content["useful"][fit], dtype=bool),
        str(content["kind"]),
    )


def _motion(
    points: NDArray[np.floating], part: NDArray[np.bool_], content: dict[str, NDArray[np.generic]]
) -> NDArray[np.float32]:
    """Directions in which the part's points would move, unit, shape (POINTS, 3)."""
    axis = np.asarray(content["axis_direction"], dtype=float)
    if bool(content["slides"]):
        motion = np.tile(axis, (len(points), 1))
    else:
        motion = np.cross(axis, points - np.asarray(content["axis_origin"], dtype=float))
        motion /= np.maximum(np.linalg.norm(motion, axis=1, keepdims=True), 1e-6)
    return np.where(part[:, None], motion, 0.0).astype(np.float32)
