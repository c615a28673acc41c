"""A part with equal spokes is told up to their spacing, and taken to be where it is expected."""

from types import SimpleNamespace

import numpy as np
import pytest

from s2r_host.errors import SceneError
from s2r_host.perception.motion import JointMotion
from s2r_host.run import measure_view
from s2r_host.run.measure import PartTemplate
from s2r_host.run.spacing import spacing_of

HINGE = JointMotion("revolute", np.array([0.6, 0.1, 0.2]), np.array([0.0, 0.0, 1.0]), 0.0)


def part(angles_deg, kind="revolute", seed=0):
    """A round hub with bars at these angles, as a camera from above sees them."""
    rng = np.random.default_rng(seed)
    hub = rng.uniform(-0.012, 0.012, (800, 2))
    bars = []
    for angle in np.radians(angles_deg):
        out, aside = rng.uniform(0.01, 0.045, 600), rng.uniform(-0.006, 0.006, 600)
        c, s = np.cos(angle), np.sin(angle)
        bars.append(np.column_stack([c * out - s * aside, s * out + c * aside]))
    flat = np.concatenate([hub, *bars])
    p = HINGE.origin + np.column_stack([flat, rng.normal(scale=0.001, size=len(flat))])
    return PartTemplate(
        p, np.tile([0.0, 0.0, 1.0], (len(p), 1)), JointMotion(kind, HINGE.origin, HINGE.direction, 0.0)
    )


@pytest.mark.parametrize(
    ("angles_deg", "spacing_deg"),
    [((10, 100, 190, 280), 90), ((0, 120, 240), 120), ((30, 210), 180), ((20, 80, 140, 200, 260, 320), 60)],
)
def test_equal_spokes_look_alike_after_their_spacing(angles_deg, spacing_deg):
    assert spacing_of(part(angles_deg)) == pytest.approx(np.radians(spacing_deg))


@pytest.mark.parametrize("angles_deg", [(10,), (0, 120), (0, 90), (0, 40, 150)])
def test_a_lever_and_unequal_spokes_do_not(angles_deg):
    assert spacing_of(part(angles_deg)) is None


def test_a_cross_of_which_one_spoke_is_hidden_is_a_cross():
    assert spacing_of(part((0, 90, 180))) == pytest.approx(np.pi / 2)


def test_a_cross_is_looked_for_within_half_its_spacing_of_where_it_is_expected(monkeypatch):
    asked = []

    def measure(template, view, s_range, s_expected):
        asked.append(s_range)
        raise SceneError("not seen")

    monkeypatch.setattr(measure_view, "measure_state", measure)
    monkeypatch.setattr(measure_view, "DepthView", lambda *_: None)
    monkeypatch.setattr(measure_view, "_by_solid", lambda *_: None)
    look = SimpleNamespace(capture=SimpleNamespace(frame=None), arm_mask=None)
    for angles_deg in ((0, 90, 180, 270), (10,)):
        belief = SimpleNamespace(
            estimate=SimpleNamespace(knob=None),
            model=SimpleNamespace(range=(-1.0, 1.8)),
            template=part(angles_deg),
        )
        for nearest in (True, False):
            with pytest.raises(SceneError):
                measure_view.measure_in(belief, look, 0.4, nearest=nearest)
    cross, anywhere, lever, lever_anywhere = asked
    assert cross == (pytest.approx(0.4 - np.pi / 4), pytest.approx(0.4 + np.pi / 4))
    assert anywhere[0] < -1.0
    assert lever == lever_anywhere
    assert lever[1] > 1.8


def test_a_slide_does_not():
    assert spacing_of(part((0, 90, 180, 270), "prismatic")) is None


def test_a_few_points_tell_nothing():
    cross = part((0, 90, 180, 270))
    few = PartTemplate(cross.p[::60], cross.n[::60], cross.motion)
    assert spacing_of(few) is None
