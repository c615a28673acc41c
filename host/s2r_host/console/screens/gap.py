"""Screen Gap: what `s2r gap` found, with its evidence and the residual before and after."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from s2r_host.console import markup as ui
from s2r_host.console.context import Context
from s2r_host.errors import RecordingError

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
        self.refresh_list()

    def refresh_list(self) -> None:
        """Offer what is there."""
        root = self._context.runs_root
        found = sorted(
            (path for depth in range(1, 4) for path in root.glob("/".join(["*"] * depth + ["gap.json"]))),
            key=lambda path: -path.stat().st_mtime,
        )
        names = tuple(str(path.parent.relative_to(root)) for path in found) or (_NONE,)
        if self._choice.options != names or not self._html.content:
            self._choice.options = names
            self._show()

    def _show(self) -> None:
        if self._choice.value == _NONE:
            text = f"No gap.json below {self._context.runs_root}. Make one with 's2r gap --out DIR'."
            self._html.content = ui.block(ui.line(text))
            return
        folder = self._context.runs_root / str(self._choice.value)
        try:
            self._html.content = gap_markup(read_answer(folder / "gap.json"), folder)
        except RecordingError as error:
            self._html.content = ui.block(ui.line(str(error), ui.BAD))


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
    for place in answer["where"][:1]:
        words = place.get("regime", {}).get("words", "")
        parts.append(ui.line(f"on {place['joint']} ({place['share']:.0%} of it), {words}", ui.INK, 13.5))
    fit = answer.get("fit", {})
    before, after = fit.get("holdout_before"), fit.get("holdout_after")
    rows = [(name, _cell(values)) for name, values in (("before", before), ("after", after)) if values]
    if rows:
        parts += [ui.heading("Residual on held-out motion"), ui.facts(rows)]
    if answer["effects"]:
        parts.append(ui.heading("Missing physics"))
        effects = [
            (e["name"], e["joint"], f"{e['probability']:.2f}", e.get("evidence", ""))
            for e in answer["effects"]
        ]
        parts.append(ui.table(("effect", "joint", "prob.", "evidence"), effects, "110px 52px 40px 1fr"))
    off = answer.get("parameters_off", [])
    if off:
        parts.append(ui.heading("Parameters off"))
        cells = [(p["name"], f"{p['from']:.4g}", f"{p['to']:.4g} {p['unit']}") for p in off]
        parts.append(ui.table(("parameter", "model", "recordings"), cells))
    if answer.get("rejected"):
        names = ", ".join(
            str(r.get("name", r)) if isinstance(r, dict) else str(r) for r in answer["rejected"][:8]
        )
        parts.append(ui.line(f"looked at and rejected: {names}"))
    for note in answer.get("notes", [])[:4]:
        parts.append(ui.line(str(note)))
    parts.append(ui.line(f"report: {folder / 'report.html'}"))
    return ui.block(*parts)


def _cell(values: Any) -> str:
    if isinstance(values, dict):
        return ", ".join(f"{k} {v:.3g}" for k, v in values.items() if isinstance(v, (int, float)))
    return f"{values:.3g}" if isinstance(values, (int, float)) else str(values)
