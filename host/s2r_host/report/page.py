"""``report.html``: one file, no network, everything inside."""

from __future__ import annotations

import os
from html import escape
from pathlib import Path

import numpy as np

from s2r_host.report.clouds import single_view_figure, views_figure
from s2r_host.report.felt import felt_figure
from s2r_host.report.markup import page, section, table
from s2r_host.report.plots import joints_figure, stages_figure, state_figure, tracking_error
from s2r_host.report.style import inline_png, inline_svg
from s2r_host.run.record import RunRecord
from s2r_host.run.run_json import as_json
from s2r_host.run.session import Executed
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import ExitCode
from s2r_protocol.whole_file import write_whole


def write_report(record: RunRecord, path: Path) -> Path:
    """Write the report of a run, however far it got."""
    parts = [
        _head(record),
        _numbers(record),
        _warnings(record),
        _views(record),
        _attempts(record),
        _failed_tries(record),
        _state(record),
        _felt(record),
        _physics(record),
        _lost_motion(record),
        _joints(record),
        _timing(record),
        _verdicts(record),
        _inputs(record),
    ]
    task = record.settings.task
    title = f"s2r run {task.name}, target {_targets(record)}"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, page(title, parts))
    return path


def _head(record: RunRecord) -> str:
    kind = "good" if record.code == ExitCode.OK else "bad"
    badge = f'<span class="badge {kind}">exit {int(record.code)} {escape(record.code.name.lower())}</span>'
    task = record.settings.task
    title = f"<h1>{task.part.capitalize()} to {_targets(record)} {badge}</h1>"
    return f'{title}<p class="lead">{escape(record.reason)}</p>'


def _targets(record: RunRecord) -> str:
    """Targets aimed at, counted as on the command line."""
    if record.goals:
        return ", then ".join(record.show(goal.target, 1) for goal in record.goals)
    asked, show = [record.settings.target, *record.settings.then], record.settings.task.unit.show
    return ", then ".join("a target not told yet" if target is None else show(target, 1) for target in asked)


def _numbers(record: RunRecord) -> str:
    cells, unit = [], record.settings.task.unit
    goals = [goal for goal in record.goals if goal.attempts]
    if goals:
        goal, first = goals[-1], goals[0].attempts[0]
        last, delta_r = goal.last, goal.delta_r
        # A target at which the part was already, or that had no plan, has no figures of its own.
        of = "" if goal is record.goals[-1] else f", target {record.show(goal.target, 1)}"
        cells += [
            (unit.show(last.delta), f"δ = target − final{of}"),
            (f"{100 * delta_r:+.2f} %", f"δ_r = δ / (target − start){of}"),
            (record.show(last.measured.s), f"final state, ± {unit.show(last.measured.sigma)[1:]} (1σ)"),
            (record.show(first.s_initial), "state before the plan"),
            (str(len(record.attempts)), "planned manipulations"),
        ]
    cells.append((f"{record.journal.elapsed_s:.1f} s", "whole run"))
    boxes = "".join(
        f'<div class="number"><b>{escape(value)}</b><span>{escape(text)}</span></div>'
        for value, text in cells
    )
    return f'<div class="numbers">{boxes}</div>'


def _warnings(record: RunRecord) -> str:
    if not record.journal.warnings:
        return ""
    lines = "".join(f'<p class="warn">{escape(text)}</p>' for text in record.journal.warnings)
    return section("Warnings", lines)


def _views(record: RunRecord) -> str:
    named = {view.name: view for view in record.views}
    if record.zero_view in named and record.told_view in named:
        figure = views_figure(named[record.zero_view], named[record.told_view], record.belief)
    elif record.views:
        figure = single_view_figure(record.views[-1])
    else:
        return ""
    table = _jointtable(record)
    return section("What was seen", inline_png(figure, "depth views with the estimated axis") + table)


