"""Screen Timing: how late ticks are, what was missed, and who is to blame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from s2r_host.console import markup as ui
from s2r_host.console.context import Context
from s2r_host.console.feed import Health

_LATE_S = 1e-4
_LOCKSTEP = (
    "In lock-step the arm's time waits for everybody, so no tick is ever late; '--clock real' measures."
)


class TimingScreen:
    """Refreshed at 2 Hz."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._html = context.server.gui.add_html(ui.block(ui.line("waiting for the executor")))

    def refresh(self) -> None:
        """Bring it up to date."""
        state, timing = self._context.feed.state(), self._context.feed.timing()
        if state is None or timing is None:
            return
        count, edge_s = np.asarray(timing["count"], float), np.asarray(timing["edge_s"], float)
        colours = [ui.CALM if e < _LATE_S else ui.WARN if e < 1e-3 else ui.BAD for e in edge_s]
        content = ui.block(
            ui.heading("Lateness of ticks since the executor started"),
            ui.bars([_time(e) for e in edge_s], count.tolist(), [_count(c) for c in count], colours),
            ui.line(
                "each bar: ticks later than its label, up to the next; heights are logarithmic", size_px=12
            ),
            *([ui.line(_LOCKSTEP, size_px=12)] if float(timing["worst_s"]) == 0.0 else []),
            ui.heading("Who is to blame"),
            *(
                ui.line(text, colour, 13.5)
                for text, colour in blame(state, timing, self._context.feed.health())
            ),
            ui.facts(_facts(state, timing)),
        )
        if self._html.content != content:
            self._html.content = content


def blame(state: Mapping[str, Any], timing: Mapping[str, Any], health: Health) -> list[tuple[str, str]]:
    """What goes wrong and whose fault it is, worst first; one green line when nothing does."""
    found: list[tuple[str, str]] = []
    if not health.alive:
        found.append(
            (f"Link: the executor is silent for {health.age_s:.1f} s; process, machine or network.", ui.BAD)
        )
    if state["missed"]:
        found.append((f"Drives or bus: {state['missed']} answers did not come in their tick.", ui.BAD))
    if state["crc_errors"]:
        spoilt = f"{state['crc_errors']} frames with a wrong checksum, length or counter"
        found.append((f"Bus wiring, or another sender on it: {spoilt}.", ui.BAD))
    if state["tx_failed"]:
        found.append((f"Bus interface: {state['tx_failed']} setpoints were not accepted.", ui.BAD))
    if state["overruns"]:
        text = f"This machine: {state['overruns']} ticks were skipped because the loop woke too late."
        found.append((text, ui.WARN if state["realtime"] else ui.BAD))
    if timing["records_dropped"]:
        found.append((f"Front end: {timing['records_dropped']} ticks did not reach the recorder.", ui.WARN))
    if timing["recording_lost_ticks"] or timing["recording_problem"]:
        why = f" ({timing['recording_problem']})" if timing["recording_problem"] else ""
        found.append(
            (
                f"Disk: {timing['recording_lost_ticks']} ticks are in no recording{why}. Motion is unaffected.",
                ui.WARN,
            )
        )
    if not state["realtime"]:
        found.append(
            ("No real-time rights: fine on the stand-in, refused on hardware; see 's2r doctor'.", ui.SOFT)
        )
    if not any(colour in (ui.BAD, ui.WARN) for _, colour in found):
        found.insert(0, ("Nobody: no tick was missed, no frame lost, everything is recorded.", ui.GOOD))
    return found


def _facts(state: Mapping[str, Any], timing: Mapping[str, Any]) -> list[tuple[str, str]]:
    ages = np.asarray(state["feedback_age"])
    return [
        ("ticks", f"{int(timing['ticks']):,}"),
        ("worst", _time(float(timing["worst_s"]))),
        ("bus load", f"{float(state['bus_load']):.0%} (computed, limit 70 %)"),
        ("feedback age", f"{int(ages.max()) if len(ages) else 0} ticks"),
        ("overruns", str(state["overruns"])),
        ("missed", str(state["missed"])),
        ("sending failed", str(state["tx_failed"])),
        ("spoilt frames", str(state["crc_errors"])),
    ]


def _time(seconds: float) -> str:
    if seconds < 1e-6:
        return "0"
    return f"{seconds * 1e6:.0f} µs" if seconds < 1e-3 else f"{seconds * 1e3:.3g} ms"


def _count(value: float) -> str:
    if value >= 1e6:
        return f"{value / 1e6:.1f}M"
    return f"{value / 1e3:.0f}k" if value >= 1e4 else f"{value:.0f}"
