"""Convex decomposition of free-form point sets with CoACD, in a process of its own.

CoACD imported before Open3D breaks Open3D ("std::bad_cast" in version 0.20), keeps its threads, and cannot be
interrupted; a child process avoids all three.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Array = NDArray[np.floating]

_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
# Faces of a cell, outward, as quads over _CORNERS, with the neighbour they look at.
_QUADS = (
    ((0, 1, 3, 2), (-1, 0, 0)), ((4, 6, 7, 5), (1, 0, 0)), ((0, 4, 5, 1), (0, -1, 0)),
    ((2, 3, 7, 6), (0, 1, 0)), ((0, 2, 6, 4), (0, 0, -1)), ((1, 5, 7, 3), (0, 0, 1)),
)  # fmt: skip


@dataclass(frozen=True)
class Fineness:
    """CoACD's settings, by its own names; what is left out is CoACD's default."""

    threshold: float = 0.1
    preprocess_resolution: int = 30
    mcts_iterations: int = 60
    max_convex_hull: int = 8


_COARSE = Fineness()


def decompose(points: Array, cell_m: float, cpu_limit_s: float) -> tuple[list[Array], str | None]:
    """Convex hulls that cover a point set, (k, 3) corners each [m], and a warning or None.

    Args:
        points: Points of the solid [m], shape (n, 3).
        cell_m: Voxel size of the solid [m].
        cpu_limit_s: As for `decompose_surface`.
    """
    vertices, faces = voxel_surface(points, cell_m)
    if len(vertices) < 8:
        return [], None
    hulls, failure = decompose_surface(vertices, faces, cpu_limit_s)
    if failure is None:
        return hulls, None
    return [_hull(points)], f"convex decomposition {failure}; one convex hull is used instead"


def decompose_surface(
    vertices: Array, faces: NDArray[np.int64], cpu_limit_s: float, fineness: Fineness = _COARSE
) -> tuple[list[Array], str | None]:
    """Convex hulls that cover what a closed surface encloses.

    Args:
        vertices: Corners of the surface [m], (n, 3).
        faces: Its triangles, (m, 3).
        cpu_limit_s: Processor time for CoACD, on all cores together. Not a time by the clock: on a busy machine the
            same object would get another model.
        fineness: How closely the hulls follow the surface.

    Returns:
        Corner sets (k, 3) of the hulls, and None; or none and what happened, as the end of a sentence.
    """
    with tempfile.TemporaryDirectory(prefix="s2r-coacd-") as folder:
        source, target = Path(folder) / "in.npz", Path(folder) / "out.npz"
        np.savez(source, vertices=vertices, faces=faces)
        command = [
            sys.executable,
            "-m",
            "s2r_host.model.coacd_worker",
            str(source),
            str(target),
            str(cpu_limit_s),
        ]
        command.append(json.dumps(asdict(fineness)))
        clock_s = 30.0 + 10.0 * cpu_limit_s  # the child limits itself; this only ends what hangs
        try:
            done = subprocess.run(command, timeout=clock_s, capture_output=True, text=True, check=False)
        except subprocess.TimeoutExpired:
            return [], f"hung for {clock_s:.0f} s"
        if done.returncode == -signal.SIGPROF:
            return [], f"took more than {cpu_limit_s:g} s of processor time"
        if done.returncode != 0 or not target.exists():
            last = done.stderr.strip().splitlines()[-1:] or ["no message"]
            return [], f"failed ({last[0]})"
        with np.load(target) as content:
            return [content[name] for name in content.files], None


def voxel_surface(points: Array, cell_m: float) -> tuple[Array, NDArray[np.int64]]:
    """Closed surface of the voxels that hold points: vertices [m] (n, 3) and triangles (m, 3)."""
    cells = np.unique(np.floor(points / cell_m).astype(np.int64), axis=0)
    taken = {tuple(c) for c in cells.tolist()}
    quads = []
    for quad, step in _QUADS:
        outer = [c for c in taken if (c[0] + step[0], c[1] + step[1], c[2] + step[2]) not in taken]
        quads += [[np.add(c, _CORNERS[i]) for i in quad] for c in outer]
    if not quads:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    corners = np.array(quads).reshape(-1, 3)
    vertices, index = np.unique(corners, axis=0, return_inverse=True)
    index = index.reshape(-1, 4)
    faces = np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]])
    return vertices * cell_m, faces


def _hull(points: Array) -> Array:
    return points[ConvexHull(points).vertices]
