"""Screen Runs: the history, found by words; open one, replay it on the stand-in, run it again."""

from __future__ import annotations

import time
from collections.abc import Mapping

import viser

from s2r_host.console import markup as ui
from s2r_host.console.context import Context, Event, browser_of
from s2r_host.console.live_run import sight_of
from s2r_host.console.playback import Opened, packed
from s2r_host.console.run_index import RunEntry
from s2r_host.console.scene import Axis
from s2r_host.errors import RecordingError
from s2r_host.log.tables import read_recording
from s2r_protocol.exits import RefusedError
from s2r_protocol.targets import DEGREE, MILLIMETRE

_NONE = "no run"
_SHOWN = 12


class RunsScreen:
    """The list is read from the index when the screen is refreshed."""

    def __init__(self, context: Context) -> None:
        self._context = context
        gui = context.server.gui
        self._filter = gui.add_text("filter", initial_value="", hint="Words of folder, outcome or reason.")
        self._list = gui.add_html("")
        self.choice = gui.add_dropdown("run", (_NONE,), initial_value=_NONE)
        self._details = gui.add_html("")
        open_ = gui.add_button("Open in 3D", icon=viser.Icon.PLAYER_PLAY)
        self._time = gui.add_slider("time [s]", min=0.0, max=1.0, step=0.01, initial_value=0.0, visible=False)
        self._live = gui.add_button(
            "Back to the live arm", icon=viser.Icon.BROADCAST, color="gray", visible=False
        )
        replay = gui.add_button("Replay on the stand-in", icon=viser.Icon.REPEAT, color="gray")
        again = gui.add_button(
            "Run again on this arm",
            icon=viser.Icon.ROCKET,
            color="orange",
            disabled=context.operator.view_only,
        )
        self._cancel_job = gui.add_button("Cancel the job", icon=viser.Icon.X, color="gray", visible=False)
        self._job = gui.add_html("")
        self._filter.on_update(lambda _: self.refresh_list())
        self.choice.on_update(lambda _: self._show_details())
        self._time.on_update(lambda _: context.playback.seek(float(self._time.value)))
        context.on_click(open_, self._open)
        context.on_click(self._live, self._back)
        context.on_click(replay, self._replay)
        context.on_click(again, self._again)
        context.on_click(self._cancel_job, self._cancel)
        self._entries: dict[str, RunEntry] = {}
        self._on_show: Opened | None = None
        self.refresh_list()

    def refresh_list(self) -> None:
        """Look for runs and show those that match the filter."""
        self._context.runs.refresh()
        found = self._context.runs.find(self._filter.value)
        self._entries = {entry.name: entry for entry in reversed(found)}
        names = tuple(entry.name for entry in found) or (_NONE,)
        if self.choice.options != names:
            chosen = self.choice.value
            self.choice.options = names
            if chosen in names:
                self.choice.value = chosen
        rows = [
            (
                _ago(e.ended),
                e.name,
                joint_value(e.target, e.unit),
                joint_value(e.delta, e.unit),
                e.outcome.lower(),
            )
            for e in found[:_SHOWN]
        ]
        header = ("ended", "run", "target", "δ", "outcome")
        content = ui.block(
            ui.table(header, rows, "56px 1fr 82px 72px 84px") if rows else ui.line(self._nothing()),
            *self._more(len(found)),
        )
        if self._list.content != content:
            self._list.content = content
            self._show_details()

    def _more(self, offered: int) -> list[str]:
        """That there are more runs than rows, and where the others are."""
        if offered <= _SHOWN:
            return []
        total = self._context.runs.count(str(self._filter.value))
        others = (
            "choose any below"
            if total == offered
            else f"the newest {offered} are below, the filter finds any"
        )
        return [ui.line(f"the newest {_SHOWN} of {total}; {others}")]

    def _nothing(self) -> str:
        words = str(self._filter.value).strip()
        return f"no run matches '{words}'" if words else f"no runs below {self._context.runs_root} yet"

    def refresh_texts(self) -> None:
        """The time of the recording on show, whichever screen has opened it, and the end of the job's output."""
        playback, jobs = self._context.playback, self._context.jobs
        if playback.opened is not self._on_show:
            self._on_show = opened = playback.opened
            self._time.visible = self._live.visible = opened is not None
            if opened is not None:
                self._time.max = max(float(opened.t[-1]), 0.02)
                self._time.value = playback.t
        if self._cancel_job.visible != jobs.running:
            self._cancel_job.visible = jobs.running
        lines = "\n".join(jobs.lines[-14:])
        state = "running" if jobs.running else "last job"
        content = ui.block(ui.heading(f"{state}: {jobs.title}"), _preformatted(lines)) if lines else ""
        if self._job.content != content:
            self._job.content = content

    def entry(self) -> RunEntry:
        """The chosen run.

        Raises:
            RefusedError: There is none.
        """
        found = self._entries.get(str(self.choice.value))
        if found is None:
            raise RefusedError("no run is chosen")
        return found

    def _show_details(self) -> None:
        found = self._entries.get(str(self.choice.value))
        if found is None:
            self._details.content = ""
            return
        rows = [
            ("outcome", found.exit),
            ("reason", found.reason),
            ("arm, seed", f"{found.arm}, {found.seed}"),
            ("plans", f"{found.plans} in {found.wall_s:.0f} s"),
            ("report", str(found.folder / "report.html")),
        ]
        self._details.content = ui.block(ui.facts(rows))

    def _open(self, event: Event) -> str:
        entry = self.entry()
        recording = read_recording(entry.folder / "run.mcap")
        try:
            reference = recording.joints("joint_commands")
        except RecordingError:
            reference = None
        opened = packed(recording.joints(), reference, entry.name)
        sight = sight_of(entry.folder / "run.mcap")
        self._context.scene.clear_object()
        if sight.cloud is not None:
            self._context.scene.show_cloud(sight.cloud, sight.colours)
        if sight.axis is not None:
            self._context.scene.show_axis(Axis(*sight.axis))
        self._context.playback.open(opened)
        return f"{entry.name}: {opened.t[-1]:.1f} s of motion; move the time slider"

    def _back(self, event: Event) -> None:
        self._context.playback.open(None)
        self._context.scene.clear_object()

    def _replay(self, event: Event) -> str:
        entry = self.entry()
        out = entry.folder / f"replay-console-{time.strftime('%H%M%S')}"
        self._context.jobs.start(
            f"replay of {entry.name} on the stand-in", ["replay", str(entry.folder), "--out", str(out)]
        )
        return "A stand-in and an executor of its own start; the live arm is not touched."

    def _again(self, event: Event) -> str:
        """The same command with a new folder, in this console's cell."""
        browser = browser_of(event)
        self._context.operator.require(browser)
        entry = self.entry()
        out = self._context.runs_root / time.strftime("again-%Y%m%d-%H%M%S")
        places = {"--out": str(out), **self._context.cell_options}
        arguments = again(entry.arguments, places, entry.told)
        self._context.operator.lend_lease(  # the run takes the lease itself
            browser, lambda: self._context.jobs.start(f"{entry.name} again", arguments)
        )
        return f"The run writes to {out}; STOP ends its motion."

    def _cancel(self, event: Event) -> str:
        self._context.operator.require(browser_of(event)) if self._context.jobs.title.endswith(
            "again"
        ) else None
        self._context.jobs.cancel()
        return "asked to end, as by Ctrl-C"


