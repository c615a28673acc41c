"""The state of a believed part in a view, new or old."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from s2r_host.errors import SceneError
from s2r_host.perception.colour_turn import Turn, combined, turn_by_colour
from s2r_host.perception.intervals import Z90
from s2r_host.perception.knob_joint import EDGE_M
from s2r_host.perception.knob_outline import KnobOutline, turned_outline
from s2r_host.perception.lever_outline import LeverOutline, turns_since
from s2r_host.perception.view import DepthView
from s2r_host.run.belief import Belief
from s2r_host.run.measure import Measurement, measure_state
from s2r_host.run.observe import Observation
from s2r_host.run.spacing import spacing_of

MARGIN_M = 0.03  # of the part's outermost points, beyond the joint's believed range
LEVER_M = 0.2  # a part that reaches no further from its hinge is as thin as a lever's, or has spokes
# Depth of thin parts errs by so much at the outermost points, and other than its noise tells (31 drawn faucets).
DEPTH_ERRS_M = 0.0013
KNOB_SIGMA_RAD = np.deg2rad(0.5)
# Depth and edges in colour without a solid err by so much more than they say, and by that where they cannot say.
WITHOUT_SOLID_RAD, UNTOLD_RAD = np.deg2rad(0.8), np.deg2rad(5.0)


def measure_in(
    belief: Belief, view: Observation, s_expected: float, *, since_told: bool = False, nearest: bool = True
) -> Measurement:
    """Fit the joint value of the part in a view.

    Args:
        belief: In the part.
        view: The look.
        s_expected: Breaks ties [m or rad].
        since_told: What counts is how far a lever is from where the second view that told its joint shows it, not the
            first.
        nearest: Of the turns after which a part with equal spokes looks alike, the one nearest to what is expected.

    Raises:
        SceneError: The part is not seen.
    """
    if belief.estimate.knob is not None:
        return _by_outline(belief, view, belief.estimate.knob, s_expected)
    (low, high), margin = belief.model.range, MARGIN_M / belief.template.reach_m
    low, high = low - margin, high + margin
    spacing = spacing_of(belief.template) if nearest and belief.template.reach_m <= LEVER_M else None
    if spacing is not None:
        low, high = max(low, s_expected - 0.5 * spacing), min(high, s_expected + 0.5 * spacing)
    now = DepthView(view.capture.frame, view.arm_mask)
    try:
        found = measure_state(belief.template, now, (low, high), s_expected)
    except SceneError:
        told = _by_solid(belief, now, s_expected, since_told)
        if told is None or not told.explained:
            raise
        return told.measured
    if belief.template.slides or belief.template.reach_m > LEVER_M:
        return found
    found = _with_colour(belief, now, found, since_told)
    solid = _by_solid(belief, now, found.s, since_told)
    return found if solid is None else _both(found, solid.measured)


def _by_outline(belief: Belief, view: Observation, knob: KnobOutline, s_expected: float) -> Measurement:
    """How far a knob with spokes has turned, by its outline in colour.

    Raises:
        SceneError: It is not seen.
    """
    sense = float(np.sign(belief.template.axis[2]))
    turned = turned_outline(knob, view.capture.frame, sense * s_expected)
    if turned is None:
        raise SceneError("the outline of the knob is not seen where it should be; is it hidden?")
    s = sense * (turned.angle - knob.angle)
    return Measurement(s, KNOB_SIGMA_RAD, EDGE_M, turned.explained)


def state_in(belief: Belief, view: Observation, zero: Observation) -> float:
    """Joint value in an earlier view [m or rad]: 0 in the one that joint values count from, else measured.

    Raises:
        SceneError: The part is not seen.
    """
    return 0.0 if view is zero else measure_in(belief, view, 0.0, nearest=False).s


def state_if_seen(belief: Belief, view: Observation, zero: Observation) -> float | None:
    """The same, None where the part is not seen."""
    try:
        return state_in(belief, view, zero)
    except SceneError:
        return None


def _with_colour(belief: Belief, now: DepthView, found: Measurement, since_told: bool) -> Measurement:
    """With what edges in colour tell of the turn since one of the views that told the joint."""
    told = belief.estimate
    since, part, s = (
        (told.view_after, told.parts.after, told.delta)
        if since_told
        else (told.view_before, told.parts.before, 0.0)
    )
    if not isinstance(since, DepthView) or since.shape != now.shape:
        return found
    seen = turn_by_colour(since, part, now, replace(belief.template.motion, delta=found.s - s))
    if seen is None:
        return found
    spread = found.sigma if np.isfinite(found.sigma) else 0.0
    depth = Turn(found.s - s, float(np.hypot(spread, DEPTH_ERRS_M / belief.template.reach_m)))
    both = combined(depth, seen)
    return replace(found, s=s + both.delta, sigma=both.sigma)


@dataclass(frozen=True)
class _Solid:
    """What a lever's outline tells: its state, and whether the solid explains the looks so well that this will do."""

    measured: Measurement
    explained: bool


def _by_solid(belief: Belief, now: DepthView, s_expected: float, since_told: bool) -> _Solid | None:
    """None where an outline did not tell the joint, or is not found again."""
    told, before, after = belief.estimate, belief.estimate.view_before, belief.estimate.view_after
    if told.lever is None or not isinstance(before, DepthView) or not isinstance(after, DepthView):
        return None
    low, high = told.intervals90.delta
    outline = LeverOutline(told.motion, 0.5 * (high - low) / Z90, told.lever)
    looks = (before, told.parts.before), (after, told.parts.after)
    seen = turns_since(outline, looks, now, s_expected)
    if seen is None:
        return None
    since, s = (seen.since_second, told.delta) if since_told else (seen.since_first, 0.0)
    return _Solid(Measurement(s + since.delta, since.sigma, EDGE_M, seen.found), seen.explained)


def _both(points: Measurement, solid: Measurement) -> Measurement:
    """A lever's state by depth and edges in colour, and by the solid.

    Taking the one or the other, as the solid explains a look well enough or not, made looks at one state differ by a
    degree, from which a run then learnt what was not so.
    """
    spread = points.sigma if np.isfinite(points.sigma) else UNTOLD_RAD
    told = combined(Turn(points.s, float(np.hypot(spread, WITHOUT_SOLID_RAD))), Turn(solid.s, solid.sigma))
    return replace(solid, s=told.delta, sigma=told.sigma)
