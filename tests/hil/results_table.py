"""Writes the table of faults in docs/safety.md from the results of `make prove`: ``python tests/hil/results_table.py``.

Every row is a fault; its tests are those whose names begin with its number. A row without a passing test says so.
"""

from __future__ import annotations

import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/safety.md"
RESULTS = ROOT / "build/prove"
BEGIN, END = "<!-- prove: begin -->", "<!-- prove: end -->"

CORE = "real s2r-rt, virtual time"
CLASS = "core class, virtual time"
FRONT = "front end and s2r-rt, virtual time"
LIVE = "real processes, Zenoh, lock-step"

FAULTS: tuple[tuple[str, str, str], ...] = (
    ("T01", "host killed in mid-plan", f"{FRONT}; {LIVE}"),
    ("T02", "host frozen, then awake again", FRONT),
    ("T03", "host pauses 30 ms", FRONT),
    ("T04", "network cut", FRONT),
    ("T05", "front end killed or silent", f"{FRONT}; {CLASS}; {LIVE}"),
    ("T06", "core killed", f"{CORE}; {LIVE}"),
    ("T07", "core stalls 2, 5, 20 ms", CLASS),
    ("T08", "NaN, infinity, denormal in any field", LIVE),
    ("T09", "position outside only between knots", LIVE),
    ("T10", "velocity, acceleration, jerk beyond the limit", LIVE),
    ("T11", "torque exceeded only with the payload", LIVE),
    ("T12", "collision only in mid-segment", LIVE),
    ("T13", "times that do not rise, or huge ones", LIVE),
    ("T14", "no points, too many, a 2 GB length field", LIVE),
    ("T15", "wrong joint count, order, duplicate", LIVE),
    ("T16", "start off by 0.01 rad", LIVE),
    ("T17", "plan ends in motion", LIVE),
    ("T18", "stale sequence, epoch, process", LIVE),
    ("T19", "message duplicated a thousand times", LIVE),
    ("T20", "two plans in the wrong order", LIVE),
    ("T21", "message damaged or cut", LIVE),
    ("T22", "splice that meets the running plan", FRONT),
    ("T23", "splice that misses it", FRONT),
    ("T24", "splice that comes late", FRONT),
    ("T25", "50 Hz of random replacement plans", f"{FRONT}; {CLASS}, 100 000 plans"),
    ("T26", "cancel at every tick", CLASS),
    ("T27", "cancel with a following error", CORE),
    ("T28", "random pauses and speeds", CLASS),
    ("T29", "wall clock jumps", CORE),
    ("T30", "clocks 500 ppm apart for 10 h", "virtual"),
    ("T31", "counters wrap", CLASS),
    ("T32", "1, 2, 3 setpoints lost", CORE),
    ("T33", "4 and more setpoints lost", CORE),
    ("T34", "1, 3, 10 answers of a joint lost", CORE),
    ("T35", "answers late, or frozen with a live counter", CORE),
    ("T36", "damaged, foreign, mislabelled frames", CORE),
    ("T37", "babbling node", CORE),
    ("T38", "error passive, bus off, cable cut", CORE),
    ("T39", "second master", CORE),
    ("T40", "transmit queue full", f"{CORE}; {CLASS}"),
    ("T41", "drive fault, each joint", CORE),
    ("T42", "drive silently leaves operation enabled", CORE),
    ("T43", "encoder jumps, flips, sticks", CORE),
    ("T44", "following error at the window's edge", CORE),
    ("T45", "contact: torque away from the plan's", CORE),
    ("T46", "heat, under-voltage", CORE),
    ("T47", "brake does not open, does not close, falls in", CORE),
    ("T48", "emergency stop at a random moment", f"{CORE}; {CLASS}, 10 000 times"),
    ("T49", "bouncing contact, one channel only", CORE),
    ("T50", "reset too early, or held", CORE),
    ("T51", "core restarted while holding, while moving", CORE),
    ("T52", "power cycle of one drive", CORE),
    ("T53", "two hosts claim the lease", f"{FRONT}; {LIVE}"),
    ("T54", "wrong, expired, missing certificate; unlisted key", "real Zenoh sessions"),
    ("T55", "model or limit hash of another arm", LIVE),
    ("T56", "disk full, log consumer stalled", f"{LIVE}; {CORE}"),
    ("T57", "CPU, I/O and memory hogs", f"{CORE}; lateness only on a real-time machine (marked `realtime`)"),
    ("T58", "edited, foreign, faster recording", LIVE),
    ("T59", "random pairs of faults", f"{CLASS}, 10 000 pairs"),
)
ELSEWHERE = {"T54": "tests/integration/test_session_security.py"}
SUMMARIES = ("native", "sanitize", "fuzz", "libfuzzer", "coverage", "mutate", "tidy")


