"""Concealed objects as an arm feels them: how often `s2r gap` finds, invents or rightly leaves open.

    python tests/bench/bench_gap_objects.py --out DIR --seed N [--each 5] [--clean 10] [--only EFFECT,...] [--json]

Draws drawers, lids and levers with one effect of the joint hidden, lets the host push and manipulate each as
`s2r bench missing` does (in one process, about 15 s), hands the recordings of the joint and the believed object to the
gap tool, and only then opens the answers, which lie apart in ``DIR/sealed``. It may be stopped and started again: runs,
recordings and answers that are there are kept. ``--felt-again`` makes the recordings anew from the kept runs,
``--again`` asks anew: for work on either. A set whose answers were opened serves for tuning from then on.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from gap_objects.feel import recordings, run_host
from gap_objects.hidden import HIDDEN, draw
from gap_objects.score import Row, brief, judged, table
from rich.console import Console
from rich.progress import track

from s2r_host.run.physics import ask_gap
from s2r_protocol.exits import S2RError
from s2r_sim.missing.score import told

NOTHING_TOLD: Row = {"effects": [], "parameters_off": [], "notes": [], "wall_s": 0.0}


def cases(each: int, clean: int) -> list[tuple[str, int]]:
    """Effect and index of every object."""
    return [
        (effect, index)
        for effect, hidden in HIDDEN.items()
        for index in range(each if hidden.names else (clean + 1) // 2)
    ]


def felt(out: Path, effect: str, index: int, seed: int, anew: bool) -> Path:
    """Folder with what the gap tool gets of one object; without ``believed.xml`` where the arm felt nothing."""
    name = f"{effect}-{index:02d}".replace(" ", "-")
    folder, done = out / "set" / name, out / "set" / name / "done"
    if anew or not done.is_file():
        trial = draw(effect, index, seed)
        sealed = out / "sealed" / f"{name}.json"
        sealed.parent.mkdir(parents=True, exist_ok=True)
        trial.world.save(sealed)
        recordings(run_host(trial, out / "runs" / name), folder)
        done.touch()
    return folder


def asked(folder: Path) -> Row:
    """The gap tool's answer to one folder; it gets no other."""
    believed = folder / "believed.xml"
    if not believed.is_file():
        return NOTHING_TOLD | {"verdict": "no recordings"}
    try:
        _, answer = ask_gap(believed, sorted((folder / "object-log").glob("*.csv")), 0)
    except S2RError as error:
        return NOTHING_TOLD | {"verdict": "refused", "notes": [str(error)]}
    return told(answer) | {"notes": answer["notes"], "wall_s": answer["wall_s"]}


def answer_of(folder: Path, anew: bool) -> Row:
    """As :func:`asked`, from its file where it was asked before."""
    path = folder / "answer.json"
    if anew or not path.is_file():
        path.write_text(json.dumps(asked(folder), indent=1) + "\n", encoding="utf-8")
    return json.loads(path.read_text(encoding="utf-8"))


def main() -> None:
    """Draw, run, ask, open."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--each", type=int, default=5, help="objects per effect")
    parser.add_argument("--clean", type=int, default=10, help="objects without an effect")
    parser.add_argument("--only", default="", help="effects, comma-separated")
    parser.add_argument(
        "--felt-again", action="store_true", help="make the recordings anew from the kept runs"
    )
    parser.add_argument("--again", action="store_true", help="ask the gap tool anew")
    parser.add_argument("--json", action="store_true", help="print the rows")
    options = parser.parse_args()
    chosen = options.only.split(",") if options.only else list(HIDDEN)
    todo = [case for case in cases(options.each, options.clean) if case[0] in chosen]
    errors = Console(stderr=True)
    folders = [
        felt(options.out, effect, index, options.seed, options.felt_again)
        for effect, index in track(todo, "objects", console=errors)
    ]
    answers = [
        answer_of(folder, options.again or options.felt_again)
        for folder in track(folders, "answers", console=errors)
    ]
    rows = [
        {"case": folder.name, "effect": effect, "judged": judged(effect, answer), **answer}
        for (effect, _), folder, answer in zip(todo, folders, answers, strict=True)
    ]
    if options.json:
        print(json.dumps(rows, indent=1))
        return
    for row in rows:
        print(f"{row['case']:<24} {row['judged']:<8} {brief(row)}")
    print("\n".join(["", *table(rows)]))


if __name__ == "__main__":
    main()
