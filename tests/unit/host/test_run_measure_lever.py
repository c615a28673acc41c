"""A lever that an outline told is measured by it in later looks, also where too little of its depth is seen."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.errors import SceneError
from s2r_host.perception.colour_turn import Turn
from s2r_host.perception.estimate import JointEstimate, estimate_joint
from s2r_host.perception.intervals import Z90
from s2r_host.perception.lever_outline import Turns, lever_outline
from s2r_host.perception.segment import Parts
from s2r_host.perception.synthetic import LEVER_COLOURS, LeverLook, lever_look
from s2r_host.perception.view import DepthView
from s2r_host.run import measure_view
from s2r_host.run.belief import Belief
from s2r_host.run.measure import part_template
from s2r_host.run.measure_view import measure_in

HALF_M = np.array([0.06, 0.010, 0.005])
FIRST, SECOND, NOW = 2.4, 1.9, 1.3
NOT_USED: Any = None


@cache
def told() -> JointEstimate:
    first, second = lever_look(FIRST, HALF_M), lever_look(SECOND, HALF_M)
    estimate = estimate_joint(first.frame, second.frame, joint_type="revolute")
    before, after = DepthView(first.frame), DepthView(second.frame)
    parts = Parts(first.part.ravel()[before.flat], second.part.ravel()[after.flat])
    lever = lever_outline(before, parts.before, after, parts.after, estimate.motion)
    assert lever is not None
    half = Z90 * lever.turn_sigma
    estimate = replace(
        estimate,
        axis_origin_m=lever.hinge.origin,
        axis_direction=lever.hinge.direction,
        delta=lever.hinge.delta,
        intervals90=replace(estimate.intervals90, delta=(lever.hinge.delta - half, lever.hinge.delta + half)),
        view_before=before,
        view_after=after,
        parts=parts,
        lever=lever.shape,
    )
    return estimate if estimate.axis_direction[2] > 0.0 else estimate.reversed()


def believed(estimate: JointEstimate) -> Belief:
    model: Any = SimpleNamespace(range=(-2.5, 2.5))
    return Belief(estimate, model, part_template(estimate), NOT_USED, NOT_USED, {})


def seen(look: LeverLook) -> Any:
    return SimpleNamespace(
        capture=SimpleNamespace(frame=look.frame), arm_mask=np.zeros(look.part.shape, bool)
    )


@pytest.fixture
def unseen(monkeypatch):
    """Depth shows too little of the part."""

    def hidden(*_: object) -> None:
        raise SceneError("only 30% of the moving part is seen")

    monkeypatch.setattr(measure_view, "measure_state", hidden)


@pytest.mark.parametrize("since_told", [False, True])
def test_the_outline_measures_since_the_look_that_counts(since_told):
    measured = measure_in(believed(told()), seen(lever_look(NOW, HALF_M)), NOW - FIRST, since_told=since_told)
    true = told().delta + NOW - SECOND if since_told else NOW - FIRST
    assert measured.s == pytest.approx(true, abs=0.02)
    assert abs(measured.s - true) < 3.0 * measured.sigma


@pytest.mark.parametrize(("sigma_deg", "share"), [(0.2, 0.9), (5.0, 0.1)])
def test_outline_and_depth_count_by_what_they_err(monkeypatch, sigma_deg, share):
    """A solid that explains a look badly pulls the state little, one that explains it well nearly all the way."""
    look, since = seen(lever_look(NOW, HALF_M)), NOW - FIRST
    without = measure_in(believed(replace(told(), lever=None)), look, since).s
    off = without + np.radians(2.0)
    turn = Turn(off, float(np.radians(sigma_deg)))
    monkeypatch.setattr(
        measure_view, "turns_since", lambda *_: Turns(turn, turn, 1.0, explained=sigma_deg < 1.0)
    )
    moved = (measure_in(believed(told()), look, since).s - without) / (off - without)
    assert moved == pytest.approx(share, abs=0.1)


@pytest.mark.usefixtures("unseen")
def test_a_solid_that_explains_a_look_badly_does_not_measure_alone(monkeypatch):
    turn = Turn(NOW - FIRST, 0.05)
    monkeypatch.setattr(measure_view, "turns_since", lambda *_: Turns(turn, turn, 1.0, explained=False))
    with pytest.raises(SceneError, match="only 30%"):
        measure_in(believed(told()), seen(lever_look(NOW, HALF_M)), NOW - FIRST)


@pytest.mark.usefixtures("unseen")
def test_where_depth_shows_too_little_the_outline_measures_alone():
    measured = measure_in(believed(told()), seen(lever_look(NOW, HALF_M)), NOW - FIRST + 0.05)
    assert measured.s == pytest.approx(NOW - FIRST, abs=0.02)
    assert 0.6 < measured.matched <= 1.0


@pytest.mark.usefixtures("unseen")
def test_what_neither_depth_nor_outline_shows_is_told():
    with pytest.raises(SceneError, match="only 30%"):
        measure_in(believed(replace(told(), lever=None)), seen(lever_look(NOW, HALF_M)), NOW - FIRST)
    look = lever_look(NOW, HALF_M)
    assert look.frame.colour is not None
    gone = replace(look, frame=replace(look.frame, colour=np.full_like(look.frame.colour, LEVER_COLOURS[3])))
    with pytest.raises(SceneError, match="only 30%"):
        measure_in(believed(told()), seen(gone), NOW - FIRST)
