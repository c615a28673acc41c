"""Does the motion that `s2r gap` proposes decide? It is played on the machine whose physics is concealed.

    python tests/bench/bench_gap_experiment.py --out DIR [--seed N] [--cases 12] [--blind 2] [--duration 12]

Draws single effects of the declared classes on one joint, and as many recordings without effort as ``--blind`` says,
writes them as files, and asks the tool for names and the next experiment. Where the answer leaves a rival or asks for
effort, the hidden machine plays the exported commands (without effort: its first motion once more, with effort), twice,
and the tool is asked again with the new recordings beside the old. The tool reads files alone; truth stays here.
Counted: first names right before and after, where the proposal splits nothing ("the same equation here"), and where
none was made. A case already answered is not answered again: an interrupted bench goes on with the same command.
"""

import argparse
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from refusals import told_by

from s2r_conceal.cases import Case, draw_cases, machine_of_the_file
from s2r_conceal.draw import calibrated
from s2r_conceal.motions import RATE_HZ
from s2r_conceal.record import record
from s2r_conceal.score_case import score_case
from s2r_conceal.score_files import read_track
from s2r_conceal.setting import motion_along
from s2r_conceal.strength import Measured
from s2r_conceal.write import sidecar, table_text, write_case
from s2r_host.gap.verdict.naming import EQUIVALENT
from s2r_protocol.cli.conditions import keep_to

S2R = [sys.executable, "-c", "from s2r_protocol.cli.root import main; main()"]
SWITCHES = "simulate: false\nbaselines: false\nreport: false\n"
ALIKE = {name for group in EQUIVALENT for name in group}
OVERSAMPLED = 8  # plans drawn per case kept: most effects belong to no class
CLEAR = 3.0  # floors


def chosen(seed: int, count: int, blind: int, duration_s: float) -> list[Case]:
    """Cases before their strengths are set: effects that look alike, then some without an effort channel."""
    drawn = draw_cases(
        seed, "one_joint", {"single": OVERSAMPLED * count, "masked": OVERSAMPLED * blind}, duration_s
    )
    alike = [c for c in drawn if c.group == "single" and c.effects[0].name in ALIKE and c.plan[2] >= CLEAR]
    return alike[:count] + [c for c in drawn if c.group == "masked" and c.mask.no_effort][:blind]


def asked(place: Path, names: list[str], out: Path) -> dict:
    """The tool's answer on a case, from the files alone."""
    answer = out / "gap.json"
    if not answer.is_file():
        config = place / "gap.yaml"
        config.write_text(SWITCHES, encoding="utf-8")
        roles = ["--fit", "fit.csv", *(f"{n}.csv" for n in names[:1])]
        roles += ["--holdout", "holdout.csv", "--repeat", "repeat.csv", *(f"{n}.csv" for n in names[1:])]
        command = [
            *S2R,
            "gap",
            "--model",
            "model.xml",
            *roles,
            "--config",
            "gap.yaml",
            "--out",
            str(out.resolve()),
        ]
        ended = subprocess.run(command, cwd=place, check=False, capture_output=True, text=True)
        if not answer.is_file():
            sys.exit(f"{place}: the tool gave no answer (exit {ended.returncode}): {ended.stderr[-500:]}")
    return json.loads(answer.read_text(encoding="utf-8"))


def played(case: Case, measured: Measured, proposed: Path, place: Path) -> list[str]:
    """Let the hidden machine play the proposed commands, twice; the names of the recordings."""
    table = read_track(proposed)
    t = np.arange(round(table["t"][-1] * RATE_HZ)) / RATE_HZ
    q = np.stack([np.interp(t, table["t"], table[f"q_cmd.{n}"]) for n in case.rig.joint_names], axis=1)
    motion = motion_along(case.rig, machine_of_the_file(case), q, case.feed_forward)
    again = replace(case, seed=(*case.seed[:2], 77), motions=dict.fromkeys(case.motions, motion))
    names = ["experiment", "experiment-again"]
    if not all((place / f"{n}.csv").is_file() for n in names):
        (made,) = record([again], [measured])
        for name, role in zip(names, ("fit", "repeat"), strict=True):
            (place / f"{name}.yaml").write_text(json.dumps(sidecar(again, role)), encoding="utf-8")
            (place / f"{name}.csv").write_text(table_text(again, made.recordings[role]), encoding="utf-8")
    return names


