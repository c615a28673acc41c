"""The cross-section of a bar follows from its faces and its outlines, hidden sides included."""

import numpy as np
import pytest

from s2r_host.model.section import HALF_M, SectionLook, fit_section

RECTANGLE, ROD = np.array([0.013, 0.006]), 0.011
CENTRE = np.array([0.004, -0.003])
DIRECTIONS_DEG = (20.0, 55.0)  # to the camera, of both views: the bar has turned between them


def unit(angle_deg):
    return np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])


def faces(towards, rng, half=None):
    """Points on the sides that face the camera, relative to the centre, (n, 2)."""
    if half is None:
        n = np.array([unit(a) for a in rng.uniform(0.0, 360.0, 600)])
        return ROD * n[n @ towards > 0.0]
    side = np.sign(towards)
    along = rng.uniform(-1.0, 1.0, 300) * half[0], rng.uniform(-1.0, 1.0, 300) * half[1]
    return np.concatenate(
        [
            np.column_stack([along[0], np.full(300, side[1] * half[1])]),
            np.column_stack([np.full(300, side[0] * half[0]), along[1]]),
        ]
    )


def look(direction_deg, rng, half=None, *, noise_m=0.0005, outlines=True):
    """What a camera in that direction sees of a bar of 6 cm, slightly askew in its frame."""
    towards = unit(direction_deg)
    slope = np.array([0.02, -0.01])

    def placed(q):
        t = rng.uniform(-0.03, 0.03, len(q))
        return np.column_stack([t, q + CENTRE + t[:, None] * slope])

    edges = []
    for n in (unit(direction_deg + 90.0), unit(direction_deg - 90.0)) if outlines else ():
        farthest = ROD * n if half is None else np.sign(n) * half
        p = placed(np.tile(farthest, (40, 1)))
        edges.append((p, np.tile(np.r_[0.0, n], (40, 1))))
    surface = placed(faces(towards, rng, half))
    surface[:, 1:] += rng.normal(0.0, noise_m, (len(surface), 2))
    return SectionLook(surface, towards, tuple(edges), sharp=True)


def test_a_flat_bar_is_as_thick_as_its_outlines_say():
    rng = np.random.default_rng(0)
    found = fit_section([look(a, rng, RECTANGLE) for a in DIRECTIONS_DEG])
    assert not found.circle
    np.testing.assert_allclose(found.half, RECTANGLE, atol=0.0006)
    np.testing.assert_allclose(found.centre, CENTRE, atol=0.0006)


def test_a_rod_is_told_from_a_flat_bar_and_its_back_is_where_it_is():
    rng = np.random.default_rng(1)
    found = fit_section([look(a, rng) for a in DIRECTIONS_DEG])
    assert found.circle
    np.testing.assert_allclose(found.half, ROD, atol=0.0004)
    np.testing.assert_allclose(found.centre, CENTRE, atol=0.0006)


def test_a_bar_that_is_askew_in_its_frame_has_a_slope():
    rng = np.random.default_rng(2)
    found = fit_section([look(a, rng, RECTANGLE) for a in DIRECTIONS_DEG])
    np.testing.assert_allclose(found.slope, [0.02, -0.01], atol=0.008)


def test_stray_points_of_something_behind_do_not_move_it():
    rng = np.random.default_rng(3)
    views = [look(a, rng, RECTANGLE) for a in DIRECTIONS_DEG]
    stray = np.column_stack([rng.uniform(-0.03, 0.03, 80), rng.uniform(-0.03, 0.03, (80, 2))])
    dirty = [SectionLook(np.concatenate([v.surface, stray]), v.towards, v.edges, v.sharp) for v in views]
    np.testing.assert_allclose(fit_section(dirty).half, RECTANGLE, atol=0.0015)


@pytest.mark.parametrize("direction_deg", [0.0, 90.0, 200.0])
def test_a_side_that_nothing_shows_is_as_far_off_as_usual(direction_deg):
    """Seen face-on, without outlines: the thickness behind the face is the prior's."""
    rng = np.random.default_rng(4)
    view = look(direction_deg + 0.1, rng, RECTANGLE, outlines=False)
    hidden = int(abs(view.towards[1]) > 0.7)
    found = fit_section([view])
    back = (found.centre - np.sign(view.towards) * found.half)[hidden]
    front = CENTRE[hidden] + np.sign(view.towards[hidden]) * RECTANGLE[hidden]
    assert 1.4 * HALF_M < abs(front - back) < 2.6 * HALF_M
