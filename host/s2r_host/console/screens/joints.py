"""Screen Joints: position, speed and torque of every joint in its limits, and the following error lately."""

from __future__ import annotations

from html import escape

import numpy as np
import viser.uplot as uplot

from s2r_host.console import markup as ui
from s2r_host.console.context import Context

_COLOURS = ("#3b6fb6", "#d9722e", "#2f8f54", "#c0264b", "#7a5cb0", "#8a6d3b", "#4a9aa8")
_PLOT_POINTS = 400


class JointsScreen:
    """Bands at 5 Hz, plots at 1 Hz."""

    def __init__(self, context: Context) -> None:
        self._context = context
        gui = context.server.gui
        self._bands = gui.add_html(ui.block(ui.line("waiting for joint states")))
        names = context.arm.joint_names
        empty = tuple(np.zeros(2) for _ in range(len(names) + 1))
        lines = [
            uplot.Series(label=name, stroke=_COLOURS[i % len(_COLOURS)], width=1.4)
            for i, name in enumerate(names)
        ]
        series = (uplot.Series(label="t [s]"), *lines)
        scales = {"x": uplot.Scale(time=False)}
        self._error = gui.add_uplot(
            empty, series, title="following error [mrad], last 20 s", scales=scales, height=210
        )
        self._torque = gui.add_uplot(empty, series, title="torque [N·m]", scales=scales, height=210)

    def refresh(self) -> None:
        """The bands."""
        measured = self._context.feed.newest_joints()
        reference = self._context.feed.newest_joints("joint_commands")
        if measured is None:
            return
        limits = self._context.arm.limits
        q, dq = np.asarray(measured["position"]), np.asarray(measured["velocity"])
        tau = np.asarray(measured["effort"])
        q_ref = np.asarray(reference["position"]) if reference is not None else q
        rows = []
        for i, name in enumerate(self._context.arm.joint_names):
            middle = 0.5 * (limits.q_min[i] + limits.q_max[i])
            used = abs(q[i] - middle) / (0.5 * (limits.q_max[i] - limits.q_min[i]))
            rows.append(f'<div style="font-weight:650;margin-top:9px">{escape(name)}</div>')
            rows.append(_row("q", f"{q[i]:+.4f} rad", used, q[i], limits.q_min[i], limits.q_max[i], q_ref[i]))
            top = limits.dq_max[i]
            rows.append(_row("dq", f"{dq[i].round(3) + 0.0:+.3f} rad/s", abs(dq[i]) / top, dq[i], -top, top))
            if len(tau):
                top = limits.tau_max[i]
                rows.append(_row("tau", f"{tau[i]:+.2f} N·m", abs(tau[i]) / top, tau[i], -top, top))
        content = ui.block(*rows)
        if self._bands.content != content:
            self._bands.content = content

    def refresh_plots(self) -> None:
        """The plots."""
        measured, reference = self._context.feed.recent(), self._context.feed.recent("joint_commands")
        if measured is None or reference is None or len(measured.t) < 3:
            return
        keep = np.unique(np.linspace(0, len(measured.t) - 1, _PLOT_POINTS).astype(int))
        seconds = (measured.stamp_ns[keep] - measured.stamp_ns[-1]) * 1e-9
        t_reference = (reference.stamp_ns - measured.stamp_ns[-1]) * 1e-9
        error = [
            1e3 * (measured.q[keep, i] - np.interp(seconds, t_reference, reference.q[:, i]))
            for i in range(measured.q.shape[1])
        ]
        self._error.data = (seconds, *error)
        if measured.tau is not None:
            self._torque.data = (seconds, *measured.tau[keep].T)


def _row(
    name: str, text: str, used: float, value: float, low: float, high: float, ghost: float | None = None
) -> str:
    colour = ui.BAD if used > 0.95 else ui.WARN if used > 0.8 else ui.SOFT
    return (
        '<div style="display:grid;grid-template-columns:26px 92px 1fr 44px;gap:8px;align-items:center;'
        f'font-size:12.5px;font-variant-numeric:tabular-nums"><span style="color:{ui.SOFT}">{name}</span>'
        f"<span>{text}</span>{ui.band(value, low, high, ghost)}"
        f'<span style="color:{colour};text-align:right">{100 * used:.0f} %</span></div>'
    )
