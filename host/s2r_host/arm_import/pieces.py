"""Cutting a mesh into pieces that simple shapes hold closely: one shape is much larger than a bent or forked link."""

from __future__ import annotations

from typing import Any

import numpy as np
from trimesh.intersections import slice_faces_plane

from s2r_host.arm_import.enclosing import enclose, volume

_MOST = 4  # shapes of one mesh: each is measured against those of all other links
_WORTH = 0.08  # of the volume of all shapes, which a further cut must take away
_WHERE = (0.2, 0.35, 0.5, 0.65, 0.8)  # of the length along an axis

Surface = tuple[np.ndarray, np.ndarray]  # vertices (n, 3) and faces (m, 3)


def enclosed(surface: Surface) -> list[dict[str, Any]]:
    """Shapes that together hold all of a surface and what is inside: one, or more where that is much closer.

    A point inside lies between two of the surface in the same slice, so the slice's shape holds it as well.
    """
    shapes, cuts = [enclose(surface[0])], [_best_cut(surface)]
    while len(shapes) < _MOST:
        gains = [volume(shape) - _volume(halves) for shape, halves in zip(shapes, cuts, strict=True)]
        k = int(np.argmax(gains))
        if gains[k] < _WORTH * sum(map(volume, shapes)):
            break
        halves = cuts[k]
        shapes[k : k + 1] = [enclose(points) for points, _ in halves]
        cuts[k : k + 1] = [_best_cut(half) for half in halves]
    return shapes


def _best_cut(surface: Surface) -> list[Surface]:
    """The two pieces whose shapes are smallest together; the surface itself where no cut leaves two."""
    low, high = surface[0].min(axis=0), surface[0].max(axis=0)
    found = [[surface]]
    for axis in range(3):
        for share in _WHERE:
            normal, origin = np.eye(3)[axis], low + share * (high - low)
            found.append([_above(surface, side * normal, origin) for side in (-1.0, 1.0)])
    return min((pieces for pieces in found if all(len(points) for points, _ in pieces)), key=_volume)


def _above(surface: Surface, normal: np.ndarray, origin: np.ndarray) -> Surface:
    vertices, faces = slice_faces_plane(*surface, normal, origin)[:2]
    return vertices, faces


def _volume(pieces: list[Surface]) -> float:
    return sum(volume(enclose(points)) for points, _ in pieces)
