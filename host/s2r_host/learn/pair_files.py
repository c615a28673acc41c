"""Before/after views as ``s2r data pairs`` writes them, turned into labelled points once and kept beside them."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from s2r_host.learn.archive import DAMAGE, read_archive
from s2r_host.learn.push_files import data_hash
from s2r_host.learn.solids import drawn_around, inside, moved
from s2r_host.perception.change import compare, measured_noise_scale, without_specks
from s2r_host.perception.errors import InputError, NothingMovedError
from s2r_host.perception.evidence import Scene
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.pair_cloud import PairPool, Pool, pool
from s2r_host.perception.view import DepthView, Seen

FOLDER = "points"
_ARRAYS = ("place", "normal", "flag", "centre", "gap", "query", "filled")
VERSION = 3  # of what is kept; raise it when the preparation of views or pools changes
UNIT_M = 1e-4
FEWEST = 30  # points of the part among those of both views; with fewer there is nothing to learn
NOISE_MARGIN = 0.15  # as `estimate.prepare` has it
_NEEDED = (
    "depth",
    "part",
    "q",
    "K",
    "T_base_camera",
    "slides",
    "axis_origin",
    "axis_direction",
    "spokes",
    "kind",
    "solids",
)
QUERIES = 384  # points of space per pair whose occupancy is kept, at most
AROUND_M = 0.02  # about the part's solids, where they are drawn


@dataclass(frozen=True, eq=False)
class PairSample:
    """One pair of views of one object, compact; `pools` and `part` unfold it.

    Attributes:
        place: Points of both views about ``centre`` [0.1 mm], int16, shape (n, 3).
        normal: Normals times 127, int8, shape (n, 3).
        flag: Change label + 4 edge + 8 normal fits + 16 belongs to the part, uint8, shape (n,).
        before: How many of the points belong to the first view.
        centre: [m], shape (3,).
        heading: Of the camera, see `PairPool` [rad].
        motion: Of the part, delta >= 0.
        other: The turn the other way that equal spokes make as good, or None.
        kind: Kind of object.
        gap: See `Pool` [0.1 mm], int16, shape (n,).
        query: Points of space about ``centre`` that neither view saw to be empty, the part as in the first view
            [0.1 mm], int16, shape (m, 3).
        filled: Whether the part is there, shape (m,).
    """

    place: NDArray[np.int16]
    normal: NDArray[np.int8]
    flag: NDArray[np.uint8]
    before: int
    centre: NDArray[np.floating]
    heading: float
    motion: JointMotion
    other: JointMotion | None
    kind: str
    gap: NDArray[np.int16]
    query: NDArray[np.int16]
    filled: NDArray[np.bool_]

    def pools(self) -> PairPool:
        """What `pair_cloud.sample` draws from."""
        points = self.centre + UNIT_M * self.place.astype(np.float32)
        normals = self.normal.astype(np.float32) / 127
        change, edge, ok = self.flag & 3, (self.flag & 4) > 0, (self.flag & 8) > 0
        gap = UNIT_M * self.gap.astype(np.float32)
        cut = (slice(None, self.before), slice(self.before, None))
        views = [
            Pool(points[k], normals[k], change[k], edge[k], ok[k], gap[k], np.arange(len(change[k])))
            for k in cut
        ]
        return PairPool(views[0], views[1], self.centre, self.heading)

    def part(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Points of the pools that truly belong to the moving part."""
        part = (self.flag & 16) > 0
        return part[: self.before], part[self.before :]


def pair_files(folder: Path, split: str) -> list[Path]:
    """The files of one split, sorted.

    Raises:
        InputError: There are none.
    """
    files = sorted(folder.glob(f"*-{split}-*.npz"))
    if not files:
        raise InputError(
            f"no pairs of split {split!r} in {folder}; make some: s2r data pairs --split {split} --out {folder}"
        )
    return files


def load_pairs(file: Path) -> list[PairSample]:
    """All pairs of an object; from the points kept beside its file if they are there, else they are made now.

    Raises:
        InputError: The file is damaged, or lacks something, as files of other versions do.
    """
    kept, source = file.parent / FOLDER / file.name, data_hash([file])
    samples = _kept(kept, source) if kept.exists() and kept.stat().st_mtime >= file.stat().st_mtime else None
    if samples is not None:
        return samples
    content = read_archive(file, _NEEDED, "s2r data pairs")
    samples = _prepare(content)
    _write(kept, samples, source)
    return samples


def _prepare(content: dict[str, NDArray[np.generic]]) -> list[PairSample]:
    K, X = np.asarray(content["K"], float), np.asarray(content["T_base_camera"], float)
    frames = [DepthFrame(UNIT_M * d.astype(np.float32), K, X) for d in content["depth"]]
    views = [DepthView(frame) for frame in frames]
    scale = measured_noise_scale(views[0], views[1])
    if abs(scale - 1.0) > NOISE_MARGIN:
        views = [DepthView(frame, noise_scale=scale) for frame in frames]
    part = np.unpackbits(content["part"], axis=-1)[..., : _columns(content)].astype(bool)
    q, spokes, samples = np.asarray(content["q"], float), int(content["spokes"]), []
    solids = np.asarray(content["solids"], float)

    def joint(delta: float) -> JointMotion:
        return JointMotion(
            "prismatic" if bool(content["slides"]) else "revolute",
            np.asarray(content["axis_origin"], float),
            np.asarray(content["axis_direction"], float),
            delta,
        )

    for k, (i, j) in enumerate(combinations(range(len(views)), 2)):
        sample = _sample(
            (views[i], views[j]),
            (part[i], part[j]),
            joint(float(q[j] - q[i])).positive(),
            moved(solids, joint(float(q[i] - q[0])).transform()),
            spokes,
            np.random.default_rng([k, 11]),
        )
        if sample is not None:
            samples.append(replace(sample, kind=str(content["kind"])))
    return samples


