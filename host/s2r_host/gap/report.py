"""One HTML file that opens offline: where, what, how much better, what was rejected, what to do next."""

from __future__ import annotations

import base64
import html
import io
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from s2r_host.gap.base_terms import PREFIX
from s2r_host.gap.effects import catalogue
from s2r_host.gap.pipeline import Analysis

INK, MUTED, BEFORE, AFTER, MEASURED = "#1d2433", "#667085", "#d1495b", "#1f7a8c", "#1d2433"
STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#1d2433;max-width:1000px;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem;margin:0}h2{font-size:1.1rem;margin:2rem 0 .4rem;border-bottom:1px solid #e4e7ec}
table{border-collapse:collapse;width:100%;font-size:.9rem}td,th{padding:.3rem .5rem;border-bottom:1px solid #e4e7ec;
text-align:left;vertical-align:top}th{color:#667085;font-weight:600}.verdict{font-size:1.25rem;margin:.8rem 0;
padding:.7rem 1rem;border-left:6px solid #1f7a8c;background:#f2f7f8}.bad{border-color:#d1495b;background:#fcf3f4}
.muted{color:#667085}img{max-width:100%}.num{text-align:right;font-variant-numeric:tabular-nums}code{font-size:.9em}
"""
VERDICTS = {
    "nothing_missing": "Nothing is missing: the nominal model explains these recordings down to their noise.",
    "parameter_off": "A parameter is off; the structure of the model is right.",
    "physics_missing": "Physics is missing from the model.",
    "unknown": "Something is missing that is not in the catalogue.",
    "insufficient": "The data cannot tell.",
}


def write_report(a: Analysis, answer: dict, path: Path) -> None:
    """Write the report."""
    parts = [
        f"<!doctype html><html lang=en><meta charset=utf-8><title>s2r gap: {html.escape(a.model.path.name)}</title>",
        f"<style>{STYLE}</style>",
        "<h1>Where simulation and recordings part</h1>",
        f"<p class=muted>{html.escape(a.model.path.name)} · fit {_names(a.fit)}"
        f" · held out {_names(a.hold) or 'last 30 %'}"
        f" · repeat {_names(a.repeats) or 'none'} · seed {answer['seed']} · {answer['wall_s']:.0f} s</p>",
        _verdict(answer),
        _effects(a, answer),
        _parameters_off(answer),
        _numbers(a, answer),
        _figures(a),
        _rejected(answer),
        _next(answer),
        _notes(answer),
        "</html>",
    ]
    path.write_text("\n".join(p for p in parts if p), encoding="utf-8")


def _names(sessions: list) -> str:
    return html.escape(", ".join(s.rec.name for s in sessions))


def _verdict(answer: dict) -> str:
    css = "verdict" if answer["verdict"] == "nothing_missing" else "verdict bad"
    where = answer["where"][0] if answer["where"] else None
    place = (
        f" The gap lives on <b>{html.escape(where['joint'])}</b> ({where['share']:.0%}),"
        f" {html.escape(where['regime']['words'])}."
        if where
        else ""
    )
    return f"<div class='{css}'>{VERDICTS[answer['verdict']]}{place}</div>"


def _effects(a: Analysis, answer: dict) -> str:
    if not answer["effects"]:
        return ""
    rows = []
    known = catalogue()
    for e in answer["effects"]:
        parameters = "<br>".join(_parameter(k, p) for k, p in e["parameters"].items())
        also = (
            f"<br><span class=muted>could also be: {', '.join(e['could_also_be'])}</span>"
            if e["could_also_be"]
            else ""
        )
        rows.append(
            f"<tr><td><b>{e['name']}</b> on {html.escape(e['joint'])}{also}"
            f"<br><code>{html.escape(known[e['name']].equation)}</code></td>"
            f"<td class=num>{e['probability']:.2f}</td><td>{parameters}</td><td>{html.escape(e['evidence'])}</td></tr>"
        )
    return (
        "<h2>Missing physics</h2><table><tr><th>effect<th>probability<th>parameters, 90 % interval<th>evidence</tr>"
        + "".join(rows) + "</table>"
    )  # fmt: skip


def _parameter(name: str, p: dict) -> str:
    flag = "" if p["identifiable"] else " <span class=muted>not identifiable from this motion</span>"
    low, high = p["interval90"]
    return f"{name} = {p['value']:.4g} {html.escape(p['unit'])} [{low:.4g}, {high:.4g}]{flag}"


def _parameters_off(answer: dict) -> str:
    if not answer["parameters_off"]:
        return ""
    rows = "".join(
        f"<tr><td>{p['name']} of {html.escape(str(p.get('body', p.get('joint'))))}<td class=num>{p['from']:.5g}"
        f"<td class=num>{p['to']:.5g} {html.escape(p['unit'])}"
        f"<td class=num>[{p['interval90'][0]:.5g}, {p['interval90'][1]:.5g}]</tr>"
        for p in answer["parameters_off"]
    )
    return f"<h2>Parameters off</h2><table><tr><th>parameter<th>model<th>recordings<th>90 % interval</tr>{rows}</table>"


def _numbers(a: Analysis, answer: dict) -> str:
    fit = answer["fit"]
    if "holdout_before" not in fit:
        return ""

    def cell(x: float | None) -> str:
        return "–" if x is None else f"{x:.4g}"

    loop = "closed loop" if fit.get("closed_loop") else "open-loop windows"
    rows = [
        (f"position, fitted, {loop}", fit["train_before"], fit["train_after"]),
        (f"position, held out, {loop}", fit["holdout_before"], fit["holdout_after"]),
        (
            "position, held out, open-loop windows",
            fit["open_loop_holdout_before"],
            fit["open_loop_holdout_after"],
        ),
        ("effort, held out", fit.get("effort_holdout_before"), fit.get("effort_holdout_after")),
    ]
    body = "".join(f"<tr><td>{n}<td class=num>{cell(b)}<td class=num>{cell(c)}</tr>" for n, b, c in rows)
    for name, b in answer["baselines"].items():
        body += f"<tr><td>baseline {name.replace('_', ' ')}, held out<td><td class=num>{cell(b['holdout'])}"
        body += f" (open loop {cell(b['open_loop_holdout'])})</tr>"
    floor = answer["floor"]
    return (
        f"<h2>Root mean square errors [{fit['unit']}]</h2><table><tr><th>what<th>before<th>after</tr>{body}</table>"
        f"<p class=muted>Noise floor ({floor['source']}): position {cell(floor['q_rmse'])},"
        f" effort {cell(floor['tau_rmse'])}.</p>"
    )


def _rejected(answer: dict) -> str:
    if not answer["rejected"]:
        return ""
    rows = "".join(
        f"<tr><td>{r['name']} on {html.escape(r['joint'])}<td class=num>{r['holdout_gain']:.1%}"
        f"<td>{html.escape(r['why'])}</tr>"
        for r in answer["rejected"][:40]
    )
    return (
        f"<h2>Looked at and rejected</h2><table><tr><th>effect<th>held-out gain<th>why not</tr>{rows}</table>"
    )


def _next(answer: dict) -> str:
    n = answer["next_experiment"]
    if not n:
        return ""
    file = f" Trajectory: <code>{n['trajectory']}</code>." if n.get("trajectory") else ""
    which = f"Separates {' from '.join(n['separates'])}. " if n.get("separates") else ""
    return f"<h2>Next experiment</h2><p>{which}{html.escape(n['why'])}.{file}</p>"


def _notes(answer: dict) -> str:
    if not answer["notes"]:
        return ""
    return (
        "<h2>What the data cost</h2><ul>"
        + "".join(f"<li>{html.escape(n)}</li>" for n in answer["notes"])
        + "</ul>"
    )


# --- figures -----------------------------------------------------------------------------------------------


def _figures(a: Analysis) -> str:
    if a.problem is None:
        return ""
    out = ["<h2>Residual over joints and time</h2>", _image(heat_map(a))]
    for j in _figure_joints(a):
        out += [f"<h2>What betrays it: {html.escape(a.model.joints[j])}</h2>", _image(maps_figure(a, j))]
        out += ["<h2>Before and after on held-out data</h2>", _image(overlay_figure(a, j))]
    return "\n".join(out)


def _figure_joints(a: Analysis) -> list[int]:
    assert a.problem is not None
    named = [a.model.index(p.joint) for p in a.places[:2]]
    return [j for j in named if j in a.problem.joints] or a.problem.joints[:1]


def _image(figure: Figure) -> str:
    FigureCanvasAgg(figure)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, bbox_inches="tight")
    return f"<img alt='figure' src='data:image/png;base64,{base64.b64encode(stream.getvalue()).decode()}'>"


def heat_map(a: Analysis) -> Figure:
    """Residual in noise floors, joint by time, fitted recordings one after another."""
    assert a.problem is not None
    p = a.problem
    figure = Figure(figsize=(9, 0.9 + 0.35 * len(p.joints)))
    axes = figure.add_subplot()
    columns = []
    for j in p.joints:
        rows = np.concatenate([np.abs(p.raw[b.rows]) / p.floor[j] for b in p.blocks if b.joint == j])
        n = max(1, len(rows) // 300)
        columns.append(rows[: len(rows) // n * n].reshape(-1, n).max(1))
    width = min(map(len, columns))
    image = axes.imshow(
        np.stack([c[:width] for c in columns]),
        aspect="auto",
        cmap="magma_r",
        vmin=0,
        vmax=max(4.0, float(np.percentile(np.concatenate(columns), 98))),
    )  # fmt: skip
    axes.set_yticks(range(len(p.joints)), [a.model.joints[j] for j in p.joints])
    edges, labels, at = [], [], 0.0
    total = sum(float(b.session.t[-1]) for b in p.blocks if b.joint == p.joints[0])
    for b in p.blocks:
        if b.joint == p.joints[0]:
            edges.append(at / total * width)
            labels.append(f"{b.session.rec.name} 0 s")
            at += float(b.session.t[-1])
    axes.set_xticks(edges, labels, fontsize=8, ha="left")
    figure.colorbar(image, ax=axes, label="noise floors")
    return figure


def maps_figure(a: Analysis, j: int) -> Figure:
    """Residual against speed and position, before (red) and after (teal), binned by direction."""
    assert a.problem is not None
    assert a.decision is not None
    p = a.problem
    figure = Figure(figsize=(9, 3.2))
    after = a.decision.solution.prediction
    unit, effort = a.model.unit(a.model.joints[j]), a.model.effort_unit(a.model.joints[j])
    for k, (label, pick) in enumerate((("speed", "v"), ("position", "q"))):
        axes = figure.add_subplot(1, 2, k + 1)
        x, up, r, left = [], [], [], []
        for b in p.blocks:
            if b.joint == j:
                x.append(getattr(b.session, pick)[b.picks, j])
                up.append(b.session.v[b.picks, j] > 0)
                r.append(p.raw[b.rows])
                left.append(after[b.rows])
        X, U, R, L = (np.concatenate(v) for v in (x, up, r, left))
        axes.plot(X, R, ".", ms=1.5, color=BEFORE, alpha=0.25)
        axes.plot(X, L, ".", ms=1.5, color=AFTER, alpha=0.25)
        for mask, style, name in ((U, "-", "forward"), (~U, "--", "backward")):
            c, m = _binned(X[mask], R[mask])
            axes.plot(c, m, style, color=BEFORE, lw=1.6, label=f"before, {name}")
        c, m = _binned(X, L)
        axes.plot(c, m, color=AFTER, lw=1.6, label="after")
        axes.axhspan(-p.floor[j], p.floor[j], color=MUTED, alpha=0.15, lw=0)
        axes.set_xlabel(f"{label} [{unit}{'/s' if pick == 'v' else ''}]")
        axes.set_ylabel(f"residual effort [{effort}]" if k == 0 else "")
        axes.spines[["top", "right"]].set_visible(False)
        if k == 0:
            axes.legend(fontsize=7, frameon=False)
    return figure


def _binned(x: np.ndarray, y: np.ndarray, bins: int = 40) -> tuple[np.ndarray, np.ndarray]:
    if len(x) < bins:
        return np.zeros(0), np.zeros(0)
    edges = np.linspace(x.min(), x.max(), bins + 1)
    index = np.clip(np.digitize(x, edges) - 1, 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    mean = np.bincount(index, y, minlength=bins) / np.maximum(count, 1)
    good = count > 3
    return (0.5 * (edges[1:] + edges[:-1]))[good], mean[good]


def overlay_figure(a: Analysis, j: int) -> Figure:
    """Held-out effort residual and open-loop position error, before and after."""
    assert a.problem is not None
    assert a.decision is not None
    p = a.problem
    figure = Figure(figsize=(9, 4.6))
    top, bottom = figure.subplots(2, 1)
    blocks = [b for b in p.blocks if b.joint == j and b.held.any()]
    unit, effort = a.model.unit(a.model.joints[j]), a.model.effort_unit(a.model.joints[j])
    if blocks:
        b = blocks[0]
        t = b.session.t[b.picks][b.held]
        top.plot(t, p.raw[b.rows][b.held], color=BEFORE, lw=0.9, label="before")
        top.plot(t, a.decision.solution.prediction[b.rows][b.held], color=AFTER, lw=0.9, label="after")
        top.axhspan(-p.floor[j], p.floor[j], color=MUTED, alpha=0.2, lw=0)
        top.legend(fontsize=8, frameon=False, ncols=2)
    top.set_ylabel(f"effort residual [{effort}]")
    for errors, colour in ((a.before, BEFORE), (a.after, AFTER)):
        if errors is None:
            continue
        for trace in errors.traces:
            if not trace.closed and trace.held and blocks and trace.session is blocks[0].session:
                stop = trace.start + len(trace.q)
                error = trace.q[:, j] - trace.session.q[trace.start : stop, j]
                bottom.plot(trace.session.t[trace.start : stop], error, color=colour, lw=0.9)
    bottom.set_ylabel(f"open-loop error [{unit}]")
    bottom.set_xlabel("time [s]")
    for axes in (top, bottom):
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def effect_label(name: str) -> str:
    """A term's name as shown to people."""
    return name.removeprefix(PREFIX)
