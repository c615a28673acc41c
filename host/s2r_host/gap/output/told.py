"""How an answer is told, on the report and on the console's page: its units, and its largest places."""

from __future__ import annotations

from typing import Any

from s2r_host.gap.recordings.units import EFFORT_OF

SHOWN_PLACES, MOST = 3, 0.8  # places in the verdict, and the share of the gap that is enough


def effort_unit(unit: str) -> str:
    """Unit of efforts beside positions in ``unit``, which names two where joints turn and slide."""
    return EFFORT_OF.get(unit, "N·m or N, per joint")


def largest_places(places: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The places that hold most of the gap, the largest first: the one that is named first may have little of it."""
    found: list[dict[str, Any]] = []
    for place in sorted(places, key=lambda p: -p["share"])[:SHOWN_PLACES]:
        if sum(p["share"] for p in found) < MOST:
            found.append(place)
    return found
