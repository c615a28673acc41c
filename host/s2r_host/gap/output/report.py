"""One HTML file that opens offline: where, what, how much better, what was rejected, what to do next."""

from __future__ import annotations

import html
from pathlib import Path

from s2r_host.gap.effects import catalogue
from s2r_host.gap.output.figures import figures
from s2r_host.gap.output.told import effort_unit, largest_places
from s2r_host.gap.pipeline import Analysis
from s2r_host.gap.verdict.rejected import was_weighed
from s2r_protocol.whole_file import write_whole

SHOWN_REJECTED = 30
TITLES = {
    "sysid": "mujoco.sysid", "refitted_parameters": "refitted parameters", "residual_network": "residual network",
}  # fmt: skip
STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#1d2433;max-width:1000px;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem;margin:0}h2{font-size:1.1rem;margin:2rem 0 .4rem;border-bottom:1px solid #e4e7ec}
table{border-collapse:collapse;width:100%;font-size:.9rem}td,th{padding:.3rem .5rem;border-bottom:1px solid #e4e7ec;
text-align:left;vertical-align:top}th{color:#667085;font-weight:600}.verdict{font-size:1.25rem;margin:.8rem 0;
padding:.7rem 1rem;border-left:6px solid #1f7a8c;background:#f2f7f8}.bad{border-color:#d1495b;background:#fcf3f4}
.open{border-color:#667085;background:#f5f6f8}
.muted{color:#667085}img{max-width:100%}.num{text-align:right;font-variant-numeric:tabular-nums}code{font-size:.9em}
p,li,.verdict{overflow-wrap:anywhere}@media screen and (max-width:700px){table{display:block;overflow-x:auto}}
"""
VERDICTS = {
    "nothing_missing": "Nothing is missing: the nominal model explains these recordings down to their noise.",
    "parameter_off": "A parameter is off; the structure of the model is right.",
    "physics_missing": "Physics is missing from the model.",
    "unknown": "Something is missing that is not in the catalogue.",
}
CANNOT_TELL = "cannot tell: "


def write_report(a: Analysis, answer: dict, path: Path) -> None:
    """Write the report."""
    parts = [
        f"<!doctype html><html lang=en><meta charset=utf-8><title>s2r gap: {html.escape(a.model.path.name)}</title>",
        '<meta name=viewport content="width=device-width, initial-scale=1">',
        f"<style>{STYLE}</style>",
        "<h1>Where simulation and recordings part</h1>",
        f"<p class=muted>{html.escape(a.model.path.name)} · fit {_names(a.fit)}"
        f" · held out {_names(a.hold) or '30 % of each'}"
        f" · repeat {_names(a.repeats) or 'none'} · seed {answer['seed']} · {answer['wall_s']:.0f} s</p>",
        _verdict(answer),
        _effects(answer),
        _parameters_off(answer),
        _numbers(answer),
        _per_joint(answer),
        figures(a),
        _rejected(answer),
        _next(answer),
        _notes(answer),
        "</html>",
    ]
    write_whole(path, "\n".join(p for p in parts if p))


def _names(sessions: list) -> str:
    return html.escape(", ".join(s.rec.name for s in sessions))


def _verdict(answer: dict) -> str:
    """The verdict and where the gap is; of data that cannot tell, why not."""
    css = {"nothing_missing": "verdict", "insufficient": "verdict open"}.get(answer["verdict"], "verdict bad")
    if answer["verdict"] == "insufficient":
        why = next((n.removeprefix(CANNOT_TELL) for n in answer["notes"] if n.startswith(CANNOT_TELL)), "")
        return f"<div class='{css}'>The data cannot tell{f': {html.escape(why)}' if why else ''}.</div>"
    places = "; ".join(
        f"<b>{html.escape(p['joint'])}</b> ({p['share']:.0%}), {html.escape(p['regime']['words'])}"
        for p in largest_places(answer["where"])
    )
    place = f" The gap lives on {places}." if places else ""
    return f"<div class='{css}'>{VERDICTS[answer['verdict']]}{place}</div>"


def _effects(answer: dict) -> str:
    if not answer["effects"]:
        return ""
    rows = []
    known = catalogue()
    for e in answer["effects"]:
        parameters = "<br>".join(_parameter(k, p) for k, p in e["parameters"].items())
        rows.append(
            f"<tr><td><b>{e['name']}</b> on {html.escape(e['joint'])}{_also(e)}"
            f"<br><code>{html.escape(known[e['name']].equation)}</code></td>"
            f"<td class=num>{e['probability']:.2f}</td><td>{parameters}</td><td>{html.escape(e['evidence'])}</td></tr>"
        )
    return (
        "<h2>Missing physics</h2><table><tr><th>effect<th class=num>probability"
        "<th>parameters, 90 % interval<th>evidence</tr>"
        + "".join(rows) + "</table>"
    )  # fmt: skip


def _also(entry: dict) -> str:
    """What else an effect or a number may be."""
    also = ", ".join(entry.get("could_also_be", []))
    return f"<br><span class=muted>could also be: {html.escape(also)}</span>" if also else ""


def _unit(entry: dict) -> str:
    return "" if entry["unit"] == "1" else f" {html.escape(entry['unit'])}"


def _parameter(name: str, p: dict) -> str:
    flag = "" if p["identifiable"] else " <span class=muted>not identifiable from this motion</span>"
    low, high = p["interval90"]
    return f"{name} = {p['value']:.4g}{_unit(p)} [{low:.4g}, {high:.4g}]{flag}"


def _parameters_off(answer: dict) -> str:
    if not answer["parameters_off"]:
        return ""
    rows = "".join(
        f"<tr><td>{p['name']} of {html.escape(str(p.get('body', p.get('joint'))))}{_also(p)}"
        f"<td class=num>{p['from']:.5g}<td class=num>{p['to']:.5g}{_unit(p)}"
        f"<td class=num>[{p['interval90'][0]:.5g}, {p['interval90'][1]:.5g}]</tr>"
        for p in answer["parameters_off"]
    )
    head = "<th>parameter<th class=num>model<th class=num>recordings<th class=num>90 % interval"
    return f"<h2>Parameters off</h2><table><tr>{head}</tr>{rows}</table>"


def _numbers(answer: dict) -> str:
    fit = answer["fit"]
    if all(fit.get(f"{part}_before") is None for part in ("train", "holdout", "effort_holdout")):
        return ""

    def cell(x: float | None) -> str:
        return "–" if x is None else f"{x:.4g}"

    loop = "closed loop" if fit.get("closed_loop") else "open-loop windows"
    unit = fit["unit"]
    rows = [
        (f"position [{unit}], fitted, {loop}", fit["train_before"], fit["train_after"]),
        (f"position [{unit}], held out, {loop}", fit["holdout_before"], fit["holdout_after"]),
        (
            f"effort [{effort_unit(unit)}], held out",
            fit.get("effort_holdout_before"),
            fit.get("effort_holdout_after"),
        ),
    ]
    if fit.get("closed_loop"):  # without a law the open-loop windows are what the rows above show
        open_loop = fit["open_loop_holdout_before"], fit["open_loop_holdout_after"]
        rows.insert(2, (f"position [{unit}], held out, open-loop windows", *open_loop))
    body = "".join(f"<tr><td>{n}<td class=num>{cell(b)}<td class=num>{cell(c)}</tr>" for n, b, c in rows)
    for name, b in answer["baselines"].items():
        said = f"<br><span class=muted>{html.escape(b['how'])}</span>"
        body += (
            f"<tr><td>baseline {TITLES[name]} [{unit}], held out{said}<td><td class=num>{cell(b['holdout'])}"
        )
        body += f" (open loop {cell(b['open_loop_holdout'])})</tr>"
    within = answer["baselines"].get("residual_network", {}).get("named_within_10_percent")
    near = (
        ""
        if within is None
        else f" What is named is {'' if within else 'not '}within 10 % of the residual network."
    )
    floor = answer["floor"]
    return (
        "<h2>Root mean square errors</h2><table>"
        f"<tr><th>what<th class=num>before<th class=num>after</tr>{body}</table>"
        f"<p class=muted>Before: the model as given; after: with all that is named above.{near}"
        f" Noise floor ({floor['source']}): position {cell(floor['q_rmse'])} {unit},"
        f" effort {cell(floor['tau_rmse'])} {effort_unit(unit)}.</p>"
    )


def _per_joint(answer: dict) -> str:
    table = answer["fit"].get("per_joint", {})
    if len(table) < 2:
        return ""
    rows = "".join(
        f"<tr><td>{html.escape(joint)}" + "".join(
            f"<td class=num>{'–' if e[k] is None else format(e[k], '.4g')}"
            for k in ("open_loop_holdout_before", "open_loop_holdout_after")
        ) + "</tr>"
        for joint, e in table.items()
    )  # fmt: skip
    return (
        "<table><tr><th>of each joint, held out, open-loop windows<th class=num>before<th class=num>after</tr>"
        f"{rows}</table>"
    )


def _rejected(answer: dict) -> str:
    """One row per effect and reason, as on an arm the same decoy falls on every joint; per reason if none was tried."""
    if not answer["rejected"]:
        return ""
    groups: dict[tuple[str, str], list[dict]] = {}
    for r in answer["rejected"]:
        groups.setdefault((r["name"] if was_weighed(r["why"]) else "", r["why"]), []).append(r)
    order = sorted(groups.items(), key=lambda x: (not was_weighed(x[0][1]), -_gain(x[1])))
    rows = "".join(
        f"<tr><td>{_of_joints(found)}<td class=num>{_percent(_gain(found)) if was_weighed(why) else '–'}"
        f"<td>{html.escape(why)}</tr>"
        for (_, why), found in order[:SHOWN_REJECTED]
    )
    more = len(order) - SHOWN_REJECTED
    tail = f"<p class=muted>{more} more in gap.json.</p>" if more > 0 else ""
    return (
        "<h2>Looked at and rejected</h2><table><tr><th>effect<th class=num>held-out gain<th>why not</tr>"
        f"{rows}</table><p class=muted>Gain: the share of the squared misfit in effort, on held-out motion, that the "
        f"effect would remove beside shifted numbers and the other names.</p>{tail}"
    )


def _gain(rejected: list[dict]) -> float:
    return max(r["holdout_gain"] for r in rejected)


def _percent(share: float) -> str:
    """As 12.3%; nothing has no sign."""
    return f"{round(share, 3) + 0.0:.1%}"


def _of_joints(rejected: list[dict]) -> str:
    """Effects with the joints at which they were looked at; those of the same joints together."""
    joints: dict[str, list[str]] = {}
    for r in rejected:
        joints.setdefault(r["name"], []).append(r["joint"])
    names: dict[str, list[str]] = {}
    for name, places in joints.items():
        names.setdefault(", ".join(places), []).append(name)
    return "; ".join(f"{', '.join(found)} on {html.escape(places)}" for places, found in names.items())


def _next(answer: dict) -> str:
    n = answer["next_experiment"]
    if not n["why"]:
        return ""
    file = ""
    if n.get("trajectory"):
        plan = n["trajectory"].replace(".csv", ".mcap")
        file = f" Trajectory: <code>{n['trajectory']}</code>; on an arm: <code>s2r replay {plan}</code>."
    which = f"To tell {' from '.join(n['separates'])}: " if n.get("separates") else ""
    return f"<h2>Next experiment</h2><p>{which}{html.escape(n['why'])}.{file}</p>"


def _notes(answer: dict) -> str:
    if not answer["notes"]:
        return ""
    return (
        "<h2>What the data cost</h2><ul>"
        + "".join(f"<li>{html.escape(n)}</li>" for n in answer["notes"])
        + "</ul>"
    )
