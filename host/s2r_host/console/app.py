"""The console's page: header and STOP on top, six screens below, one loop that keeps them up to date."""

from __future__ import annotations

import contextlib
import io
import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import viser

from s2r_host.console import markup as ui
from s2r_host.console.context import Context, Event
from s2r_host.console.feed import Feed
from s2r_host.console.jobs import Jobs
from s2r_host.console.live_run import RunSight, RunWatch
from s2r_host.console.operator import Operator
from s2r_host.console.playback import Playback
from s2r_host.console.run_index import RunIndex
from s2r_host.console.scene import Axis, CellScene
from s2r_host.console.screens.compare import CompareScreen
from s2r_host.console.screens.gap import GapScreen
from s2r_host.console.screens.joints import JointsScreen
from s2r_host.console.screens.run import RunScreen
from s2r_host.console.screens.runs import RunsScreen
from s2r_host.console.screens.timing import TimingScreen
from s2r_host.report.arm_shapes import ArmShapes
from s2r_host.twin import Twin
from s2r_protocol.arms import ArmDescription
from s2r_protocol.exits import S2RError
from s2r_protocol.faults import ExecutorState
from s2r_protocol.keys import ArmKeys
from s2r_protocol.session import Role, connect

logger = logging.getLogger(__name__)

FRAME_S = 1 / 30
TEXT_S = 0.2
SLOW_S = 1.0
PANEL_WIDTH = 500
STOP_LABEL = "STOP (software stop; key: space)"
NO_STOP_LABEL = "No STOP here: this page only reads"
_SAID_AGAIN_S = 5.0
_APART_RAD = 4e-3  # a ghost nearer than this only muddies the arm it hides in


