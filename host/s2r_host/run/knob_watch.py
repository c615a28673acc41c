"""Knobs with spokes in view, and how far each has turned from look to look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from s2r_host.motion.bars import find_bars
from s2r_host.motion.knobs import Knob, find_knobs, find_lying_knobs, knob_deck
from s2r_host.motion.levers import levers_in
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.knob_joint import knob_joint
from s2r_host.perception.knob_outline import (
    SPOKES,
    KnobOutline,
    fit_outline,
    on_its_foot,
    turned_outline,
)
from s2r_host.perception.view import DepthView
from s2r_host.run.observe import Observation

LEAST_TURN_RAD = np.radians(3.0)  # by which a knob has surely turned
STAYS_M = 0.0015  # an axis; what shifts further is a bar that turns about one of its ends, and no knob


class KnobWatch:
    """What of a first look are knobs with spokes, followed through the looks after it.

    Spokes are alike: from one look to the next a knob must turn by less than half their spacing.
    """

    def __init__(self, first: Observation) -> None:
        """Find them."""
        self._first = self._last = first
        self._found: list[KnobOutline] = []
        deck_m = knob_deck(first.scene.p_base)
        for knob in find_knobs(first.scene):
            self._add(_outline(first, knob, deck_m))
        for knob in find_lying_knobs(first.scene):
            self._add(_outline(first, knob, 0.0))
        for bar in find_bars(levers_in(first.scene)):
            outline = _outline(first, bar, deck_m, spokes=(2,))
            if outline is not None and outline.bulges:
                self._add(outline)
        self.now: list[KnobOutline] = list(self._found)
        self._shown = [True] * len(self._found)

    def _add(self, outline: KnobOutline | None) -> None:
        """Follow it, if it is there and not one that is followed already."""
        if outline is not None and not any(one.covers(outline.p_axis[None])[0] for one in self._found):
            self._found.append(outline)

    def look(self, view: Observation) -> None:
        """Follow them into another look; one that is hidden there stays as it was, one that shifts was none."""
        followed = []
        for found, outline in zip(self._found, self.now, strict=True):
            turned = turned_outline(outline, view.capture.frame)
            if turned is None:
                followed.append((found, outline, False))
            elif np.linalg.norm(turned.p_axis - outline.p_axis) < STAYS_M:
                now = replace(outline, angle=turned.angle, explained=turned.explained)
                followed.append((found, now, True))
        self._found, self.now = [found for found, _, _ in followed], [now for _, now, _ in followed]
        self._shown = [shown for _, _, shown in followed]
        self._last = view

    def joint(self) -> JointEstimate | None:
        """The joint of the one that turned furthest since the first look; None where none surely did.

        Where one that is hidden in the newest look stands by now nobody knows: it is left out.
        """
        if not self._found:
            return None
        turns = [
            abs(now.angle - found.angle) if shown else 0.0
            for found, now, shown in zip(self._found, self.now, self._shown, strict=True)
        ]
        k = int(np.argmax(turns))
        if turns[k] < LEAST_TURN_RAD:
            return None
        before, after = (DepthView(view.capture.frame, view.arm_mask) for view in (self._first, self._last))
        return knob_joint(before, after, self._found[k], self.now[k])


def _outline(
    view: Observation, knob: Knob, deck_m: float, spokes: Sequence[int] = SPOKES
) -> KnobOutline | None:
    """Of what may be a knob, on its foot; None where its colours do not tell it."""
    outline = fit_outline(view.capture.frame, knob.p_axis, knob.reach_m, deck_m, spokes)
    return None if outline is None else on_its_foot(outline, view.scene.p_base)
