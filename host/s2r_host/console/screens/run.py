"""Screen Run: control, what the arm does and why it does not, how far the run is."""

from __future__ import annotations

from html import escape

import numpy as np
import viser

from s2r_host.console import markup as ui
from s2r_host.console.context import Context, Event, browser_of
from s2r_host.console.live_run import RunSight, cloud_of
from s2r_host.link import CameraLink
from s2r_protocol.keys import ArmKeys

_MARKS = {"begun": ("▶", ui.CALM), "ended": ("✓", ui.GOOD), "failed": ("✗", ui.BAD)}
_LEVELS = {30: ui.WARN, 40: ui.BAD, 50: ui.BAD}
_EVENTS = 7


class RunScreen:
    """Buttons that move need control of this page's browser; the check is the operator's, not the button's."""

    def __init__(self, context: Context, keys: ArmKeys) -> None:
        self._context, self._keys = context, keys
        gui = context.server.gui
        self._control = gui.add_html("")
        take = gui.add_button("Take control", icon=viser.Icon.LOCK_OPEN, disabled=context.operator.view_only)
        back = gui.add_button("Give control back", icon=viser.Icon.LOCK, color="gray")
        with gui.add_folder("Motion", expand_by_default=True):
            self._moving = [
                gui.add_button("Enable drives", icon=viser.Icon.POWER, color="teal"),
                gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE, color="gray"),
                gui.add_button("Resume", icon=viser.Icon.PLAYER_PLAY, color="gray"),
                gui.add_button("Disable drives", icon=viser.Icon.PLUG_CONNECTED_X, color="gray"),
                gui.add_button("Reset a latched fault", icon=viser.Icon.REFRESH, color="gray"),
            ]
            self._speed = gui.add_slider("speed", min=0.05, max=1.0, step=0.05, initial_value=1.0)
        with gui.add_folder("View", expand_by_default=False):
            self.show_plan = gui.add_checkbox("reference (blue)", True)
            self.show_twin = gui.add_checkbox("twin (green)", True)
            self.show_cloud = gui.add_checkbox("cloud and axis", True)
            look = gui.add_button("Take a picture now", icon=viser.Icon.CAMERA, color="gray")
        self._stages = gui.add_html("")
        self._events = gui.add_html("")
        context.on_click(take, self._take)
        context.on_click(back, self._give_back)
        acts = ("arm_drives", "pause", "resume", "disarm", "reset")
        for button, act in zip(self._moving, acts, strict=True):
            context.on_click(button, lambda event, act=act: self._command(event, act))
        self._speed.on_update(context.guarded("speed", self._set_speed))
        context.on_click(look, self._look)

    def refresh(self, sight: RunSight | None) -> None:
        """Bring texts up to date."""
        operator = self._context.operator
        mine = operator.controller
        if operator.view_only:
            stops = "STOP works." if operator.can_stop else "It cannot stop it either: use 's2r stop'."
            text = f"View only: this console cannot move the arm. {stops}"
        elif mine is None:
            text = "Viewing. Nobody in this console has control; STOP works without."
        else:
            lease = " and the lease" if operator.has_lease else ""
            lease = "; a run started here has the lease" if operator.lent else lease
            text = f"Browser {mine} has control{lease}."
        _put(self._control, ui.block(ui.line(text, ui.INK)))
        idle = mine is None or operator.lent
        for button in self._moving:
            if button.disabled != idle:
                button.disabled = idle
        if self._speed.disabled != idle:
            self._speed.disabled = idle
        _put(self._stages, _stages(sight))
        _put(self._events, self._event_lines())

    def _event_lines(self) -> str:
        rows = [
            f'<div style="color:{_LEVELS.get(int(e["level"]), ui.SOFT)};font-size:12px;margin-top:2px">'
            f"{escape(e['msg'])}</div>"
            for e in self._context.feed.events(_EVENTS)
        ]
        return ui.block(ui.heading("Executor events, newest first"), *rows) if rows else ""

    def _take(self, event: Event) -> str:
        self._context.operator.take_control(browser_of(event))
        if self._context.operator.lent:
            return "This page may cancel the run that was started here, and move the arm when that has ended."
        return "This page may move the arm now. It stops by itself when the page closes."

    def _give_back(self, event: Event) -> str:
        self._context.operator.give_back(browser_of(event))
        return "Viewing again."

    def _command(self, event: Event, act: str) -> None:
        self._context.operator.command(browser_of(event), lambda link: getattr(link, act)())

    def _set_speed(self, event: Event) -> None:
        if event.client_id is not None:  # not our own refresh
            scale = float(self._speed.value)
            self._context.operator.command(browser_of(event), lambda link: link.set_speed(scale))

    def _look(self, event: Event) -> str:
        with CameraLink(self._context.camera, self._keys, connect_timeout_s=2.0) as camera:
            frame = camera.capture().frame
        points, seen = cloud_of(frame.depth_m, frame.K, frame.X_base_camera)
        colours = None if frame.colour is None else np.asarray(frame.colour)[seen]
        self._context.scene.show_cloud(points, colours)
        return f"{len(points)} points"


def _stages(sight: RunSight | None) -> str:
    if sight is None:
        return ""
    rows = []
    for stage in sight.stages[-12:]:
        mark, colour = _MARKS.get(stage.phase, ("·", ui.SOFT))
        note = f' <span style="color:{ui.SOFT}">{escape(stage.note)}</span>' if stage.note else ""
        rows.append(
            f'<div style="margin-top:2px"><span style="color:{colour};font-weight:700">{mark}</span> '
            f"{escape(stage.name)}{note}</div>"
        )
    state = "ended" if sight.ended else "under way"
    if sight.outcome:
        rows.append(ui.line(sight.outcome, ui.INK, 13.5))
    return ui.block(ui.heading(f"Run {sight.folder.name}, {state}"), *rows)


def _put(handle, content: str) -> None:  # noqa: ANN001 - viser's handle
    if handle.content != content:
        handle.content = content