@dataclass
class Count:
    """Of one test function."""

    passed: int = 0
    failed: int = 0
    skipped: int = 0


def results() -> dict[tuple[str, str], Count]:
    """(file, function) -> counts over its parameters."""
    counts: dict[tuple[str, str], Count] = defaultdict(Count)
    cases = (
        case
        for path in sorted((RESULTS / "faults").glob("*.xml"))
        for case in ET.parse(path).iter("testcase")
    )
    for case in cases:
        file = case.get("classname", "").replace(".", "/") + ".py"
        count = counts[file, case.get("name", "").partition("[")[0]]
        if case.find("failure") is not None or case.find("error") is not None:
            count.failed += 1
        elif case.find("skipped") is not None:
            count.skipped += 1
        else:
            count.passed += 1
    return counts


def row(number: str, title: str, clock: str, counts: dict[tuple[str, str], Count]) -> tuple[str, bool]:
    """A line of the table, and whether the fault is proven."""
    chosen = {
        key: count
        for key, count in counts.items()
        if (
            key[0] == ELSEWHERE[number]
            if number in ELSEWHERE
            else key[1].startswith(f"test_{number.lower()}_")
        )
    }
    passed, failed = sum(c.passed for c in chosen.values()), sum(c.failed for c in chosen.values())
    names = "<br>".join(f"`{file}::{name}`" for file, name in sorted(chosen))
    verdict = f"{passed} pass" if not failed else f"{passed} pass, **{failed} FAIL**"
    return f"| {number} | {title} | {clock} | {names} | {verdict if chosen else '**no test**'} |", bool(
        passed
    ) and not failed


def _mutation(said: list[str]) -> list[str]:
    """The totals, then each survivor with the reason why nothing could notice it."""
    survivors = (text.partition("  -- ") for text in said[:-1])
    return [said[-1], *(f"survivor `{where}`: {why}" for where, _, why in survivors)]


def revision() -> str:
    """Commit that the results belong to, and whether the tree held more than that."""
    said = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--abbrev=10"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    commit, dirty, _ = said.stdout.strip().partition("-dirty")
    return f"commit {commit}" + (" with changes that were not committed" if dirty else "")


def main() -> int:
    """Write the table; 7 if a fault is not proven."""
    counts = results()
    lines = [
        BEGIN,
        "",
        f"Proven on {revision()}.",
        "",
        "| fault | injected | how | tests | result |",
        "|---|---|---|---|---|",
    ]
    proven = 0
    for fault in FAULTS:
        line, good = row(*fault, counts)
        lines.append(line)
        proven += good
    lines += ["", f"{proven} of {len(FAULTS)} rows hold.", ""]
    for name in SUMMARIES:
        file = RESULTS / f"{name}.txt"
        if file.exists():
            said = [text for text in file.read_text().splitlines() if text.strip()]
            lines += [f"- {text}" for text in (said if name != "mutate" else _mutation(said))]
    page = PAGE.read_text()
    if BEGIN not in page:
        sys.exit(f"{PAGE} has no {BEGIN}")
    text = "\n".join([*lines, "", END])
    PAGE.write_text(re.sub(f"{BEGIN}.*{END}", lambda _: text, page, flags=re.DOTALL))
    print(f"{proven} of {len(FAULTS)} rows hold; docs/safety.md is written")
    return 0 if proven == len(FAULTS) else 7


if __name__ == "__main__":
    sys.exit(main())
