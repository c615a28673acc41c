"""The results page: tables, failures by stage and the distribution of errors, as Markdown with one picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from s2r_sim.paper.ablations import ablations
from s2r_sim.paper.distribution import draw_distribution
from s2r_sim.paper.miss import STAGES, stage_of_miss
from s2r_sim.paper.picture import picture_link, picture_of
from s2r_sim.paper.projection import projection
from s2r_sim.paper.score import Row
from s2r_sim.paper.summary import LIMITS, PAPER, UNITS, UNTOLD, Merit, causes, merit, wilson
from s2r_sim.paper.trials import KINDS


def write_page(
    rows: Sequence[Row],
    path: Path,
    command: str,
    attempts: int,
    note: str = "",
    others: Mapping[str, Sequence[Row]] | None = None,
    ran: Sequence[str] = (),
) -> None:
    """Write the page and, beside it, its picture.

    Args:
        rows: Of the campaign.
        path: Of the page.
        command: That wrote it.
        attempts: Planned manipulations at most.
        note: A remark for the reader.
        others: Campaigns of the same trials with other options, by label.
        ran: Markdown lines: which commands ran the trials, see :func:`s2r_sim.paper.calls.told`.
    """
    kinds = [kind for kind in KINDS if any(row["kind"] == kind for row in rows)]
    path.write_text("\n".join(_lines(rows, kinds, command, attempts, note, others or {}, path, ran)) + "\n")
    draw_distribution(rows, kinds, picture_of(path))


def _lines(
    rows: Sequence[Row],
    kinds: Sequence[str],
    command: str,
    attempts: int,
    note: str,
    others: Mapping[str, Sequence[Row]],
    path: Path,
    ran: Sequence[str],
) -> list[str]:
    lines = [
        "# Results",
        "",
        "The paper's accuracy table (Sim2Real2, Table I), redone: a never-seen object is looked at, pushed, modelled,"
        " and its part moved by a wanted amount.",
        f"{_counted(rows)} "
        "**These are simulated stand-in objects with concealed physics; the paper's figures are from a real arm.**",
        "Place, size, state as found, direction and amount of the motion are random."
        " Hidden are friction, damping, mass, slop of rails, lids that bend, stiction, friction that changes along the"
        " way, detents, camera noise, hand-eye error, friction and elastic gears of the arm ([what the stand-in"
        " hides](stand-in.md)).",
        "The host sees depth frames and joint states. World and truth log lie in a folder of their own that it is not"
        " told of; they are opened when all processes of the trial have ended. " + _seals(rows),
        "The amount is told once the host has built the object: as drawn before the run, or as far the other way where"
        " the pushes have left less room than that before a stop. Where they have left the part is taken from what the"
        " host itself says of them, counted from its first view: what it misjudges there can put the target nearer to a"
        " stop, or beyond it, and is to its own disadvantage.",
        "",
        *([*ran, ""] if ran else []),
        f"Written by `{command}`.",
        *([note] if note else []),
        "",
        "δ is what was asked for minus what was done, δ_r its share of what was asked for, both from the sealed truth.",
        "Intervals are of 90 %: Wilson's of shares, by bootstrap of means.",
        "A trial that ended before a planned manipulation counts as a miss in the shares and is left out of the means.",
        "What parts of the system are worth: [ablations](ablations.md).",
        "",
        "## After the last planned manipulation",
        f"The system measures and corrects; at most {attempts} planned manipulations.",
        "",
        *_table(rows, kinds, "delta"),
        "",
        "## After the first planned manipulation",
        "Without correction, as the paper measures.",
        "",
        *_table(rows, kinds, "delta_first"),
        "",
        picture_link("Distribution of relative errors", path),
        "",
        "Curves: the share of all trials that ended below a |δ_r|; grey bars: the paper's; pale bars: how many of the"
        " trials are where after the last manipulation.",
        "",
        "## Failures by stage",
        "",
        "| object | stage that ended the trial | trials |",
        "|---|---|---|",
    ]
    for kind in kinds:
        for stage, count in causes(rows, kind).failures.items():
            lines.append(f"| {kind} | {stage} | {count} |")
    lines += ["", "## Misses by cause", "", *_misses(rows, kinds)]
    if others:
        lines += ["", "## What the parts are worth", "", *ablations(rows, kinds, others)]
    lines += ["", "## Perception in these trials", "", *_perception(rows, kinds)]
    lines += ["", "## What a trial costs", "", *_costs(rows, kinds)]
    scaled = projection(rows)
    if scaled:
        lines += ["", "## At scale, on paper", "", *scaled]
    lines += ["", "## Every trial", "", *_trials(rows)]
    return lines


def _counted(rows: Sequence[Row]) -> str:
    again = sum(row.get("tries", 1) > 1 for row in rows)
    text = f"{len(rows)} manipulations."
    were = "was" if again == 1 else "were"
    return f"{text} {again} of them {were} begun anew because a process fell silent." if again else text


def _seals(rows: Sequence[Row]) -> str:
    """How many sealed worlds were, at the end, the ones that had been drawn and published before the run."""
    opened = [bool(row["commitment_holds"]) for row in rows if row.get("commitment_holds") is not None]
    return (
        f"{sum(opened)} of {len(opened)} seals hold: the world opened is the one whose hash was told before."
    )


def _table(rows: Sequence[Row], kinds: Sequence[str], key: str) -> list[str]:
    head = " | ".join(f"below {100 * limit:.0f} %" for limit in LIMITS)
    lines = [
        f"| object | n | manipulated | {head} | mean \\|δ\\| | mean \\|δ_r\\| | median \\|δ_r\\| |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for kind in kinds:
        lines += [_line(merit(rows, kind, key)), _paper_line(kind)]
    return lines


def _line(m: Merit) -> str:
    unit, factor = UNITS[m.kind]
    shares = []
    for count in m.below:
        low, high = wilson(count, m.n)
        shares.append(
            f"{count} ({100 * count / max(m.n, 1):.0f} %, 90 % in {100 * low:.0f} to {100 * high:.0f})"
        )
    mean = _with_interval(m.delta, m.delta_90, factor, 2, unit)
    relative = _with_interval(m.delta_r, m.delta_r_90, 100.0, 1, "%")
    median = "–" if m.median_r is None else f"{100 * m.median_r:.1f} %"
    return f"| {m.kind} | {m.n} | {m.done} | {' | '.join(shares)} | {mean} | {relative} | {median} |"


def _with_interval(
    mean: float | None, interval: tuple[float, float] | None, factor: float, digits: int, unit: str
) -> str:
    if mean is None or interval is None:
        return "–"
    low, high = (f"{factor * value:.{digits}f}" for value in interval)
    return f"{factor * mean:.{digits}f} {unit} ({low} to {high})"


def _paper_line(kind: str) -> str:
    n, ten, thirty, delta, relative = PAPER[kind]
    unit, _ = UNITS[kind]
    return (
        f"| {kind}, paper (real arm) | {n} | {n} | {ten} ({100 * ten / n:.0f} %) | "
        f"{thirty} ({100 * thirty / n:.0f} %) | – | "
        f"{delta:.2f} {unit} | {100 * relative:.1f} % | – |"
    )


def _misses(rows: Sequence[Row], kinds: Sequence[str]) -> list[str]:
    """To which stage every trial is owed that ended a tenth or more of what was asked for off."""
    misses = {kind: causes(rows, kind).misses for kind in kinds}
    stages = [*STAGES, *([UNTOLD] if any(UNTOLD in counts for counts in misses.values()) else [])]
    lines = [
        "Trials that ended 10 % or more off, or without a manipulation, by the first of these that holds:",
        "",
        "- The stage that ended the trial: looks, pushes, the joint and what is learnt are *perceive*, the way home is"
        " *execute*, a process that fell silent is *processes*.",
        "- *perceive*: the joint as told, by itself, hides half of the miss or more: even a look without noise at the"
        " point that was pushed would misread the way by that.",
        "- *measure*: the last look hid half of the miss or more, and a correction was left.",
        "- *plan*: a plan for a correction was looked for and not found.",
        "- The largest part of the last manipulation's δ: target minus end foreseen (*plan*), state seen minus true"
        " state before it (*perceive*), motion foreseen minus true motion (*execute*).",
        "",
        f"| object | misses | {' | '.join(stages)} |",
        f"|---|---|{'---|' * len(stages)}",
    ]
    for kind, counts in misses.items():
        cells = " | ".join(str(counts.get(stage, 0)) for stage in stages)
        lines.append(f"| {kind} | {sum(counts.values())} | {cells} |")
    return lines


def _costs(rows: Sequence[Row], kinds: Sequence[str]) -> list[str]:
    """Wall and processor time of host, executor and stand-in together, and what they leave on disk."""
    lines = [
        "Medians over the trials; stand-in and executor are part of them, in lock-step.",
        "",
        "| object | wall [s] | processor time [s] | stored [MB] |",
        "|---|---|---|---|",
    ]
    for kind in kinds:
        mine = [row for row in rows if row["kind"] == kind]
        cells = []
        for name, factor, digits in (("wall_s", 1.0, 0), ("cpu_s", 1.0, 0), ("stored_bytes", 1e-6, 1)):
            values = [factor * row[name] for row in mine if row.get(name) is not None]
            cells.append(f"{np.median(values):.{digits}f}" if values else "–")
        lines.append(f"| {kind} | {' | '.join(cells)} |")
    return lines


def _perception(rows: Sequence[Row], kinds: Sequence[str]) -> list[str]:
    lines = [
        "| object | joints answered | pushes | axis error, median (p90) | hinge off by, median (p90) |"
        " motion seen off by, median (p90) |",
        "|---|---|---|---|---|---|",
    ]

    def shown(values: list[float], factor: float, unit: str) -> str:
        if not values:
            return "–"
        a = factor * np.abs(values)
        return f"{np.median(a):.2f} ({np.percentile(a, 90):.2f}) {unit}"

    for kind in kinds:
        mine = [row for row in rows if row["kind"] == kind and row.get("axis_error_rad") is not None]
        unit, factor = ("mm", 1e3) if kind == "drawer" else ("°", UNITS[kind][1])
        columns = {key: [row[key] for row in mine if row.get(key) is not None] for key in
                   ("axis_error_rad", "axis_offset_m", "push_error")}  # fmt: skip
        pushes = sum(row.get("pushes", 0) for row in rows if row["kind"] == kind)
        lines.append(
            f"| {kind} | {len(mine)} | {pushes} | {shown(columns['axis_error_rad'], float(np.degrees(1.0)), '°')} | "
            f"{shown(columns['axis_offset_m'], 1e3, 'mm')} | {shown(columns['push_error'], factor, unit)} |"
        )
    return lines


def _trials(rows: Sequence[Row]) -> list[str]:
    lines = [
        "| object | trial | asked for | δ first | δ last | δ_r last | manipulations | how it ended |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        unit, factor = UNITS[row["kind"]]

        def shown(value: float | None, factor: float = factor, unit: str = unit) -> str:
            return "–" if value is None else f"{factor * value:+.2f} {unit}"

        relative = "–" if row["delta"] is None else f"{100 * row['delta'] / row['change']:+.1f} %"
        ending = str(row["reason"]).replace("|", "/").split("\n")[0][:160]
        if row["stage"] is None:
            cause = stage_of_miss(row)
            ending = "went through" if cause is None else f"went through; the miss: {cause}"
        lines.append(
            f"| {row['kind']} | {row['number']} | {shown(row['change'])} | {shown(row.get('delta_first'))} | "
            f"{shown(row['delta'])} | {relative} | {row.get('manipulations', 0)} | {ending} |"
        )
    return lines