def _jointtable(record: RunRecord) -> str:
    if record.belief is None:
        return ""
    estimate, model, task = record.belief.estimate, record.belief.model, record.settings.task
    low, high = (task.unit.show(limit) for limit in estimate.intervals90.delta)
    rows = [
        ("joint", f"{estimate.joint_type}, {100 * estimate.explained:.0f} % of the change explained"),
        (
            f"axis, + is {task.positive}",
            np.array2string(record.belief.axis, precision=4, suppress_small=True),
        ),
        (
            f"moved from view {record.zero_view} to {record.told_view}",
            f"{task.unit.show(estimate.delta)} (90 % in [{low}, {high}])",
        ),
        ("residual after alignment", f"{1e3 * estimate.residual_m:.2f} mm"),
        (
            "model",
            f"{len(model.pieces)} convex pieces, moving part {model.mass_kg:.2f} kg (density is a guess)",
        ),
        ("range believed", " to ".join(record.show(limit, 0) for limit in model.range)),
    ]
    if record.belief.felt is not None:
        felt, slides = record.belief.felt, record.belief.template.slides
        friction, damping = ("N", "N·s/m") if slides else ("N·m", "N·m·s/rad")
        rows.append(
            (
                "felt by the arm (joint torques)",
                f"friction {felt.friction:.2f} ± {felt.sigma[1]:.2f} {friction}, "
                f"damping {felt.damping:.2f} ± {felt.sigma[2]:.2f} {damping}, "
                f"{felt.mass_share:.2f} ± {felt.sigma[0]:.2f} of the mass guessed"
                + (f", leans {1e3 * felt.lean:+.1f} mrad more than seen" if slides else ""),
            )
        )
    for geom, shift in record.belief.shifts.items():
        rows.append(("corrected after execution", f"{geom} by {task.unit.show(shift)} of the joint"))
    return table(("", ""), rows)


def _number(record: RunRecord, s: float) -> str:
    """A joint value counted as on the command line, without its unit."""
    return f"{record.settings.task.unit.factor * (s - record.origin):+.2f}"


def _attempts(record: RunRecord) -> str:
    if not record.attempts:
        return ""
    rows, task = [], record.settings.task
    for done in record.attempts:
        planned = done.planned
        rows.append(
            (
                str(planned.number),
                _number(record, done.s_initial),
                _number(record, done.s_target),
                _number(record, done.foreseen),
                f"{_number(record, done.measured.s)} ± {task.unit.factor * done.measured.sigma:.2f}",
                f"{task.unit.factor * done.delta:+.2f}",
                f"{100 * done.delta_r:+.2f} %",
                f"{planned.delivery.trajectory.duration_s:.2f} s",
                planned.end.geom,
                f"{planned.result.control_steps} / {planned.result.cpu_s:.2f} s",
            )
        )
    header = (
        "#",
        f"start [{task.unit.name}]",
        f"target [{task.unit.name}]",
        f"foreseen [{task.unit.name}]",
        f"seen [{task.unit.name}]",
        f"δ [{task.unit.name}]",
        "δ_r",
        "duration",
        "pushed on",
        "steps / CPU",
    )
    note = (
        '<p class="note">δ = s_target − s_final and δ_r = δ / (s_target − s_start), s_start being the state just '
        f"before the planned manipulation. 0 is the state in view {record.origin_view}, + is {task.positive}. "
        "Both are measured by the camera.</p>"
    )
    return section("Planned manipulations", table(header, rows) + note)


def _failed_tries(record: RunRecord) -> str:
    tries = record.journal.failed_tries
    if not tries:
        return ""
    rows = [
        (
            f"{one.manipulation}, try {one.what.number + 1}",
            record.show(one.what.s_target, 1),
            f"{100 * one.what.doubt:.0f} %",
            one.reason,
        )
        for one in tries
    ]
    heads = ("manipulation", "planned to", "of the usual doubt", "why there is no plan")
    return section("Tries without a plan", table(heads, rows))


def _state(record: RunRecord) -> str:
    if not record.attempts:
        return ""
    return section(f"The {record.settings.task.part} over time", inline_svg(state_figure(record)))


def _felt(record: RunRecord) -> str:
    if record.belief is None or not any(record.felt.values()):
        return ""
    figure = felt_figure(record.felt, record.belief, record.settings.task, record.origin)
    model = os.path.relpath(record.belief.growing, record.settings.out)
    command = f"s2r gap --model {model} --fit object-log/*.csv --out gap"
    note = (
        "<p class=\"note\">Effort at the object's joint from the arm's joint torques, less what the arm itself takes; "
        "the band is its standard error. Dashed: what the learnt mass, friction and damping ask for. Where they part, "
        f"physics may be missing: <code>{escape(command)}</code> in the run's folder.</p>"
    )
    return section(f"What the arm felt of the {record.settings.task.part}", inline_svg(figure) + note)


