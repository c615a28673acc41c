"""One trial: sealed world, stand-in, executor and host as separate processes, then the truth opened."""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import time
from pathlib import Path
from typing import TextIO

from s2r_protocol.arms import load_arm
from s2r_protocol.cli.peers import PeerFailedError, s2r_command, stand_in_cell
from s2r_protocol.exits import ExitCode, UsageError
from s2r_sim.errors import TruthFileError
from s2r_sim.paper.score import Row, score_trial
from s2r_sim.paper.trials import Trial, draw_trial
from s2r_sim.score import sense
from s2r_sim.sealed import TRUTH, WORLD, host_seed, nameless, sealed

TIMEOUT_S = 1200.0
MOST_TRIES = 3
POLL_S = 0.2


def run_trial(
    out: Path, options: tuple[str, ...], pace: float, arm: str, kind: str, number: int, attempts: int
) -> Row:
    """Run and score one manipulation.

    A trial in which a process did not answer in time, as on a machine with too much to do, is begun anew: that says
    nothing about the manipulation. The row tells how often (``tries``).

    Args:
        out: Folder; the trial's files go to ``trials/<kind>-<number>`` in it.
        options: Further options of ``s2r run``.
        pace: Simulated over real seconds; 0 is as fast as the machine allows.
        arm: Shipped arm, or a folder with ``arm.yaml``.
        kind, number: Of the trial.
        attempts: Planned manipulations at most.
    """
    trial = draw_trial(kind, number, arm=load_arm(arm))
    folder = out / "trials" / f"{kind}-{number:03d}"
    row: Row = {}
    for tries in range(1, MOST_TRIES + 1):
        before_s = _children_cpu_s()
        row = {
            "kind": kind,
            "number": number,
            "tries": tries,
            **_try(trial, attempts, options, pace, arm, folder),
        }
        row["cpu_s"] = round(_children_cpu_s() - before_s, 1)
        row["stored_bytes"] = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
        if row["exit"] != ExitCode.UNREACHABLE:
            break
    return row


def _children_cpu_s() -> float:
    """Processor time of all processes that this one has started and waited for [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _try(trial: Trial, attempts: int, options: tuple[str, ...], pace: float, arm: str, folder: Path) -> Row:
    shutil.rmtree(folder, ignore_errors=True)  # of an interrupted try
    folder.mkdir(parents=True)
    try:
        with (
            sealed(trial.world, folder) as hidden,
            stand_in_cell(
                folder,
                ("--world", hidden / WORLD),
                pace=pace,
                stand_in=("--truth", hidden / TRUTH, "--arm", arm),
                executor=("--arm", arm),
            ) as cell,
            nameless(folder) as unnamed,
            (folder / "host.log").open("w") as log,
        ):
            command = s2r_command(
                "run", trial.kind, "--target", "ask", "--from", "pushed", "--attempts", str(attempts),
                "--acknowledge-contact", "--seed", str(host_seed(trial.number)), "--arm", arm,
                "--executor", cell.executor, "--camera", cell.camera, "--out", unnamed / "run", *options,
            )  # fmt: skip
            change, code = _run_and_answer(command, log, trial, folder)
        if code == ExitCode.INTERRUPTED:
            raise KeyboardInterrupt
        if code == ExitCode.USAGE and not (folder / "run/run.json").exists():
            said = (folder / "host.log").read_text().strip().splitlines()[-1:]
            raise UsageError(f"s2r run refused its options; correct --run-options: {' '.join(said)}")
        return score_trial(trial, folder, change)
    except subprocess.TimeoutExpired:
        return _no_result(trial.change, f"no end within {TIMEOUT_S:.0f} s", ExitCode.UNREACHABLE)
    except PeerFailedError as error:
        return _no_result(trial.change, str(error), ExitCode.UNREACHABLE)
    except (TruthFileError, FileNotFoundError) as error:
        return _no_result(trial.change, f"{type(error).__name__}: {error}", ExitCode.BUG)


def _run_and_answer(command: list[str], log: TextIO, trial: Trial, folder: Path) -> tuple[float, int]:
    """Run the host and tell it the target when it asks; see :func:`amount_to_ask_for`.

    Returns:
        What was asked for, counted as the host's joint [m or rad], as drawn if the host never asked; exit status.

    Raises:
        subprocess.TimeoutExpired: The run took too long; it was killed.
    """
    until_s, change = time.monotonic() + TIMEOUT_S, trial.change
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=log, stderr=subprocess.STDOUT) as host:
        try:
            believed = folder / "run/run.json"  # written before the host asks, or when it has ended
            while host.poll() is None and not believed.exists():
                if time.monotonic() > until_s:
                    raise subprocess.TimeoutExpired(command, TIMEOUT_S)
                time.sleep(POLL_S)
            if believed.exists() and (run := json.loads(believed.read_text()))["joint"] is not None:
                change = amount_to_ask_for(trial, run)
            host.communicate(f"{change!r}\n".encode(), timeout=max(0.0, until_s - time.monotonic()))
        except BaseException:
            host.kill()
            raise
    return change, host.returncode


def amount_to_ask_for(trial: Trial, run: Row) -> float:
    """The change to ask for, by what was drawn before the run and what the host itself says of its pushes.

    The truth log is not read for it. What the host misjudges of its pushes is to its own disadvantage: the target may
    then lie nearer to a stop than the margin, or beyond it. So it may where the host does not see the part in its first
    view and says nothing of what the pushes moved: the change is then as drawn.

    Args:
        trial: Whose part was drawn to stand at ``q_start``.
        run: ``run.json`` as written before the host asks.

    Returns:
        Counted as the host's joint [m or rad].
    """
    if run["s_first"] is None:
        return trial.change
    way, pushed = sense(trial.world, run), float(run["s_origin"]) - float(run["s_first"])
    return trial.asked(trial.world.object.q_start + way * pushed, way)


def _no_result(change: float, reason: str, code: ExitCode) -> Row:
    return {"change": change, "exit": int(code), "reason": reason, "stage": "processes", "delta": None}
