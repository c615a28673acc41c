"""One trial: sealed world, stand-in, executor and host as separate processes, then the truth opened."""

from __future__ import annotations

import resource
import shutil
import subprocess
from pathlib import Path

from s2r_protocol.cli.peers import PeerFailedError, s2r_command, stand_in_cell
from s2r_protocol.exits import ExitCode
from s2r_sim.errors import TruthFileError
from s2r_sim.paper.score import Row, score_trial
from s2r_sim.paper.trials import Trial, draw_trial

TIMEOUT_S = 1200.0
MOST_TRIES = 3


def run_trial(out: Path, options: tuple[str, ...], pace: float, kind: str, number: int, attempts: int) -> Row:
    """Run and score one manipulation.

    A trial in which a process did not answer in time, as on a machine with too much to do, is begun anew: that says
    nothing about the manipulation. The row tells how often (``tries``).

    Args:
        out: Folder; the trial's files go to ``trials/<kind>-<number>`` in it.
        options: Further options of ``s2r run``.
        pace: Simulated over real seconds; 0 is as fast as the machine allows.
        kind, number: Of the trial.
        attempts: Planned manipulations at most.
    """
    trial = draw_trial(kind, number)
    folder = out / "trials" / f"{kind}-{number:03d}"
    row: Row = {}
    for tries in range(1, MOST_TRIES + 1):
        before_s = _children_cpu_s()
        row = {"kind": kind, "number": number, "tries": tries, **_try(trial, attempts, options, pace, folder)}
        row["cpu_s"] = round(_children_cpu_s() - before_s, 1)
        row["stored_bytes"] = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
        if row["exit"] != ExitCode.UNREACHABLE:
            break
    return row


def _children_cpu_s() -> float:
    """Processor time of all processes that this one has started and waited for [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _try(trial: Trial, attempts: int, options: tuple[str, ...], pace: float, folder: Path) -> Row:
    shutil.rmtree(folder, ignore_errors=True)  # of an interrupted try
    folder.mkdir(parents=True)
    world = folder / "world.json"
    trial.world.save(world)
    try:
        with (
            stand_in_cell(
                folder, ("--world", world), pace=pace, stand_in=("--truth", folder / "truth.csv")
            ) as cell,
            (folder / "host.log").open("w") as log,
        ):
            command = s2r_command(
                "run", trial.kind, f"--target={trial.change!r}", "--from", "pushed", "--attempts", str(attempts),
                "--acknowledge-contact", "--seed", str(trial.number), "--executor", cell.executor,
                "--camera", cell.camera, "--out", folder / "run", *options,
            )  # fmt: skip
            ended = subprocess.run(
                command, stdout=log, stderr=subprocess.STDOUT, timeout=TIMEOUT_S, check=False
            )
        if ended.returncode == ExitCode.INTERRUPTED:
            raise KeyboardInterrupt
        return score_trial(trial, folder, trial.world.commitment)
    except subprocess.TimeoutExpired:
        return _no_result(trial.change, f"no end within {TIMEOUT_S:.0f} s", ExitCode.UNREACHABLE)
    except PeerFailedError as error:
        return _no_result(trial.change, str(error), ExitCode.UNREACHABLE)
    except (TruthFileError, FileNotFoundError) as error:
        return _no_result(trial.change, f"{type(error).__name__}: {error}", ExitCode.BUG)


def _no_result(change: float, reason: str, code: ExitCode) -> Row:
    return {"change": change, "exit": int(code), "reason": reason, "stage": "processes", "delta": None}