def _physics(record: RunRecord) -> str:
    """What the gap tool said between the targets, and what the plans after it knew."""
    if not record.lessons:
        return ""
    rows = []
    for lesson in record.lessons:
        named = [f"{effect['name']} ({100 * effect['probability']:.0f} %)" for effect in lesson.effects]
        named += [
            f"{one['name']}: {one['from']:.3g} → {one['to']:.3g} {one['unit']}"
            for one in lesson.parameters_off
        ]
        rows.append(
            (
                str(lesson.after),
                lesson.verdict.replace("_", " "),
                ", ".join(named) or "–",
                ", ".join(lesson.carried) or "–",
                ", ".join(lesson.not_carried) or "–",
                os.path.relpath(lesson.folder / "report.html", record.settings.out),
            )
        )
    header = (
        "after", "gap says", "what differs from the belief", "the next plans know", "has no form there", "gap report",
    )  # fmt: skip
    return section("Physics learnt between the targets", table(header, rows))


def _lost_motion(record: RunRecord) -> str:
    """By how much less far than foreseen motions took the part, and how the belief followed."""
    if not record.lost_motion:
        return ""
    show = record.settings.task.unit.show
    rows = [
        (str(lesson.after), ", ".join(f"{show(lost)} at {what}" for what, lost in lesson.found.items()))
        for lesson in record.lost_motion
    ]
    note = (
        '<p class="note">How much less far than foreseen the part went (negative: further), by all motions so far, in '
        "the object as believed by then: the side that they pushed was moved by so much in the median. Of a hinge's "
        "part that is a small shift and turn of the side, which <code>run.json</code> has.</p>"
    )
    header = ("after", "lost, by surface and direction")
    return section("Lost motion learnt between the targets", table(header, rows) + note)


def _joints(record: RunRecord) -> str:
    executed = _shown(record)
    if not executed:
        return ""
    names = load_arm(record.settings.arm).joint_names
    blocks = []
    for motion in executed:
        found = tracking_error(motion)
        text = (
            "no recording"
            if found is None
            else f"largest difference {1e3 * float(np.abs(found[1]).max()):.2f} mrad"
        )
        picture = inline_png(joints_figure(motion, names, found), f"joints of {motion.label}")
        blocks.append(f"<h3>{escape(motion.label)} <span class='note'>({text})</span></h3>{picture}")
    note = '<p class="note">Executed: measured joint positions from the executor\'s recording, one sample per tick.</p>'
    return section("Joints, planned and executed", note + "".join(blocks))


def _shown(record: RunRecord) -> list[Executed]:
    """The motions in contact; the others are in the recording."""
    found = [e for e in record.push.executed if e.label == "push 1"] if record.push else []
    return found + [done.executed[0] for done in record.attempts if done.executed]


def _timing(record: RunRecord) -> str:
    if not record.journal.stages:
        return ""
    return (
        f"<section><h2>Where the time went</h2>{inline_svg(stages_figure(record.journal.stages))}</section>"
    )


def _verdicts(record: RunRecord) -> str:
    if not record.journal.verdicts:
        return ""
    rows = [
        (
            str(number),
            str(v["label"]),
            "accepted" if v["accepted"] else "refused",
            f"{v['duration_s']:.2f} s",
            str(v["plan_seq"]),
        )
        for number, v in enumerate(record.journal.verdicts, start=1)  # as `s2r replay --plan` counts them
    ]
    header = ("plan", "label", "verdict", "duration", "number at the executor")
    return section("The executor's verdicts", table(header, rows))


def _inputs(record: RunRecord) -> str:
    values = as_json(record)
    executor = values["executor"] or {}
    rows = [
        ("command", "s2r " + " ".join(record.arguments)),
        ("arm", record.arm_name),
        ("model hash", record.model_hash.hex()),
        ("limit hash", record.limit_hash.hex()),
        (
            "executor",
            f"{executor.get('software', 'not reached')}, tick {executor.get('tick_ns', 0) / 1e6:g} ms",
        ),
        ("sealed world", record.world_commitment or "not offered by the camera"),
        ("seed", str(record.settings.seed)),
        ("versions", ", ".join(f"{name} {version}" for name, version in values["versions"].items())),
        ("files", ", ".join(_files(record.settings.out))),
    ]
    return section("Inputs", table(("", ""), rows, mono=True))


def _files(out: Path) -> list[str]:
    folders = sorted(entry.name + "/" for entry in out.iterdir() if entry.is_dir()) if out.is_dir() else []
    return ["run.json", "run.mcap (depth, plans, estimates, executor recordings)", *folders]
