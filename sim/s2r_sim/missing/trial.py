"""One object's run: sealed world, stand-in, executor and host; target after target, with or without learning."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from s2r_protocol.cli.peers import PeerFailedError, s2r_command, stand_in_cell
from s2r_protocol.exits import ExitCode
from s2r_sim.errors import RunFileError, TruthFileError, UnstableError
from s2r_sim.missing.cases import LATER, LEARNING, draw_case
from s2r_sim.missing.score import Row, score_run
from s2r_sim.missing.shift import largest, shifts
from s2r_sim.paper.trials import Trial
from s2r_sim.sealed import TRUTH, WORLD, host_seed, nameless, sealed

TIMEOUT_S = 2400.0
ARMS = {
    "as it is": (),
    "lost motion alone": ("--learn-physics", "--without", "gap"),
    "learnt": ("--learn-physics",),
}
"""What the host is told besides; the targets are the same in all of them."""


def run_case(out: Path, label: str, number: int, arm: str, later: int) -> Row:
    """Run and score one object. The run in which nothing is learnt also tells what its effect could change.

    Args:
        out: Folder; files go to ``runs/`` in it.
        label, number: Of the case, see :mod:`s2r_sim.missing.cases`.
        arm: Key of ``ARMS``.
        later: Targets after the three from which the physics is learnt.
    """
    trial = draw_case(label, number)
    folder = run_folder(out, label, number, arm)
    shutil.rmtree(folder, ignore_errors=True)  # of an interrupted try
    folder.mkdir(parents=True)
    shares = (*LEARNING, *LATER[:later])
    row: Row = {"case": label, "number": number, "arm": arm, "change": trial.change}
    try:
        _play(trial, folder, [share * trial.change for share in shares], ARMS[arm])
        row |= score_run(trial, folder, shares)
        if not ARMS[arm]:
            found = shifts(trial, folder, shares)
            row |= {"shifts": found, "shift_r": largest(found)}
        return row
    except subprocess.TimeoutExpired:
        return {**row, "exit": int(ExitCode.UNREACHABLE), "reason": f"no end within {TIMEOUT_S:.0f} s"}
    except PeerFailedError as error:
        return {**row, "exit": int(ExitCode.UNREACHABLE), "reason": str(error)}
    except (TruthFileError, RunFileError, UnstableError, FileNotFoundError) as error:
        return {**row, "exit": int(ExitCode.BUG), "reason": f"{type(error).__name__}: {error}"}


def run_folder(out: Path, label: str, number: int, arm: str) -> Path:
    """Where the files of a run are."""
    return out / "runs" / f"{label}-{number}-{arm}".replace(": ", "-").replace(" ", "-")


def _play(trial: Trial, folder: Path, targets: list[float], options: tuple[str, ...]) -> None:
    first, *further = targets
    with (
        sealed(trial.world, folder) as hidden,
        stand_in_cell(folder, ("--world", hidden / WORLD), stand_in=("--truth", hidden / TRUTH)) as cell,
        nameless(folder) as unnamed,
        (folder / "host.log").open("w") as log,
    ):
        command = s2r_command(
            "run", trial.kind, f"--target={first!r}", *(f"--then={one!r}" for one in further), "--from", "pushed",
            "--attempts", "1", "--go-on", "--acknowledge-contact", "--seed", str(host_seed(trial.number)),
            "--executor", cell.executor, "--camera", cell.camera, "--out", unnamed / "run", *options,
        )  # fmt: skip
        ended = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, timeout=TIMEOUT_S, check=False)
    if ended.returncode == ExitCode.INTERRUPTED:
        raise KeyboardInterrupt
