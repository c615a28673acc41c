"""Concealed recordings: how often `s2r gap` finds, invents or rightly refuses.

    python tests/bench/bench_gap_concealed.py run --out DIR [--rig one_joint] [--cases single=120,...] [--seed N]
    python tests/bench/bench_gap_concealed.py calibrate DIR/score [DIR/score ...]
    python tests/bench/bench_gap_concealed.py shuffled DIR/score
    python tests/bench/bench_gap_concealed.py ablate DIR/score
    python tests/bench/bench_gap_concealed.py alone DIR/score
    python tests/bench/bench_gap_concealed.py pooled DIR/score [DIR/score ...]

``run`` draws a set, runs the tool over it and scores it, in that order; without ``--seed`` the seed is random and
stands only in the key file. It may be stopped and started again, with the same options. Commit before drawing: the
commit is written beside the table, and every other one with which the set was gone on with. Without ``--full`` the tool
gives names, places and parameters only, without forward simulations, baselines, next experiments and reports, at a few
seconds per case. ``calibrate`` reads the temperatures and the ceiling of the stated probabilities from scored tuning
sets, on cases that hide an effect of the catalogue and were answered with one: what is stated supposes that there is
one. ``shuffled`` scores the same verdicts with the true names dealt out anew: the accuracy must fall to chance;
``ablate`` runs the single cases of three floors and more that were named rightly once more without the true effect in
the catalogue: the answer must turn to "unknown" at the same joint; ``alone`` runs the clean and unknown cases and the
single ones of three floors and more without their second runs of the motion, as most logs are; ``pooled`` is the table
over the cases of several scored sets together. Budget: 60 s per case for one joint and 20 s of data, on two cores.
"""

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from s2r_conceal.score import table
from s2r_conceal.score_case import CaseScore, Interval
from s2r_conceal.score_files import markdown
from s2r_host.gap.verdict.naming import ALIKE_HEAT, CEILING, HEAT, alike

S2R = [sys.executable, "-c", "from s2r_protocol.cli.root import main; main()"]
TOOL = ("host/s2r_host/gap", "sim/s2r_conceal")
LEAST_STRENGTH = 3.0
NAMES_ONLY = "simulate: false\nbaselines: false\nreport: false\nnext_experiment: false\n"
NUMBER_NAMES = {"payload_mass": "payload"}
EITHER_LIST = ("payload", "armature", "effort_scale", "gravity_tilt")  # right as an effect and as a number
CASES = "single=120,clean=60,unknown=32,pairs=30,masked=12,insufficient=8,wrong_log=8"


def commit() -> str:
    """Commit of the tool, with a mark when its files were changed since."""
    here = Path(__file__).parents[2]
    head = subprocess.check_output(["git", "rev-parse", "HEAD"], cwd=here, text=True).strip()
    changed = subprocess.check_output(["git", "status", "--short", *TOOL], cwd=here, text=True)
    return head + (" with changes" if changed else "")


def run(arguments: argparse.Namespace) -> None:
    """Draw, run and score one set."""
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    folder, key = out / "set", out / "key.json"
    if (folder / "manifest.json").is_file():
        check_asked(arguments, json.loads(key.read_text(encoding="utf-8"))["drawn_with"])
    if not (folder / "verdicts.json").is_file():
        note_commit(out / "commit")
    if not (folder / "manifest.json").is_file():
        seed = [] if arguments.seed is None else ["--seed", str(arguments.seed)]
        parts = ["--rig", arguments.rig, "--cases", arguments.cases, "--workers", str(arguments.workers)]
        parts += ["--duration", str(arguments.duration)]
        subprocess.run([*S2R, "conceal", "draw", *parts, *seed, "--out", folder, "--key", key], check=True)
    tool = f'{sys.executable} -c "from s2r_protocol.cli.root import main; main()" gap'
    config = arguments.config
    if config is None and not arguments.full:
        config = out / "names.yaml"
        config.write_text(NAMES_ONLY, encoding="utf-8")
    more = ["--config", str(config)] if config else []
    words = ["conceal", "run", str(folder), "--batch", "--workers", str(arguments.workers), "--command", tool]
    subprocess.run([*S2R, *words, *more], check=True)
    subprocess.run([*S2R, "conceal", "score", folder, "--key", key, "--out", out / "score"], check=True)
    print("tool commit", ", then ".join((out / "commit").read_text(encoding="utf-8").split("\n")[:-1]))


def check_asked(arguments: argparse.Namespace, drawn_with: dict) -> None:
    """Refuse to go on with a set that was drawn with other options."""
    counts = (part.partition("=") for part in arguments.cases.split(",") if part)
    asked = {"rig": arguments.rig, "cases": {name.strip(): int(n) for name, _, n in counts}}
    asked |= {"duration_s": arguments.duration}
    asked |= {} if arguments.seed is None else {"seed": arguments.seed}
    for name, value in asked.items():
        if drawn_with[name] != value:
            told = "another seed" if name == "seed" else f"{name} {drawn_with[name]!r}, not {value!r}"
            sys.exit(f"the set in {arguments.out} was drawn with {told}: give the same, or another --out")


