"""`python tests/bench/bench_demo.py --seeds 1-10`: the demo over many hidden drawers, as a markdown table.

Each seed runs `s2r demo --json` in a folder of its own; finished seeds are kept and skipped, so an interrupted
run resumes with the same options. The truth in the table is opened by the demo only after the host has finished.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from refusals import told_by

from s2r_protocol.cli.conditions import keep_to


def _seeds(text):
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def _run(seed, out, target, more):
    folder = out / f"seed-{seed:03d}"
    result = folder / "demo.json"
    if result.exists():
        return json.loads(result.read_text())
    start = time.monotonic()
    command = [sys.executable, "-m", "s2r_protocol", "demo", "--seed", str(seed), "--target", str(target)]
    command += more
    done = subprocess.run([*command, "--out", str(folder), "--json"], capture_output=True, text=True)
    if done.returncode == 130:
        sys.exit(130)
    summary = json.loads(done.stdout) if done.stdout.strip() else {"seed": seed}
    summary |= {"exit_code": done.returncode, "wall_s": time.monotonic() - start}
    if done.returncode:
        summary["error"] = done.stderr.strip().splitlines()[-1] if done.stderr.strip() else ""
    folder.mkdir(parents=True, exist_ok=True)
    result.write_text(json.dumps(summary, indent=2))
    return summary


def _row(s):
    def millimetres(key):
        return f"{1e3 * s[key]:+.1f}" if s.get(key) is not None else "–"

    percent = f"{100 * s['delta_r_true']:+.1f}" if s.get("delta_r_true") is not None else "–"
    return (
        f"| {s['seed']} | {s['exit_code']} | {millimetres('delta_first_true')} | {millimetres('delta_true')} | "
        f"{percent} | {millimetres('delta_measured')} | {s.get('attempts', '–')} | {s['wall_s']:.0f} |"
    )


def _within(delta):
    return delta is not None and abs(delta) <= 0.005


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=_seeds, default=_seeds("1-10"))
    parser.add_argument("--target", type=float, default=0.15)
    parser.add_argument("--reactive", action="store_true", help="see s2r run --reactive")
    parser.add_argument("--pace", type=float, default=1.0, help="simulated over real seconds")
    parser.add_argument("--out", type=Path, default=Path("runs/bench-demo"))
    options = parser.parse_args()
    conditions = {name: getattr(options, name) for name in ("target", "reactive", "pace")}
    with told_by(parser):
        keep_to(conditions, options.out / "seeds", begun=any(options.out.glob("seed-*/demo.json")))
    print(
        "| seed | exit | δ first attempt, mm | δ true, mm | δ_r true, % | δ by camera, mm | attempts | wall, s |"
    )
    print("|---|---|---|---|---|---|---|---|", flush=True)
    results, more = [], ["--pace", str(options.pace), *(["--reactive"] if options.reactive else [])]
    for seed in options.seeds:
        results.append(_run(seed, options.out, options.target, more))
        print(_row(results[-1]), flush=True)
    good = [s for s in results if s["exit_code"] == 0 and _within(s.get("delta_true"))]
    print(f"\n|δ| ≤ 5 mm: {len(good)} of {len(results)}")


if __name__ == "__main__":
    main()
