"""The benchmark's result as a table, on the terminal and in docs/benchmarks/executor.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from s2r_executor.bench.measure import median_of
from s2r_executor.bench.slice import CONDITIONS
from s2r_protocol.exits import UsageError

BEGIN = "<!-- s2r bench executor: begin (written by the command; do not edit) -->"
END = "<!-- s2r bench executor: end -->"
_LOOP = ("p50_us", "p99_us", "p999_us", "max_us")


def summarise(slices: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Per condition: medians over its slices, sums of what is counted."""
    summary: dict[str, dict[str, Any]] = {}
    for condition in CONDITIONS:
        mine = [one for one in slices if one["condition"] == condition]
        if not mine:
            continue
        stops = [one["stop"] for one in mine if one.get("stop")]
        summary[condition] = {
            "slices": len(mine),
            "seconds": mine[0]["settings"]["seconds"],
            "loop": median_of([{name: one["loop"][name] for name in _LOOP} for one in mine]),
            "reference": median_of([{name: one["reference"][name] for name in _LOOP} for one in mine]),
            "ratio": median_of([one["ratio"] for one in mine]),
            "wakes": sum(one["loop"]["wakes"] for one in mine),
            "missed": sum(one["loop"]["missed"] for one in mine),
            "missed_reference": sum(one["reference"]["missed"] for one in mine),
            "unexplained": sum(one["unexplained"] for one in mine),
            "cost": median_of(
                [{n: one[n] for n in ("cpu_per_tick_us", "cpu_share", "resident_MiB")} for one in mine]
            ),
            "page_faults": sum(one["page_faults"] for one in mine),
            "heap_growth_kib": sum(one["heap_growth_kib"] for one in mine),
            "stop": median_of(stops) | {"worst_ratio": max(s["ratio"] for s in stops)} if stops else None,
            "stops_seen": len(stops),
        }
    return summary


def to_markdown(result: dict[str, Any]) -> str:
    """The tables."""
    summary = result["summary"]
    lines = [
        f"`{result['command']}`",
        "",
        f"{result['machine']}; preflight {result['preflight']}.",
        "Lateness of s2r-rt's wake-ups at 1 kHz against a reference FIFO thread on the same core at the same time; "
        "medians of slices, ratio to the reference in brackets. "
        "A missed cycle is unexplained when the reference was on time then.",
        "",
        "| load | slices | p50, µs | p99, µs | p99.9, µs | worst, µs | missed | by the reference | unexplained |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for condition, row in summary.items():
        cells = [f"{row['loop'][name]:.0f} ({row['ratio'][name.removesuffix('_us')]:.2f})" for name in _LOOP]
        lines.append(
            f"| {CONDITIONS[condition]} | {row['slices']} x {row['seconds']} s | {' | '.join(cells)} "
            f"| {row['missed']} of {row['wakes'] + row['missed']} | {row['missed_reference']} | {row['unexplained']} |"
        )
    lines += [
        "",
        "| figure | value |",
        "|---|---|",
        *(f"| {name} | {value} |" for name, value in _figures(result)),
    ]
    return "\n".join(lines)


def _figures(result: dict[str, Any]) -> list[tuple[str, str]]:
    summary, rows = result["summary"], []
    if summary:
        first = next(iter(summary.values()))
        cost = first["cost"]
        rows += [
            (
                "CPU per tick, bus I/O included",
                f"{cost['cpu_per_tick_us']:.0f} µs, {100 * cost['cpu_share']:.1f} % of the period",
            ),
            ("page faults of s2r-rt, all slices", f"{sum(r['page_faults'] for r in summary.values()):.0f}"),
            (
                "growth of its data segment, all slices",
                f"{sum(r['heap_growth_kib'] for r in summary.values()):.0f} KiB",
            ),
        ]
    killed = summary.get("killed", {})
    if killed.get("stop"):
        stop = killed["stop"]
        rows += [
            (
                "front end killed: stop begun after",
                f"{stop['noticed_ms']:.0f} ms (median of {killed['stops_seen']})",
            ),
            (
                "stop taken over ramp planned",
                f"{stop['ratio']:.3f} (worst {stop['worst_ratio']:.3f})",
            ),
            ("largest jerk in that stop over its limit", f"{stop['jerk_share']:.2f}"),
        ]
    figures = result["figures"]
    if "memory" in figures:
        text = ", ".join(f"{n.removesuffix('_MiB')} {v:.0f} MiB" for n, v in figures["memory"].items())
        rows.append(("resident memory, executor idle", text))
    if "admission" in figures:
        a = figures["admission"]
        text = (
            f"{a['p50_ms']:.1f} ms (worst {a['worst_ms']:.1f}), CPU {a['cpu_p50_ms']:.1f} ms "
            f"(worst {a['cpu_worst_ms']:.1f}), {a['over_rnea']:.1f} times its RNEA calls alone"
        )
        rows.append((f"admission of {a['knots']:.0f} points x 7, torque and self-collision included", text))
    if "stop_latency" in figures:
        s = figures["stop_latency"]
        text = f"{s['p50_ticks']:.0f} (worst {s['worst_ticks']:.0f} of {s['stops']:.0f})"
        rows.append(("ticks from a stop request to the first tick of the stop", text))
    if "splices" in figures:
        s = figures["splices"]
        for kind, how in (("met", "meet it"), ("bridged", "miss it by up to a milliradian")):
            text = f"{s[f'{kind}_took_over']:.0f} of {s[f'{kind}_tried']:.0f}"
            rows.append((f"replacements of a running plan that {how}: took over", text))
    if "stepped_clock" in figures:
        s = figures["stepped_clock"]
        text = (
            f"{s['over_real_time']:.1f} times real time; {s['missed']:.0f} of {s['ticks']:.0f} setpoints missed, "
            f"{s['stops']:.0f} stops; CPU per tick: core {s['core_cpu_us']:.0f} µs, "
            f"stand-in {s['stand_in_cpu_us']:.0f} µs"
        )
        rows.append(("stepped clock with the MuJoCo stand-in", text))
    for packing, values in figures.get("bus_load", {}).items():
        text = (
            f"{100 * values['measured']:.1f} % measured, {100 * values['computed']:.1f} % computed worst case"
        )
        rows.append((f"bus load, {packing} packing", text))
    return rows


def write_into(path: Path, markdown: str) -> None:
    """Replace the command's part of a page.

    Raises:
        UsageError: The page does not hold the two markers.
    """
    text = path.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise UsageError(f"{path} does not hold the lines\n{BEGIN}\n{END}\nput them where the table belongs")
    before, rest = text.split(BEGIN, 1)
    path.write_text(f"{before}{BEGIN}\n{markdown}\n{END}{rest.split(END, 1)[1]}", encoding="utf-8")
