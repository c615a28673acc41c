"""Corners and triangles of a Wavefront file (.obj); what it says of normals and materials is left out."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from s2r_sim.errors import WorldFileError


def vertices_of(file: Path) -> np.ndarray:
    """Vertices [the file's units], shape (n, 3).

    Raises:
        WorldFileError: Another format, fewer than 3 vertices, or one that is no three finite numbers.
    """
    if file.suffix.lower() != ".obj":
        raise WorldFileError(f"{file}: meshes are read as Wavefront files; write it as .obj and name that")
    rows = [words[1:4] for words in _rows(file, "v")]
    try:
        points = np.array(rows, dtype=float).reshape(-1, 3)
    except ValueError as error:
        raise WorldFileError(f"{file}: not a Wavefront mesh ({error})") from error
    if len(points) < 3:
        raise WorldFileError(f"{file}: {len(points)} vertices, at least 3 are needed for a surface")
    if not np.isfinite(points).all():
        raise WorldFileError(f"{file}: a vertex is not finite; write the mesh anew")
    return points


def triangles_of(file: Path, vertices: int) -> np.ndarray:
    """Corner numbers, from 0, of the faces cut into triangles from their first corner, shape (n, 3).

    Args:
        file: The mesh.
        vertices: How many it has; negative corner numbers count back from the last one, as exporters write them at
            the end of a file.

    Raises:
        WorldFileError: A face names no vertex of the file.
    """
    try:
        faces = [[int(word.split("/")[0]) for word in words[1:]] for words in _rows(file, "f")]
    except ValueError as error:
        raise WorldFileError(f"{file}: not a Wavefront mesh ({error})") from error
    cut = [(face[0], b, c) for face in faces for b, c in pairwise(face[1:])]
    corners = np.array(cut, dtype=np.int64).reshape(-1, 3)
    corners = np.where(corners < 0, corners + vertices, corners - 1)
    if ((corners < 0) | (corners >= vertices)).any():
        raise WorldFileError(f"{file}: a face names a vertex that is not there; it has {vertices}")
    return corners


def _rows(file: Path, key: str) -> list[list[str]]:
    """The words of the lines that begin with ``key``, set apart by any blanks."""
    text = file.read_text(encoding="utf-8", errors="replace")  # names of materials may be in any encoding
    return [words for line in text.splitlines() if (words := line.split()) and words[0] == key]