def note_commit(path: Path) -> None:
    """Add the commit of the tool to those that are noted, where it is another one than the last."""
    noted = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    if noted[-1:] != [now := commit()]:
        path.write_text("\n".join([*noted, now]) + "\n", encoding="utf-8")


def named_cases(score: Path) -> list[dict]:
    """Cases of a score in which an effect of the catalogue was to be named, and one was named."""
    cases = json.loads((score / "score.json").read_text(encoding="utf-8"))["cases"]
    return [c for c in cases if c["top1"] is not None and c["named"]]


Row = tuple[
    np.ndarray, np.ndarray, bool
]  # log odds, best first; which are declared like the best; is it right?


def calibrate(arguments: argparse.Namespace) -> None:
    """Temperatures by maximum likelihood over a grid, ceiling as the share right among the sure ones."""
    rows: list[Row] = [row for score in arguments.scores for row in stated(score)]
    print(f"{len(rows)} named cases, {np.mean([right for _, _, right in rows]):.3f} right")
    best = max(
        (likelihood(rows, heat, alike, top), heat, alike, top)
        for heat in (0.0, 0.001, 0.003, 0.01, 0.02, 0.04, 0.08, 0.15)
        for alike in (0.0, 1.0, 2.0, 4.0, 8.0)
        for top in (0.85, 0.9, 0.93, 0.96, 0.97, 0.98, 0.99)
    )
    print(
        f"HEAT, ALIKE_HEAT, CEILING = {best[1]:g}, {best[2]:g}, {best[3]:g}  (mean log likelihood {best[0]:.4f})"
    )
    used = likelihood(rows, HEAT, ALIKE_HEAT, CEILING)
    print(f"in use {HEAT:g}, {ALIKE_HEAT:g}, {CEILING:g}  (mean log likelihood {used:.4f})")


def stated(score: Path) -> list[Row]:
    """Log odds of every first name of a scored set."""
    verdicts, rows = score.parent / "set" / "verdicts", []
    for case in named_cases(score):
        gap = json.loads((verdicts / f"{case['case']}.json").read_text(encoding="utf-8"))["gap"]
        first = gap["effects"][0] if gap["effects"] else {"log_odds": {}}
        if first["log_odds"] and first["name"] == case["named"][0]:
            names = sorted(first["log_odds"], key=lambda n: -first["log_odds"][n])
            odds = np.array([first["log_odds"][n] for n in names])
            rows.append((odds, np.array([alike(names[0], n) for n in names]), bool(case["top1"])))
    return rows


def likelihood(rows: list[Row], heat: float, alike_heat: float, ceiling: float) -> float:
    """Mean log likelihood of 'the first name is right' under one setting."""
    total = 0.0
    for odds, like, right in rows:
        cooled = 1.0 + heat * max(odds[0], 0.0) + alike_heat * like
        weights = np.exp(np.maximum((odds - odds[0]) / cooled, -60.0))
        p = float(np.clip(ceiling / weights.sum(), 1e-3, 1 - 1e-3))
        total += np.log(p if right else 1.0 - p)
    return total / max(len(rows), 1)


def shuffled(arguments: argparse.Namespace) -> None:
    """Accuracy with true names permuted among the cases, mean over 200 deals."""
    cases = [c for c in named_cases(arguments.score) if c["group"] == "single"]
    true = np.array([c["truth_names"][0] for c in cases])
    said = np.array([c["named"][0] for c in cases])
    rng = np.random.default_rng(0)
    dealt = [float(np.mean(rng.permutation(true) == said)) for _ in range(200)]
    print(
        f"{len(cases)} named single cases: right {np.mean(true == said):.3f}, shuffled {np.mean(dealt):.3f}"
    )


def ablate(arguments: argparse.Namespace) -> None:
    """Every rightly named single case once more, without its effect."""
    score: Path = arguments.score
    folder = score.parent / "set"
    answers = json.loads((score / "answers.json").read_text(encoding="utf-8"))
    cases = [
        c for c in named_cases(score)
        if c["group"] == "single" and c["top1"] and c["strength"] >= LEAST_STRENGTH
    ][: arguments.most]  # fmt: skip
    unknown = placed = 0
    for case in cases:
        name, place = case["case"], folder / case["case"]
        true = answers[name]["effects"][0]
        out = score.parent / "ablation" / name
        out.mkdir(parents=True, exist_ok=True)
        config = out / "gap.yaml"
        config.write_text(NAMES_ONLY + f"skip: [{true['name']}]\n", encoding="utf-8")
        gap = _answered(place, ("fit", "holdout", "repeat"), config, out)
        where = gap["where"][0]["joint"] if gap["where"] else None
        said = gap["effects"][0]["name"] if gap["effects"] else f"[{gap['verdict']}]"
        print(f"{name}: {true['name']} taken out -> {said} at {where}")
        unknown += gap["verdict"] == "unknown"
        placed += gap["verdict"] == "unknown" and where == true["joint"]
    print(f"{len(cases)} cases: unknown {unknown}, at the true joint {placed}")


