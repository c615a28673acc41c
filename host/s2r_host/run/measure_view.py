"""The state of a believed part in a view, new or old."""

from __future__ import annotations

from s2r_host.run.belief import Belief
from s2r_host.run.measure import Measurement, measure_state
from s2r_host.run.observe import Observation

MARGIN_M = 0.03  # of the part's outermost points, beyond the joint's believed range


def measure_in(belief: Belief, view: Observation, s_expected: float) -> Measurement:
    """Fit the joint value of the part in a view; ``s_expected`` breaks ties [m or rad].

    Raises:
        SceneError: The part is not seen.
    """
    (low, high), margin = belief.model.range, MARGIN_M / belief.template.reach_m
    return measure_state(
        belief.template, view.capture.frame, view.arm_mask, (low - margin, high + margin), s_expected
    )


def state_in(belief: Belief, view: Observation, zero: Observation) -> float:
    """Joint value in an earlier view [m or rad]: 0 in the one that joint values count from, else measured.

    Raises:
        SceneError: The part is not seen.
    """
    return 0.0 if view is zero else measure_in(belief, view, 0.0).s