def _columns(content: dict[str, NDArray[np.generic]]) -> int:
    """Columns of the images; packed bits are filled up to whole bytes."""
    return int(content["depth"].shape[-1])


def _sample(
    views: tuple[DepthView, DepthView],
    part: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    motion: JointMotion,
    solids: NDArray[np.floating],
    spokes: int,
    rng: np.random.Generator,
) -> PairSample | None:
    """None if nothing of the motion is in sight of one of them."""
    a, b = views
    everywhere = np.ones(len(a.points), dtype=bool), np.ones(len(b.points), dtype=bool)
    scene = Scene(a, b, without_specks(a, b, compare(a, b)), *everywhere)
    try:
        pools = pool(scene, rng)
    except NothingMovedError:
        return None
    if pools.one_sided():
        return None
    both = (pools.before, pools.after)
    belongs = [p.ravel()[v.flat[some.index]] for v, p, some in zip(views, part, both, strict=True)]
    if sum(int(mine.sum()) for mine in belongs) < FEWEST:
        return None
    points, normals = (
        np.concatenate([getattr(some, name) for some in both]) for name in ("points", "normals")
    )
    flag = np.concatenate(
        [
            some.change + 4 * some.edge + 8 * some.normal_ok + 16 * mine
            for some, mine in zip(both, belongs, strict=True)
        ]
    )
    query, filled = _space(views, motion, solids, rng)
    return PairSample(
        _short(points - pools.centre),
        np.rint(127 * normals).astype(np.int8),
        flag.astype(np.uint8),
        len(pools.before.points),
        pools.centre,
        pools.heading,
        motion,
        _other(motion, spokes),
        "",
        _short(np.concatenate([some.gap_m for some in both])),
        _short(query - pools.centre),
        filled,
    )


def _short(length_m: NDArray[np.floating]) -> NDArray[np.int16]:
    return np.clip(np.rint(length_m / UNIT_M), -32767, 32767).astype(np.int16)


def _space(
    views: tuple[DepthView, DepthView],
    motion: JointMotion,
    solids: NDArray[np.floating],
    rng: np.random.Generator,
) -> tuple[NDArray[np.floating], NDArray[np.bool_]]:
    """Points about the part as in the first view that neither view saw to be empty [m] (m, 3), and if it is there."""
    if not len(solids):
        return np.zeros((0, 3)), np.zeros(0, dtype=bool)
    p, X = drawn_around(solids, 4 * QUERIES, AROUND_M, rng), motion.transform()
    free = views[0].look(p, 0.001).seen == Seen.FREE
    free |= views[1].look(p @ X[:3, :3].T + X[:3, 3], 0.001).seen == Seen.FREE
    p = p[~free][:QUERIES]
    return p, inside(p, solids)


def _other(motion: JointMotion, spokes: int) -> JointMotion | None:
    if motion.joint_type == "prismatic" or spokes < 2:
        return None
    spacing = 2 * np.pi / spokes
    delta = motion.delta % spacing
    return replace(motion, direction=-motion.direction, delta=spacing - delta)


def _write(path: Path, samples: list[PairSample], source: str) -> None:
    path.parent.mkdir(exist_ok=True)
    arrays: dict[str, NDArray[np.generic]] = {"version": np.array(VERSION), "count": np.array(len(samples))}
    arrays["source"] = np.array(source)
    for k, sample in enumerate(samples):
        arrays |= {f"{name}{k}": getattr(sample, name) for name in _ARRAYS}
        arrays[f"before{k}"] = np.array(sample.before)
        arrays[f"heading{k}"] = np.array(sample.heading)
        motions = [m for m in (sample.motion, sample.other) if m is not None]
        arrays[f"motion{k}"] = np.array([[*m.origin, *m.direction, m.delta] for m in motions])
        arrays[f"name{k}"] = np.array([sample.motion.joint_type, sample.kind])
    part = path.with_name(
        f"{path.name}.{os.getpid()}.part"
    )  # two trainings may prepare the same pairs at a time
    with part.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
    part.replace(path)


def _kept(path: Path, source: str) -> list[PairSample] | None:
    """None if another version wrote it, it was made of another file than the one with that hash, or it is damaged."""
    try:
        return _read(path, source)
    except (*DAMAGE, KeyError):
        return None


def _read(path: Path, source: str) -> list[PairSample] | None:
    with np.load(path) as archive:
        made_of = str(archive["source"]) if "source" in archive else source  # points kept before hashes were
        if int(archive["version"]) != VERSION or made_of != source:
            return None
        samples = []
        for k in range(int(archive["count"])):
            joint_type, kind = (str(name) for name in archive[f"name{k}"])
            motions = [
                JointMotion(
                    "prismatic" if joint_type == "prismatic" else "revolute", m[:3], m[3:6], float(m[6])
                )
                for m in archive[f"motion{k}"]
            ]
            samples.append(
                PairSample(
                    archive[f"place{k}"],
                    archive[f"normal{k}"],
                    archive[f"flag{k}"],
                    int(archive[f"before{k}"]),
                    archive[f"centre{k}"],
                    float(archive[f"heading{k}"]),
                    motions[0],
                    motions[1] if len(motions) > 1 else None,
                    kind,
                    archive[f"gap{k}"],
                    archive[f"query{k}"],
                    archive[f"filled{k}"],
                )
            )
    return samples
