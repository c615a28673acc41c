"""Concealed objects as an arm feels them: how often `s2r gap` finds, invents or rightly leaves open.

    python tests/bench/bench_gap_objects.py --out DIR --seed N [--each 5] [--clean 10] [--only EFFECT,...] [--jobs 2]
        [--json]

Draws drawers, lids and levers with one effect of the joint hidden, lets the host push and manipulate each as
`s2r bench missing` does (in one process, about 25 s), hands the recordings of the joint and the believed object to the
gap tool, and only then opens the answers, which lie apart in ``DIR/sealed``. It may be stopped and started again: runs,
recordings and answers that are there are kept, which is also how a set is drawn elsewhere with ``--unasked`` and asked
later. ``--felt-again`` makes the recordings anew from the kept runs, ``--again`` asks anew: for work on either. A set
whose answers were opened serves for tuning from then on.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from gap_objects.hidden import HIDDEN
from gap_objects.one import asked, felt, folder_of, of_another_seed
from gap_objects.score import brief, judged, table
from gap_objects.strength import FELT, at_stop, strength

from s2r_sim.batch import run_jobs


def cases(each: int, clean: int, effects: list[str], kinds: list[str]) -> list[tuple[str, int]]:
    """Effect and index of every object."""
    return [
        (effect, index)
        for effect, hidden in HIDDEN.items()
        for index in range(each if hidden.names else (clean + 1) // 2)
        if effect in effects and hidden.kinds[index % len(hidden.kinds)] in kinds
    ]


def main() -> None:
    """Draw, run, ask, open."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--each", type=int, default=5, help="objects per effect")
    parser.add_argument("--clean", type=int, default=10, help="objects without an effect")
    parser.add_argument("--only", default=",".join(HIDDEN), help="effects, comma-separated")
    parser.add_argument("--kinds", default="drawer,laptop,faucet", help="of object, comma-separated")
    parser.add_argument("--jobs", type=int, default=1, help="objects at a time")
    parser.add_argument(
        "--felt-again", action="store_true", help="make the recordings anew from the kept runs"
    )
    parser.add_argument("--again", action="store_true", help="ask the gap tool anew")
    parser.add_argument("--unasked", action="store_true", help="only run: nothing is asked, nothing opened")
    parser.add_argument("--json", action="store_true", help="print the rows")
    options = parser.parse_args()
    for option, given, there in (
        ("--only", options.only.split(","), list(HIDDEN)),
        ("--kinds", options.kinds.split(","), ["drawer", "laptop", "faucet"]),
    ):
        if unknown := [name for name in given if name not in there]:
            parser.error(f"{option} names '{unknown[0]}'; there are {', '.join(there)}")
    out = str(options.out)
    todo = cases(options.each, options.clean, options.only.split(","), options.kinds.split(","))
    if other := [folder for case in todo if (folder := of_another_seed(options.out, *case, options.seed))]:
        parser.error(
            f"{other[0]} holds an object of another --seed, or of another program: give another --out"
        )
    with tempfile.TemporaryDirectory() as results:  # what lasts is in the objects' folders
        run = [(out, *case, options.seed, options.felt_again) for case in todo]
        run_jobs(felt, run, Path(results) / "runs.jsonl", options.jobs, "objects")
        if options.unasked:
            return
        ask = [(out, *case, options.again or options.felt_again) for case in todo]
        answers = run_jobs(asked, ask, Path(results) / "answers.jsonl", options.jobs, "answers")
    rows = []
    for case, answer in zip(todo, answers, strict=True):
        folder = folder_of(options.out, *case)
        drawn = (*case, options.seed, folder)
        said = {"judged": judged(case[0], answer, at_stop(*drawn)), "strength": strength(*drawn)}
        rows.append({"case": folder.name, "effect": case[0], **said, **answer})
    if options.json:
        print(json.dumps(rows, indent=1))
        return
    for row in rows:
        print(f"{row['case']:<24} {row['judged']:<8} {row['strength']:5.1f} {brief(row)}")
    print("\n".join(["", *table(rows), "", f"Where {FELT} of the accuracy or more was felt of it:", ""]))
    print("\n".join(table([row for row in rows if row["strength"] >= FELT])))


if __name__ == "__main__":
    main()
