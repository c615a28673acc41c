"""Edges of colour: faint ones where an image is clean, none that are no more than its grain."""

import numpy as np
import pytest

from s2r_host.perception.colour_edges import colour_edges

ALL = np.ones((60, 80), bool)


def _step(levels: float, grain: float = 0.0) -> np.ndarray:
    """An image with an edge between two columns, and noise of so many levels."""
    colour = np.full((60, 80, 3), 100.0)
    colour[:, 40:] += levels
    return np.rint(colour + grain * np.random.default_rng(0).standard_normal(colour.shape)).astype(np.uint8)


@pytest.mark.parametrize("levels", [6.0, 12.0])
def test_an_edge_of_a_few_levels_is_found_where_it_is(levels):
    edges = colour_edges(_step(levels), ALL)
    rows = np.unique(edges.uv[:, 1])
    assert len(rows) > 50
    assert edges.uv[:, 0] == pytest.approx(39.5, abs=0.3)


def test_what_is_no_more_than_grain_is_no_edge():
    assert len(colour_edges(_step(0.0, grain=4.0), ALL).uv) < 10
    beyond = colour_edges(_step(40.0, grain=4.0), ALL).uv[:, 0]
    assert np.mean(np.abs(beyond - 39.5) < 1.0) > 0.9
