"""What the measured cost of a trial means for very many objects and arms: arithmetic on medians, for the page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_sim.paper.score import Row

OBJECTS, ARMS = 10**5, 10**3
CORES = 64  # of one machine
DAY_S = 86_400.0
LINE_BYTES = 1_000  # of results.jsonl, per trial


def projection(rows: Sequence[Row]) -> list[str]:
    """Lines of Markdown; empty while no row has its costs."""
    costed = [row for row in rows if row.get("cpu_s") is not None and row.get("stored_bytes") is not None]
    timed = [row for row in costed if row.get("moving_s") is not None]
    if not costed:
        return []
    cpu_s = float(np.mean([row["cpu_s"] for row in costed]))
    stored = float(np.mean([row["stored_bytes"] for row in costed]))
    hours = OBJECTS * cpu_s / 3600.0
    machines = OBJECTS * cpu_s / (CORES * DAY_S)
    lines = [
        f"Means over {len(costed)} trials, kinds mixed as they are here: {cpu_s:.0f} s of processor time and "
        f"{1e-6 * stored:.1f} MB each.",
        "",
        f"**{OBJECTS:,} objects on stand-ins:** {hours:,.0f} core hours, that is {machines:.1f} machines of {CORES} "
        f"cores for a day, and {1e-12 * OBJECTS * stored:.1f} TB.",
        f"With `--ray` such a machine takes {CORES / cpu_s:.1f} jobs a second at most, all of them "
        f"{CORES * machines / cpu_s:.1f}: one driver that appends a line per job keeps up with thousands.",
    ]
    if timed:
        moving_s = float(np.mean([row["moving_s"] for row in timed]))
        arm_s = moving_s + float(np.mean([row["wall_s"] for row in timed]))
        a_day = ARMS * DAY_S / arm_s
        lines += [
            "",
            f"**{ARMS:,} arms:** an arm moves for {moving_s:.0f} s in a trial; with all of the wall time counted as "
            f"thinking it is busy for {arm_s:.0f} s at most. "
            f"All of them do {a_day:,.0f} trials a day: {OBJECTS / a_day * 24:.1f} h for {OBJECTS:,} objects, "
            f"{ARMS * cpu_s / arm_s:,.0f} cores of host at most (the stand-in's share is in it), and "
            f"{1e-12 * a_day * stored:.1f} TB a day.",
        ]
    lines += [
        "",
        "**What breaks first,** in this order:",
        "1. *Storage.* Every trial keeps its depth frames and joint states at the full rate. Recordings of trials that "
        "went through would have to be thinned after scoring; nothing does that yet.",
        f"2. *This page.* Its last table has a line per trial; at {OBJECTS:,} it would have "
        f"{1e-6 * OBJECTS * LINE_BYTES:.0f} MB. Resuming reads the result file once and remains quick.",
        "3. *People.* A failed trial on a real arm waits for a hand; the share of trials that ended without a "
        "manipulation times the number of arms is a crew, not a number to be optimised in software.",
        "4. *The network* only if cells are joined: each arm's 1 kHz states stay within its cell, host beside "
        "executor; nothing central subscribes to them.",
        "",
        "The jobs share nothing, so no part of this grows faster than their number. Tried here: the Ray backend with "
        "two workers, one of them killed (`pytest -m prove tests/unit/sim/test_batch.py`).",
    ]
    return lines
