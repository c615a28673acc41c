"""Closed solids of meshes that are open, doubled or pass through themselves."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_sim.objects.watertight import closed, hulled

CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def volume(solid) -> float:
    """Of a surface that must be closed and face outwards."""
    points, triangles = solid
    edges = [(t[k], t[(k + 1) % 3]) for t in triangles.tolist() for k in range(3)]
    assert sorted(edges) == sorted((b, a) for a, b in edges)
    a, b, c = np.swapaxes(points[triangles], 0, 1)
    return float(np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("missing", [0, 2, 5])
def test_an_open_box_becomes_a_closed_one(missing):
    """Without one of its faces, scaled to 0.2 x 0.3 x 0.4 m."""
    faces = np.delete(FACES, [2 * missing, 2 * missing + 1], axis=0)
    assert volume(closed(CORNERS * [0.2, 0.3, 0.4], faces)) == pytest.approx(0.024, rel=1e-6)


def test_faces_that_go_either_way_round_or_are_there_twice_count_once():
    turned = FACES.copy()
    turned[::3] = turned[::3, ::-1]
    assert volume(closed(CORNERS, np.concatenate([turned, FACES[:, ::-1]]))) == pytest.approx(1.0, rel=1e-6)


def test_vertices_that_every_face_has_of_its_own_are_joined():
    assert volume(closed(CORNERS[FACES].reshape(-1, 3), np.arange(36).reshape(-1, 3))) == pytest.approx(
        1.0, rel=1e-6
    )


def test_what_overlaps_in_a_mesh_that_passes_through_itself_counts_once():
    """Two unit boxes, one moved by half its length: 1.5, not 2."""
    points = np.concatenate([CORNERS, CORNERS + np.array([0.5, 0.0, 0.0])])
    assert volume(closed(points, np.concatenate([FACES, FACES + 8]))) == pytest.approx(1.5, rel=1e-6)


def test_faces_that_cancel_each_other_bound_no_solid():
    """A prism over a bow tie: one half of it faces inwards when the other faces outwards."""
    tie = np.array([[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    points = np.concatenate([np.c_[tie, np.zeros(4)], np.c_[tie, np.ones(4)]])
    walls = [[k, (k + 1) % 4, (k + 1) % 4 + 4] for k in range(4)] + [
        [k, (k + 1) % 4 + 4, k + 4] for k in range(4)
    ]
    faces = np.array([[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], *walls])
    assert closed(points, faces) is None
    assert volume(hulled(points)) == pytest.approx(1.0, rel=1e-6)


def test_three_faces_at_one_edge_bound_no_solid():
    points = np.concatenate([CORNERS, [[2.0, 0.0, 0.5]]])
    assert closed(points, np.concatenate([FACES, [[4, 5, 8]]])) is None
