"""``s2r view``: a recording as one HTML file with a 3D player and plots, no network, no server."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from html import escape
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from s2r_host.errors import MissingPartError
from s2r_host.log.arm_of import arm_of, in_arms_order
from s2r_host.log.segments import Segment, segments
from s2r_host.log.tables import Joints, Recording
from s2r_host.report.arm_shapes import ArmShapes
from s2r_host.report.markup import page, section, table
from s2r_host.report.style import EXECUTED, PLANNED, RC, inline_png
from s2r_protocol.cli.outputs import check_place
from s2r_protocol.whole_file import write_whole

FRAMES_HZ = 20.0
MAX_FRAMES = 1200
CLOUD_POINTS = 20_000
_APART_RAD = 4e-3  # a reference nearer than this only muddies the arm it hides in
_PAUSE_S = 0.3


PAUSES = "the player leaves out the pauses between motions"
_HEAD_BYTES = 1 << 16


def is_own_page(path: Path) -> bool:
    """Whether a file is a page that was written here: its first lines say so."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return PAUSES.encode() in file.read(_HEAD_BYTES)


def write_html(
    recording: Recording,
    path: Path,
    arm_name: str | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Path:
    """Write the page; ``tell`` hears what is being done.

    Raises:
        MissingPartError: viser is not installed.
        RecordingError: No joint states, or the arm is unknown.
        UsageError: ``path`` is a folder or lies in none.
    """
    check_place(path)
    tell("decoding joint states")
    arm = arm_of(recording, arm_name)
    joints = in_arms_order(recording.joints(), arm, recording)
    reference = None
    if recording.has_references():
        reference = in_arms_order(recording.joints("joint_commands"), arm, recording)
    found = segments(recording)
    shapes = ArmShapes(arm)
    player = escape(_player(recording, joints, reference, shapes, tell), quote=True)
    tell("plotting")
    name = "/".join(recording.path.absolute().parts[-3:])
    frame = (
        f'<iframe title="the arm in 3D" srcdoc="{player}" '
        'style="width:100%;height:560px;border:1px solid #e2e6eb;border-radius:8px"></iframe>'
    )
    rows = [
        (
            s.label,
            f"{(s.begin_ns - joints.stamp_ns[0]) * 1e-9:.2f} s",
            f"{(s.end_ns - s.begin_ns) * 1e-9:.2f} s",
        )
        for s in found
    ]
    facts = sorted(recording.metadata.get("s2r", {}).items())
    parts = [
        f"<h1>{escape(name)}</h1><p class='lead'>{len(joints.stamp_ns)} joint states, {joints.t[-1]:.2f} s; "
        f"{PAUSES}</p>",
        section("The arm, and in blue its reference where they differ; drag to turn", frame),
        section("Motions", table(("plan", "begins", "takes"), rows)) if rows else "",
        section("Joints", inline_png(_plots(joints, reference, found), "joints over time")),
        section("Facts", table(("", ""), facts, mono=True)) if facts else "",
    ]
    write_whole(path, page(name, parts))
    return path


def _player(
    recording: Recording,
    joints: Joints,
    reference: Joints | None,
    shapes: ArmShapes,
    tell: Callable[[str], None],
) -> str:
    """viser's own offline player of the motion, as HTML."""
    try:
        import viser

        from s2r_host.console.live_run import sight_of
        from s2r_host.console.playback import packed
        from s2r_host.console.scene import Axis, CellScene
    except ImportError as error:
        raise MissingPartError(
            "the 3D page needs the package viser; install it with: pip install 'sim2real2[console]'"
        ) from error
    opened = packed(joints, reference, "")
    step = max(1.0 / FRAMES_HZ, float(opened.t[-1]) / MAX_FRAMES)
    with contextlib.redirect_stdout(io.StringIO()):  # it prints the address of a server nobody needs
        server = viser.ViserServer("127.0.0.1", port=0, verbose=False)
    try:
        scene = CellScene(server, shapes)
        scene.real.visible = True
        scene.real.show(opened.q[0])
        scene.show_path(opened.q[:: max(1, len(opened.q) // 400)])
        sight = sight_of(recording.path)
        if sight.cloud is not None:
            thin = slice(None, None, max(1, len(sight.cloud) // CLOUD_POINTS))
            scene.show_cloud(sight.cloud[thin], None if sight.colours is None else sight.colours[thin])
        if sight.axis is not None:
            scene.show_axis(Axis(*sight.axis))
        recorder = server.get_scene_serializer()
        times = np.arange(0.0, opened.t[-1], step)
        for k, t in enumerate(times):
            tell(f"frame {k + 1} of {len(times)} of the 3D player")
            i = min(int(np.searchsorted(opened.t, t)), len(opened.t) - 1)
            scene.real.show(opened.q[i])
            if opened.q_ref is not None:
                scene.plan.visible = bool(np.abs(opened.q_ref[i] - opened.q[i]).max() > _APART_RAD)
                scene.plan.show(opened.q_ref[i])
            recorder.insert_sleep(step)
        return recorder.as_html(dark_mode=False)
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def _plots(joints: Joints, reference: Joints | None, found: list[Segment]) -> Figure:
    with mpl.rc_context(RC):
        figure = Figure(figsize=(12.5, 1.25 * len(joints.names) + 0.6), layout="constrained")
        rows = figure.subplots(len(joints.names), 2, sharex=True, squeeze=False, width_ratios=[1.5, 1])
        keep = np.unique(np.linspace(0, len(joints.t) - 1, 4000).astype(int))
        t = joints.t[keep]
        shown = np.where(np.diff(t, prepend=t[0]) > max(_PAUSE_S, 4 * joints.t[-1] / 4000), np.nan, 1.0)
        for i, name in enumerate(joints.names):
            left, right = rows[i]
            left.plot(t, shown * joints.q[keep, i], color=EXECUTED, lw=1.0, label="measured")
            if reference is not None:
                t_reference = (reference.stamp_ns - joints.stamp_ns[0]) * 1e-9
                q_reference = np.interp(t, t_reference, reference.q[:, i])
                left.plot(t, shown * q_reference, color=PLANNED, lw=2.4, alpha=0.4, label="reference")
            if joints.tau is not None:
                right.plot(t, shown * joints.tau[keep, i], color=EXECUTED, lw=0.8)
            left.set_ylabel(f"{name}\n[rad]")
            # As many numbers whatever the height: the layout measures them before it knows it.
            for axes in (left, right):
                axes.yaxis.set_major_locator(MaxNLocator(3))
            for segment in found:
                left.axvspan(
                    (segment.begin_ns - joints.stamp_ns[0]) * 1e-9,
                    (segment.end_ns - joints.stamp_ns[0]) * 1e-9,
                    color="#e8eef6",
                    zorder=0,
                )
        rows[0, 0].set_title("position; shaded: a plan runs")
        rows[0, 1].set_title("torque [N·m]")
        rows[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, fontsize=8)
        for axes in rows[-1]:
            axes.set_xlabel("t [s]")
        return figure
