"""Screen Gap: what `s2r gap` found, with its evidence and the residual before and after."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from s2r_host.console import markup as ui
from s2r_host.console.context import Context
from s2r_host.errors import RecordingError
from s2r_host.gap.output.told import effort_unit, largest_places

_NONE = "no gap answer"
_VERDICTS = {
    "nothing_missing": ("nothing is missing", ui.GOOD),
    "parameter_off": ("a parameter is off", ui.WARN),
    "physics_missing": ("physics is missing", ui.BAD),
    "unknown": ("something unknown is missing", ui.BAD),
    "insufficient": ("the data cannot tell", ui.SOFT),
}


class GapScreen:
    """Answers are looked for below the runs folder."""

    def __init__(self, context: Context) -> None:
        self._context = context
        gui = context.server.gui
        self._choice = gui.add_dropdown("answer", (_NONE,), initial_value=_NONE)
        self._html = gui.add_html("")
        self._choice.on_update(lambda _: self._show())
        self._listed: list[tuple[int, Path]] = []
        self.refresh_list()

    def refresh_list(self) -> None:
        """Offer what is there, and show the chosen one anew when it was written again."""
        root = self._context.runs_root
        paths = (path for depth in range(1, 4) for path in root.glob("/".join(["*"] * depth + ["gap.json"])))
        found = sorted(((path.stat().st_mtime_ns, path) for path in paths), reverse=True)
        if found != self._listed or not self._html.content:
            self._listed = found
            self._choice.options = tuple(str(path.parent.relative_to(root)) for _, path in found) or (_NONE,)
            self._show()

    def _show(self) -> None:
        if self._choice.value == _NONE:
            text = f"No gap.json below {self._context.runs_root}. Make one with 's2r gap --out DIR'."
            self._html.content = ui.block(ui.line(text))
            return
        folder = self._context.runs_root / str(self._choice.value)
        try:
            self._html.content = answer_markup(folder)
        except RecordingError as error:
            self._html.content = ui.block(ui.line(str(error), ui.BAD))


def answer_markup(folder: Path) -> str:
    """The answer in a folder as a page.

    Raises:
        RecordingError: There is none, or it has another form, as that of another release may have.
    """
    path = folder / "gap.json"
    answer = read_answer(path)
    try:
        return gap_markup(answer, folder)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise RecordingError(
            f"{path} is no answer of 's2r gap' as this release writes it ({type(error).__name__}: {error}); "
            f"look at {folder / 'report.html'}, or ask 's2r gap' again"
        ) from error


def read_answer(path: Path) -> dict[str, Any]:
    """A gap answer.

    Raises:
        RecordingError: It is missing or none.
    """
    try:
        answer = json.loads(path.read_text())
        answer["verdict"], answer["effects"], answer["where"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RecordingError(f"{path} is no answer of 's2r gap': {error}") from error
    return answer


def gap_markup(answer: dict[str, Any], folder: Path) -> str:
    """The answer as a page."""
    title, colour = _VERDICTS.get(answer["verdict"], (str(answer["verdict"]), ui.SOFT))
    parts = [f'<div style="margin:6px 0">{ui.chip(title, colour)}</div>']
    why = [str(n) for n in answer.get("notes", []) if answer["verdict"] == "insufficient"][:1]
    parts += [ui.line(text, ui.INK, 13.5) for text in why]
    for place in [] if why else largest_places(answer["where"]):
        words = place.get("regime", {}).get("words", "")
        parts.append(ui.line(f"on {place['joint']} ({place['share']:.0%} of it), {words}", ui.INK, 13.5))
    parts += _before_after(answer.get("fit", {}))
    parts += _effects(answer["effects"])
    off = answer.get("parameters_off", [])
    if off:
        parts.append(ui.heading("Parameters off"))
        cells = [(_whose(p), f"{p['from']:.4g}", _with_unit(p["to"], p)) for p in off]
        parts.append(ui.table(("parameter", "model", "recordings"), cells))
    parts += _rejected(answer.get("rejected", []))
    following = answer.get("next_experiment") or {}
    if following.get("separates"):
        parts.append(ui.heading(f"Next experiment: {' or '.join(map(str, following['separates']))}?"))
        parts.append(ui.line(f"{following.get('trajectory', '')}: {following.get('why', '')}"))
    for note in answer.get("notes", [])[len(why) : 4]:
        parts.append(ui.line(str(note)))
    parts.append(ui.line(f"report: {folder / 'report.html'}"))
    return ui.block(*parts)


_MILLI = {"rad": "mrad", "m": "mm"}
_FITS = (  # key in the answer, words; effort has a unit of its own
    ("holdout", "position"),
    ("open_loop_holdout", "position, open loop"),
    ("effort_holdout", "effort"),
)


def _before_after(fit: dict[str, Any]) -> list[str]:
    rows = []
    for key, words in _FITS:
        before, after = fit.get(f"{key}_before"), fit.get(f"{key}_after")
        if not isinstance(before, (int, float)) or not isinstance(after, (int, float)):
            continue
        unit, scale = str(fit.get("unit", "")), 1.0
        if key == "effort_holdout":
            unit = effort_unit(unit)
        elif unit in _MILLI:
            unit, scale = _MILLI[unit], 1e3
        rows.append(
            (f"{words} [{unit}]", f"{scale * before:.3g}", f"{scale * after:.3g}", _kept(before, after))
        )
    if not rows:
        return []
    table = ui.table(("rms", "before", "after", "left"), rows, "1fr 72px 72px 56px")
    return [ui.heading("Residual on held-out motion"), table]


def _kept(before: float, after: float) -> str:
    return f"{after / before:.0%}" if before > 0 else "–"


def _effects(effects: list[dict[str, Any]]) -> list[str]:
    if not effects:
        return []
    parts = [ui.heading("Missing physics")]
    for effect in effects:
        sure = f"{effect['name']} on {effect['joint']}, probability {effect['probability']:.2f}"
        parts.append(ui.line(sure, ui.INK, 13.5))
        values = [(name, _interval(p)) for name, p in effect.get("parameters", {}).items()]
        if values:
            parts.append(ui.facts(values))
        others = ", ".join(map(str, effect.get("could_also_be", [])))
        parts.append(ui.line(effect.get("evidence", "") + (f". Could also be: {others}" if others else "")))
    return parts


def _interval(parameter: dict[str, Any]) -> str:
    if not parameter.get("identifiable", True):
        return "not identifiable from this motion"
    low, high = parameter.get("interval90", (None, None))
    span = f" ({low:.4g} to {high:.4g})" if isinstance(low, float) and isinstance(high, float) else ""
    return f"{_with_unit(parameter['value'], parameter)}{span}"


def _with_unit(value: float, entry: dict[str, Any]) -> str:
    unit = str(entry.get("unit", "1"))
    return f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"


def _whose(parameter: dict[str, Any]) -> str:
    """A number that is off, where it is, and what else it may be."""
    place = parameter.get("body", parameter.get("joint"))
    also = ", ".join(map(str, parameter.get("could_also_be", [])))
    return f"{parameter['name']} of {place}" + (f" (could also be: {also})" if also else "")


def _rejected(rejected: list[dict[str, Any]]) -> list[str]:
    if not rejected:
        return []
    by_reason: dict[str, list[str]] = {}
    for r in rejected:
        by_reason.setdefault(str(r.get("why", "")), []).append(str(r["name"]))
    rows = [(", ".join(dict.fromkeys(names)), why) for why, names in by_reason.items()]
    return [ui.heading("Looked at and rejected"), ui.table(("effects", "why"), rows, "1fr 1fr")]