class Console:
    """One console for one arm. ``start`` returns at once; ``close`` ends everything."""

    def __init__(
        self,
        arm: ArmDescription,
        keys: ArmKeys,
        endpoint: str,
        camera: str,
        runs_root: Path,
        tls: Path | None = None,
        view_only: bool = False,
    ) -> None:
        role = Role.MONITOR if view_only and tls is not None else Role.HOST
        self._keys = keys
        self._session = connect(endpoint, role, keys, tls, may_come_later=True)
        self._feed = Feed(self._session, f"/{keys.base}")
        self._operator = Operator(endpoint, arm, keys, tls, view_only)
        self._twin = Twin(arm)
        self._runs = RunIndex(runs_root)
        self._watch = RunWatch(runs_root)
        self._sight: RunSight | None = None
        self._followed: Path | None = None  # the run whose cloud and axis are shown
        self._shown_views = 0
        self._shown_plan = 0.0
        self._ended = threading.Event()
        self._said: dict[Callable[[], None], float] = {}  # when a part that fails was told of [s]
        with contextlib.redirect_stdout(
            io.StringIO()
        ):  # it prints its inner address, which is not the operator's
            self._server = viser.ViserServer("127.0.0.1", port=0, label=f"s2r {keys.base}", verbose=False)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(59, 111, 182))
        self._server.gui.main_panel.dock_right()
        self._server.gui.main_panel.set_width(PANEL_WIDTH)
        self._server.gui.set_panel_label(f"s2r console   {keys.base}")
        self._context = Context(
            self._server,
            arm,
            self._feed,
            self._operator,
            CellScene(self._server, ArmShapes(arm)),
            Playback(),
            self._runs,
            Jobs(),
            endpoint,
            camera,
            {
                "--executor": endpoint,
                "--camera": camera,
                "--cell": keys.cell,
                "--tls": None if tls is None else str(tls),
            },
            runs_root,
        )
        self._build()
        self._server.on_client_disconnect(lambda client: self._operator.give_back(client.client_id))
        self._threads = [
            threading.Thread(target=self._repeat, args=(act, period_s), name=name, daemon=True)
            for name, act, period_s in (
                ("s2r-console-3d", self._draw, FRAME_S),
                ("s2r-console-text", self._write, TEXT_S),
                ("s2r-console-slow", self._slow, SLOW_S),
            )
        ]

    @property
    def port(self) -> int:
        """viser's own port on loopback; browsers come through the gate."""
        return self._server.get_port()

    def start(self) -> None:
        """Begin to keep the page up to date."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Give the lease back, end jobs, close everything."""
        self._ended.set()
        for thread in self._threads:
            if thread.is_alive():  # none was started when the page's address is taken
                thread.join()
        self._context.jobs.close()
        self._operator.close()
        self._server.stop()
        self._feed.close()
        self._session.close()
        self._runs.close()

    def _build(self) -> None:
        gui, context = self._server.gui, self._context
        self._header = gui.add_html(ui.block(ui.line("connecting")))
        stop = gui.add_button(
            STOP_LABEL if self._operator.can_stop else NO_STOP_LABEL,
            color="red",
            icon=viser.Icon.HAND_STOP,
            disabled=not self._operator.can_stop,
        )
        stop.on_click(context.at_once("STOP", self._stop))
        command = gui.add_command("STOP (software stop)", hotkey="space", icon=viser.Icon.HAND_STOP)
        command.on_trigger(context.at_once("STOP", self._stop))  # type: ignore[arg-type]
        gui.add_html(
            ui.styles()
            + ui.block(ui.line("Software, no performance level: the emergency stop is hardware.", size_px=12))
        )
        tabs = gui.add_tab_group()
        with tabs.add_tab("Run"):
            self._run = RunScreen(context, self._keys)
        with tabs.add_tab("Joints"):
            self._joints = JointsScreen(context)
        with tabs.add_tab("Timing"):
            self._timing = TimingScreen(context)
        with tabs.add_tab("Runs"):
            self._runs_screen = RunsScreen(context)
        with tabs.add_tab("Compare"):
            self._compare = CompareScreen(context)
        with tabs.add_tab("Gap"):
            self._gap = GapScreen(context)

    def _stop(self, event: Event) -> str:
        return self._operator.stop()

    # -- the loops ------------------------------------------------------------------------------------

    def _repeat(self, act: Callable[[], None], period_s: float) -> None:
        while not self._ended.wait(period_s):
            self._each(act)

    def _each(self, *acts: Callable[[], None]) -> None:
        """Carry out all, each whatever becomes of the others; a part that fails says so, but not 30 times a second."""
        for act in acts:
            try:
                act()
            except Exception:
                now = time.monotonic()
                if now - self._said.get(act, float("-inf")) > _SAID_AGAIN_S:
                    self._said[act] = now
                    logger.exception("the console could not update a part of the page")

    def _draw(self) -> None:
        scene = self._context.scene
        with self._server.atomic():
            shown = self._context.playback.pose()
            if shown is not None:
                scene.real.visible = True
                scene.real.show(shown[0])
                scene.twin.visible = False
                scene.plan.visible = (
                    shown[1] is not None
                    and bool(self._run.show_plan.value)
                    and bool(np.abs(shown[1] - shown[0]).max() > _APART_RAD)
                )
                if shown[1] is not None and scene.plan.visible:
                    scene.plan.show(shown[1])
                return
            q = self._feed.q()
            if q is None:
                scene.real.visible = scene.plan.visible = scene.twin.visible = False
                return
            scene.real.visible = True
            scene.real.show(q)
            reference = self._feed.newest_joints("joint_commands")
            if reference is None:
                return
            q_ref, dq_ref = np.asarray(reference["position"]), np.asarray(reference["velocity"])
            scene.plan.visible = bool(self._run.show_plan.value) and bool(
                np.abs(q_ref - q).max() > _APART_RAD
            )
            if scene.plan.visible:
                scene.plan.show(q_ref)
            q_twin = self._twin.follow(time.monotonic(), q_ref, dq_ref)
            scene.twin.visible = bool(self._run.show_twin.value) and bool(
                np.abs(q_twin - q).max() > _APART_RAD
            )
            if scene.twin.visible:
                scene.twin.show(q_twin)

    def _write(self) -> None:
        self._each(self._write_header, self._write_run, self._joints.refresh, self._runs_screen.refresh_texts)

    def _write_header(self) -> None:
        content = self._header_markup()
        if self._header.content != content:
            self._header.content = content

    def _write_run(self) -> None:
        self._run.refresh(self._sight)

    def _slow(self) -> None:
        self._each(
            self._keep_connected,
            self._joints.refresh_plots,
            self._timing.refresh,
            self._runs_screen.refresh_list,
            self._compare.refresh_list,
            self._gap.refresh_list,
            self._follow_run,
            self._show_plan_path,
        )

    def _keep_connected(self) -> None:
        if not self._feed.health().alive:
            if self._operator.connected and self._feed.health().age_s > 2.0:
                self._operator.executor_changed()
            return
        try:
            self._operator.connect()
        except S2RError as error:
            logger.warning("no command link yet: %s", error)

    def _follow_run(self) -> None:
        self._sight = sight = self._watch.look()
        if sight is None or self._context.playback.opened is not None:
            self._followed = None
            return
        scene = self._context.scene
        if sight.folder != self._followed:  # whatever is shown now is another run's
            scene.clear_object()
            self._followed, self._shown_views = sight.folder, 0
        if sight.cloud is not None and sight.views != self._shown_views:
            self._shown_views = sight.views
            scene.show_cloud(sight.cloud, sight.colours)
        if sight.axis is not None:
            scene.show_axis(Axis(*sight.axis))
        scene.show_cloud_visible(bool(self._run.show_cloud.value))

    def _show_plan_path(self) -> None:
        plan = self._feed.plan()
        received_s = 0.0 if plan is None else plan.received_s
        if received_s != self._shown_plan:
            self._shown_plan = received_s
            self._context.scene.show_path(None if plan is None else plan.q)

    def _header_markup(self) -> str:
        state, health, plan = self._feed.state(), self._feed.health(), self._feed.plan()
        playing = self._context.playback.opened
        shown = [] if playing is None else [("3D shows", f"{playing.name}, not the live arm")]
        if state is None:
            text = f"No executor heard at {self._context.endpoint} yet. Start it with 's2r executor'."
            return ui.block(
                f'<div style="margin-top:6px">{ui.chip("NO LINK", ui.BAD)}</div>',
                ui.line(text),
                ui.facts(shown),
            )
        name = ExecutorState(int(state["state"])).name
        link = f"{health.rate_hz:.0f} states/s, newest {1e3 * health.age_s:.0f} ms old"
        if not health.alive:
            text = (
                f"The executor is silent for {health.age_s:.1f} s. Use the emergency stop if the arm moves."
            )
            return ui.block(
                f'<div style="margin-top:6px">{ui.chip("LINK LOST", ui.BAD)}</div>',
                ui.line(text, ui.BAD, 14),
                ui.facts(shown),
            )
        rows = [("lease", state["lease_holder"] or "nobody"), ("link", link)]
        bar = ""
        if plan is not None:
            age = self._feed.now_s() - plan.received_s
            duration = float(plan.t[-1])
            done = duration if state["plan_done"] else float(state["plan_t"])
            rows.append(("plan", f"'{plan.label}', {done:.2f} of {duration:.2f} s, {age:.0f} s old"))
            bar = ui.progress(done / max(duration, 1e-9), ui.GOOD if name == "RUN" else ui.CALM)
        if float(state["speed_scale"]) != 1.0:
            rows.append(("speed", f"{float(state['speed_scale']):.0%} of planned"))
        return ui.block(
            f'<div style="margin-top:6px">{ui.chip(name, ui.STATE_COLOURS[name])}</div>',
            ui.line(state["why_not_moving"], ui.INK, 14),
            bar,
            ui.facts(rows + shown),
        )