def again(
    arguments: tuple[str, ...], places: Mapping[str, str | None], told: float | None = None
) -> list[str]:
    """A run's command line with other places, and with the target that it asked for: nobody answers a job.

    Args:
        arguments: The command line.
        places: By option; one that is None is left out.
        told: What the run was told where it asked for its target, counted as ``--target`` [m or rad].

    Raises:
        RefusedError: It was not an ``s2r run``, or it asks for a target and was told none.
    """
    if not arguments or arguments[0] != "run":
        raise RefusedError(
            f"only 's2r run' can be repeated, this was: s2r {' '.join(arguments) or '(unknown)'}"
        )
    kept, skip = [], False
    for word in arguments:
        if skip:
            skip = False
        elif word in places:
            skip = True
        elif not word.startswith(tuple(f"{option}=" for option in places)):
            kept.append(word)
    kept = _with_target(kept, told)
    for option, place in places.items():
        kept += [] if place is None else [option, place]
    return kept


def _with_target(words: list[str], told: float | None) -> list[str]:
    asks = [
        k
        for k, word in enumerate(words)
        if word == "--target=ask" or words[k - 1 : k + 1] == ["--target", "ask"]
    ]
    if asks and told is None:
        raise RefusedError(
            "the run asked for its target (--target ask) and was told none, and nobody can answer a job of this page: "
            "start it in a terminal, or with a number"
        )
    return [word.replace("ask", repr(told)) if k in asks else word for k, word in enumerate(words)]


def _preformatted(text: str) -> str:
    from html import escape

    return (
        '<pre style="font-size:11.5px;white-space:pre-wrap;overflow-wrap:anywhere;background:#f4f6f8;'
        f'border-radius:6px;padding:8px;margin:4px 0">{escape(text)}</pre>'
    )


def joint_value(value: float | None, unit: str) -> str:
    """A value [unit: m or rad] as people read it; a dash where there is none."""
    return "–" if value is None else (DEGREE if unit == "rad" else MILLIMETRE).show(value, digits=1)


def _ago(unix_s: float) -> str:
    seconds = max(0.0, time.time() - unix_s)
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= length:
            return f"{seconds / length:.0f} {unit}"
    return "now"
