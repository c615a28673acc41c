"""Real recordings: what `s2r gap` says about machines it never saw, beside what is known about them.

    python tests/bench/bench_gap_real.py [--only emps,ur10e] --out DIR [--pages docs/machines]

Converts each public data set to the tool's input, runs the command as a user would, and writes ``table.md``. Cases
whose answer was made by the same tool from the same input are not run again; with ``--answered`` none is that has an
answer. ``--pages`` writes a page per machine, with the picture of its report that shows what was found. Budget: one
minute for one joint, ten for six, per case (wall time of the command, two cores).
"""

import argparse
import hashlib
import importlib
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import yaml

sys.path.insert(0, str(Path(__file__).parent))

from gap_real.case import Case, Check, effects_text, shared_data
from gap_real.page import Answered, write_page

MACHINES = ("emps", "brfd", "dfki", "laas", "pr2", "rokae", "ur10e")
FOLDERS = {
    "brfd": "brfd_friction_backlash", "dfki": "dfki_simple_pendulum", "laas": "laas_cogging", "pr2": "pr2_cabinet",
    "rokae": "rokae_xmate3pro_recording",
}  # fmt: skip
COMMAND = [sys.executable, "-c", "from s2r_protocol.cli.root import main; main()", "gap"]


def tool_hash() -> str:
    """Hash of the tool's source: an answer is only as fresh as that."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[2].glob("host/s2r_host/gap/**/*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def run_case(case: Case, out: Path, tool: str, *, answered: bool = False) -> tuple[dict | None, str]:
    """Answer of one case and a remark; from the last run when nothing changed, or whatever did where ``answered``."""
    folder = out / "answers" / case.name
    folder.mkdir(parents=True, exist_ok=True)
    model = out / "answers" / case.after / "model_patched.xml" if case.after else case.model
    digest = hashlib.sha256(tool.encode())
    for path in (model, *case.fit, *case.holdout, *case.repeat):
        if not path.is_file():
            return None, f"{path.name} is missing"
        digest.update(path.read_bytes())
        beside = path.with_suffix(".yaml")  # what a recording's columns are
        digest.update(beside.read_bytes() if beside.is_file() else b"")
    digest.update(json.dumps(case.config).encode())
    stamp, answer = folder / "stamp", folder / "gap.json"
    same = stamp.is_file() and stamp.read_text(encoding="utf-8") == digest.hexdigest()
    if answer.is_file() and (same or answered):
        return json.loads(answer.read_text(encoding="utf-8")), "unchanged" if same else "as answered before"
    shutil.rmtree(folder)  # the tool refuses a folder with half an answer
    folder.mkdir()
    config = folder / "gap.yaml"
    config.write_text(yaml.safe_dump(case.config), encoding="utf-8")
    parts = [*COMMAND, "--model", str(model), "--config", str(config), "--out", str(folder)]
    for flag, paths in (("--fit", case.fit), ("--holdout", case.holdout), ("--repeat", case.repeat)):
        parts += [flag, *map(str, paths)] if paths else []
    started = time.monotonic()
    done = subprocess.run(parts, capture_output=True, text=True, env=os.environ, check=False)
    (folder / "log.txt").write_text(done.stderr, encoding="utf-8")
    if not answer.is_file():
        return None, f"exit code {done.returncode}: {done.stderr.strip().splitlines()[-1:]}"
    stamp.write_text(digest.hexdigest(), encoding="utf-8")
    return json.loads(answer.read_text(encoding="utf-8")), f"{time.monotonic() - started:.0f} s"


def main() -> int:
    """Run what was asked for and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default=",".join(MACHINES), help="machines, comma separated")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--pages", type=Path, help="folder of the pages to write, one per machine")
    parser.add_argument("--answered", action="store_true", help="run no case again that has an answer")
    args = parser.parse_args()
    wanted = args.only.split(",")
    unknown = [m for m in wanted if m not in MACHINES]
    if unknown:
        parser.error(f"--only names '{unknown[0]}'; machines are {', '.join(MACHINES)}")
    args.out.mkdir(parents=True, exist_ok=True)
    tool = tool_hash()
    lines = ["| case | verdict | known | found | |", "|---|---|---|---|---|"]
    right = total = 0
    for number, machine in enumerate(wanted, 1):
        print(f"[{number}/{len(wanted)}] {machine}", file=sys.stderr, flush=True)
        if not (shared_data() / FOLDERS.get(machine, machine)).is_dir():
            lines.append(f"| {machine} | recordings absent | | | |")
            continue
        data = args.out / "data" / machine
        data.mkdir(parents=True, exist_ok=True)
        module = importlib.import_module(f"gap_real.{machine}")
        answers = []
        for case in module.cases(data):
            answer, remark = run_case(case, args.out, tool, answered=args.answered)
            print(f"  {case.name}: {remark}", file=sys.stderr, flush=True)
            checks = case.judge(answer) if answer else [Check("an answer", remark, False)]
            answers.append(Answered(case, answer, checks))
            verdict = effects_text(answer) + f" ({answer['wall_s']:.0f} s)" if answer else "none"
            for i, check in enumerate(checks):
                head = (case.name, verdict) if i == 0 else ("", "")
                lines.append(
                    f"| {head[0]} | {head[1]} | {check.known} | {check.found} | {'yes' if check.ok else 'NO'} |"
                )
                right, total = right + check.ok, total + 1
        if args.pages is not None:
            write_page(module.PAGE, machine, answers, args.out / "answers", args.pages)
    text = "\n".join(lines) + f"\n\n{right} of {total} agree with what is known.\n"
    (args.out / "table.md").write_text(text, encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