def _answered(place: Path, roles: tuple[str, ...], config: Path, out: Path) -> dict:
    """gap.json of one case, from so many of its recordings; without a name where the tool gives none."""
    folder = out / "answer"
    shutil.rmtree(folder, ignore_errors=True)  # of an earlier case, or of earlier code
    folder.mkdir()
    answer = folder / "gap.json"
    files = [f"--{role}={place / role}.csv" for role in roles]
    parts = ["gap", f"--model={place / 'model.xml'}", *files, f"--config={config}", f"--out={folder}"]
    ended = subprocess.run([*S2R, *parts], check=False, capture_output=True)
    if not answer.is_file():
        return {"verdict": f"exit {ended.returncode}", "effects": [], "parameters_off": [], "where": []}
    return json.loads(answer.read_text(encoding="utf-8"))


def alone(arguments: argparse.Namespace) -> None:
    """What is named, invented and left unknown where no second run gives the noise floor."""
    score: Path = arguments.score
    cases = json.loads((score / "score.json").read_text(encoding="utf-8"))["cases"]
    kept = [c for c in cases if asked_alone(c)]
    folder, out = score.parent / "set", score.parent / "alone"
    out.mkdir(exist_ok=True)
    config = out / "names.yaml"
    config.write_text(NAMES_ONLY, encoding="utf-8")
    found: dict[str, list[bool]] = {"single": [], "clean": [], "unknown": []}
    for case in kept:
        place = folder / case["case"]
        gap = _answered(place, ("fit", "holdout"), config, out)
        said = [e["name"] for e in gap["effects"]]
        numbers = [NUMBER_NAMES.get(p["name"], p["name"]) for p in gap["parameters_off"]]
        if case["group"] == "single":
            true = case["truth_names"][0]
            right = said[:1] == [true] or (not said and true in EITHER_LIST and true in numbers)
        else:  # clean: nothing named and nothing called unknown; unknown: no name
            answered = not gap["verdict"].startswith(
                "exit"
            )  # a tool that fails has not rightly named nothing
            right = answered and not said and (case["group"] == "unknown" or gap["verdict"] != "unknown")
        found[case["group"]].append(right)
        words = ", ".join(said or numbers)
        print(
            f"{case['case']}: {case['truth_names'] or case['variant']} -> {gap['verdict']} {words}",
            flush=True,
        )
    print(
        f"single, first name right {sum(found['single'])} of {len(found['single'])}; clean without an alarm "
        f"{sum(found['clean'])} of {len(found['clean'])}; unknown without a name {sum(found['unknown'])} of "
        f"{len(found['unknown'])}"
    )


def asked_alone(case: dict) -> bool:
    """Clean, outside the catalogue, or a single effect of three floors and more."""
    return case["group"] in ("clean", "unknown") or (
        case["group"] == "single" and case["strength"] >= LEAST_STRENGTH
    )


def pooled(arguments: argparse.Namespace) -> None:
    """One table over the cases of several scored sets."""
    scores = [
        CaseScore(**case | {"intervals": [Interval(**i) for i in case["intervals"]]})
        for score in arguments.scores
        for case in json.loads((score / "score.json").read_text(encoding="utf-8"))["cases"]
    ]
    print(markdown(table(scores), scores))


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    sub = parser.add_subparsers(required=True)
    one = sub.add_parser("run")
    one.add_argument("--out", type=Path, required=True)
    one.add_argument("--rig", default="one_joint")
    one.add_argument("--cases", default=CASES)
    one.add_argument("--duration", type=float, default=20.0)
    one.add_argument("--seed", type=int, default=None)
    one.add_argument("--workers", type=int, default=2)
    one.add_argument("--config", type=Path, default=None)
    one.add_argument("--full", action="store_true", help="with forward simulation, baselines, reports")
    one.set_defaults(run=run)
    two = sub.add_parser("calibrate")
    two.add_argument("scores", type=Path, nargs="+")
    two.set_defaults(run=calibrate)
    two = sub.add_parser("shuffled")
    two.add_argument("score", type=Path)
    two.set_defaults(run=shuffled)
    three = sub.add_parser("ablate")
    three.add_argument("score", type=Path)
    three.add_argument("--most", type=int, default=None, help="at most so many cases")
    three.set_defaults(run=ablate)
    three = sub.add_parser("alone")
    three.add_argument("score", type=Path)
    three.set_defaults(run=alone)
    four = sub.add_parser("pooled")
    four.add_argument("scores", type=Path, nargs="+")
    four.set_defaults(run=pooled)
    arguments = parser.parse_args()
    try:
        arguments.run(arguments)
    except subprocess.CalledProcessError as error:
        sys.exit(error.returncode)  # it has said why


if __name__ == "__main__":
    main()
