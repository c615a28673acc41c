"""Answers against the sealed truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gap_objects.hidden import HIDDEN

Row = dict[str, Any]
FINE = ("nothing_missing", "parameter_off")
STOP = "soft_end_stop"
OPEN = ("insufficient", "refused", "no recordings")
JUDGED = ("first", "set", "wrong", "unknown", "missed", "open", "alarm", "fine")


def judged(effect: str, answer: Row, at_stop: bool) -> str:
    """One of ``JUDGED``: how an answer stands to what is hidden.

    ``first``: the first name is right; ``set``: another of the answer's names is; ``wrong``: none is; ``unknown``:
    something without a name; ``missed``: nothing, or a number that is off; ``open``: the data cannot tell. Where
    nothing is hidden: ``fine``, ``alarm`` or ``open``. A stop is no alarm where the part was pushed against one.
    """
    names, verdict = HIDDEN[effect].names, answer["verdict"]
    if verdict in OPEN:
        return "open"
    named = [name for name, _, _ in answer["effects"] if not (at_stop and name == STOP)]
    if not names:
        return "fine" if verdict in FINE or (answer["effects"] and not named) else "alarm"
    if verdict in FINE:
        return "missed"
    if verdict == "unknown":
        return "unknown"
    sets = [{name, *also} for name, also, _ in answer["effects"]]
    if named and named[0] in names:
        return "first"
    return "set" if any(names_of & set(names) for names_of in sets) else "wrong"


def table(rows: Sequence[Row]) -> list[str]:
    """A Markdown table: per effect, how often it was answered how."""
    lines = ["| hidden | objects | " + " | ".join(JUDGED) + " |", "|---|---|" + "---|" * len(JUDGED)]
    for effect in (*HIDDEN, None):
        some = [row for row in rows if effect in (None, row["effect"])]
        if some:
            said = [row["judged"] for row in some]
            counts = " | ".join(str(said.count(one) or "") for one in JUDGED)
            lines.append(f"| {effect or '**all**'} | {len(some)} | {counts} |")
    return lines


def brief(answer: Row) -> str:
    """An answer in a line."""
    names = [
        f"{name} {p:.2f}" + (f" (or {', '.join(also)})" if also else "")
        for name, also, p in answer["effects"]
    ]
    return f"{answer['verdict']}: {', '.join([*names, *answer['parameters_off']])}"