def asked_again(case: Case, measured: Measured, answer: dict, place: Path) -> dict | None:
    """The answer with what was proposed done; None where nothing was."""
    if case.mask.no_effort:  # "record effort": the same motions with it
        if not (place / "again/model.xml").is_file():
            (made,) = record([replace(case, mask=replace(case.mask, no_effort=False))], [measured])
            write_case(place / "again", made)
        return asked(place / "again", [], place / "after")
    proposed = answer["next_experiment"].get("trajectory")
    if not proposed:
        return None
    return asked(place, played(case, measured, place / "before" / proposed, place), place / "after")


def first_right(name: str, truth: dict, answer: dict, place: Path) -> bool:
    """Is the first name the true one, among effects or, where either counts, among numbers?"""
    tracks = {role: read_track(place / f"{role}.csv") for role in ("fit", "holdout")}
    score = score_case(name, truth, {"exit_code": 7, "gap": answer}, tracks)
    return score.named[:1] != () and score.named[0] in score.truth_names


def undecided(case: Case, answer: dict) -> bool:
    """Does the answer leave a rival, or is it that effort is lacking?"""
    told = [*answer["effects"], *answer["parameters_off"]]
    return case.mask.no_effort or any(e.get("could_also_be") for e in told)


def main() -> None:
    """Draw, ask, play, ask again, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=12, help="with effort, of effects that look alike")
    parser.add_argument("--blind", type=int, default=2, help="without an effort channel")
    parser.add_argument("--duration", type=float, default=12.0, help="of each recording [s]")
    options = parser.parse_args()
    conditions = {name: getattr(options, name) for name in ("seed", "cases", "blind", "duration")}
    with told_by(parser):
        keep_to(
            conditions, options.out / "experiment.json", begun=any(options.out.glob("case-*/before/gap.json"))
        )
    cases, measured = calibrated(chosen(options.seed, options.cases, options.blind, options.duration))
    rows = []
    for k, (case, own, made) in enumerate(zip(cases, measured, record(cases, measured), strict=True)):
        name = f"case-{k:02d}"
        place = options.out / name
        if not (place / "model.xml").is_file():
            write_case(place, made)
        before = asked(place, [], place / "before")
        row = {"case": name, "truth": made.truth["effects"][0]["name"], "undecided": undecided(case, before)}
        row["before"] = first_right(name, made.truth, before, place)
        row["why"] = before["next_experiment"]["why"]
        after = asked_again(case, own, before, place) if row["undecided"] else None
        if after is not None:
            row["after"] = first_right(name, made.truth, after, place)
            row["named"] = [e["name"] for e in [*after["effects"], *after["parameters_off"]]]
        rows.append(row)
        print(json.dumps(row), flush=True)
        (options.out / "experiment.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    open_ones = [r for r in rows if r["undecided"]]
    tried = [r for r in open_ones if "after" in r]
    print(f"{len(rows)} cases, {len(open_ones)} undecided, of these {len(tried)} with a motion to play")
    print(f"first name right before {sum(bool(r['before']) for r in tried)} of {len(tried)}")
    print(f"first name right after {sum(bool(r['after']) for r in tried)} of {len(tried)}")
    same = sum("same equation" in r["why"] for r in open_ones)
    print(
        f"told to be the same equation: {same}; other undecided without a motion: {len(open_ones) - len(tried) - same}"
    )


if __name__ == "__main__":
    main()
