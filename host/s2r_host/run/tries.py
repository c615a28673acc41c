"""What is tried to plan a manipulation, one thing after another, and why what failed did."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

MOST_KINDS = 3  # of reasons that a sentence tells
_FIGURE = re.compile(r"[-+±]?\d[\d.]*")


@dataclass(frozen=True)
class Try:
    """What differs from one try to the next.

    Attributes:
        number: From 0; with the manipulation's number it decides the planner's chance.
        s_target: Where the plan is to end [m or rad].
        doubt: Share of the usual doubt about the object.
        tolerance: What it may miss that by [m or rad]; None: as usual.
        turn_steps: Control steps to turn a part in; None: the planner's own.
        apart: The robot keeps as far from everything as the object may be displaced, where there is room.
    """

    number: int
    s_target: float
    doubt: float
    tolerance: float | None = None
    turn_steps: int | None = None
    apart: bool = False


@dataclass(frozen=True)
class FailedTry:
    """A try that gave no plan: which, for the manipulation of that number, and why not."""

    manipulation: int
    what: Try
    reason: str

    def as_json(self) -> dict[str, Any]:
        """As ``run.json`` has it."""
        return {"manipulation": self.manipulation, **asdict(self.what), "reason": self.reason}


def grouped(reasons: Sequence[str]) -> str:
    """The commonest reasons, and how often they came; those that differ in figures only are told once, as at first."""
    kinds: dict[str, list[str]] = {}
    for reason in reasons:
        kinds.setdefault(_FIGURE.sub("#", reason), []).append(reason)
    ranked = sorted(kinds.values(), key=lambda alike: -len(alike))
    told = [f"{len(alike)} × {alike[0]}" if len(reasons) > 1 else alike[0] for alike in ranked[:MOST_KINDS]]
    if len(ranked) > MOST_KINDS:
        told.append(f"{sum(len(alike) for alike in ranked[MOST_KINDS:])} × something else")
    return "; ".join(told)
