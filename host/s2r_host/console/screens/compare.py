"""Screen Compare: two recordings of the same motion on one time base, residual by joint and time, jump to the worst."""

from __future__ import annotations

import numpy as np
import viser
import viser.uplot as uplot

from s2r_host.console import markup as ui
from s2r_host.console.context import Context, Event
from s2r_host.console.playback import Opened
from s2r_host.console.run_index import RunEntry
from s2r_host.log.diff import Difference, MotionDifference, diff
from s2r_host.log.tables import read_recording
from s2r_host.log.twin_run import twin_difference
from s2r_protocol.exits import RefusedError

TWIN = "its twin (nominal model)"
_NONE = "no run"
_POINTS = 600


class CompareScreen:
    """The comparison is made when asked for; it reads whole recordings."""

    def __init__(self, context: Context) -> None:
        self._context = context
        gui = context.server.gui
        self._first = gui.add_dropdown("run", (_NONE,), initial_value=_NONE)
        self._second = gui.add_dropdown("with", (TWIN,), initial_value=TWIN)
        compare = gui.add_button("Compare", icon=viser.Icon.ARROWS_DIFF)
        self._motion = gui.add_dropdown("motion", ("–",), initial_value="–", visible=False)
        self._summary = gui.add_html(ui.block(ui.line("Choose two runs, or a run and its twin.")))
        self._joint = gui.add_dropdown("joint", context.arm.joint_names, visible=False)
        series = (
            uplot.Series(label="t [s]"),
            uplot.Series(label="residual [mrad]", stroke=ui.BAD, width=1.4),
        )
        self._plot = gui.add_uplot(
            (np.zeros(2), np.zeros(2)),
            series,
            title="residual [mrad]",
            scales={"x": uplot.Scale(time=False)},
            height=200,
            visible=False,
        )
        self._to_worst = gui.add_button(
            "Jump to the worst in 3D", icon=viser.Icon.TARGET_ARROW, color="orange", visible=False
        )
        context.on_click(compare, self._compare)
        context.on_click(self._to_worst, self._jump)
        self._motion.on_update(lambda _: self._show())
        self._joint.on_update(lambda _: self._draw())
        self._found: Difference | None = None
        self._entries: dict[str, RunEntry] = {}

    def refresh_list(self) -> None:
        """Offer the runs of the index."""
        entries = self._context.runs.find()
        self._entries = {entry.name: entry for entry in entries}
        names = tuple(self._entries)
        if names and self._first.options != names:
            self._first.options = names
            self._second.options = (TWIN, *names)

    def _compare(self, event: Event) -> str:
        first = self._entry(str(self._first.value))
        a = read_recording(first.folder / "run.mcap")
        if self._second.value == TWIN:
            self._found = twin_difference(a, self._context.arm)
        else:
            second = self._entry(str(self._second.value))
            self._found = diff(a, read_recording(second.folder / "run.mcap"))
        if not self._found.motions:
            raise RefusedError("the two runs have no motion of the same name")
        labels = tuple(dict.fromkeys(m.label for m in self._found.motions))
        self._motion.options = labels
        worst = max(self._found.motions, key=lambda m: abs(m.worst[2]))
        self._motion.value = worst.label
        self._motion.visible = self._joint.visible = self._plot.visible = self._to_worst.visible = True
        self._joint.value = self._context.arm.joint_names[worst.worst[0]]
        self._show()
        return f"{len(self._found.motions)} motions compared; the worst is in '{worst.label}'"

    def _entry(self, name: str) -> RunEntry:
        if name not in self._entries:
            raise RefusedError("no run is chosen")
        return self._entries[name]

    def _chosen(self) -> MotionDifference | None:
        if self._found is None:
            return None
        return next((m for m in self._found.motions if m.label == self._motion.value), None)

    def _show(self) -> None:
        motion = self._chosen()
        if motion is None:
            return
        joint, t_s, residual = motion.worst
        names = self._context.arm.joint_names
        rows = [(n, f"{1e3 * r:.3f}") for n, r in zip(names, motion.rms_rad, strict=True)]
        self._summary.content = ui.block(
            ui.heading(f"{motion.label}: {motion.duration_a_s:.2f} s and {motion.duration_b_s:.2f} s"),
            ui.heat_map(motion.residual, names, float(motion.t[-1]), "mrad", 1e3),
            ui.line(f"worst: {1e3 * residual:+.3f} mrad on {names[joint]} at {t_s:.2f} s", ui.INK, 13.5),
            ui.heading("RMS residual [mrad]"),
            ui.table([n for n, _ in rows], [[v for _, v in rows]]),
        )
        self._draw()

    def _draw(self) -> None:
        motion = self._chosen()
        if motion is None:
            return
        joint = self._context.arm.joint_names.index(str(self._joint.value))
        keep = np.unique(np.linspace(0, len(motion.t) - 1, _POINTS).astype(int))
        self._plot.data = (motion.t[keep], 1e3 * motion.residual[keep, joint])

    def _jump(self, event: Event) -> str:
        motion = self._chosen()
        if motion is None:
            raise RefusedError("compare two runs first")
        joint, t_s, _ = motion.worst
        self._context.playback.open(Opened(motion.label, motion.t, motion.q_a, motion.q_b), t_s)
        name = self._context.arm.joint_names[joint]
        return f"{name} at {t_s:.2f} s; solid: first, blue: second. 'Back to the live arm' is on screen Runs."
