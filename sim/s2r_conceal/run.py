"""Running a tool over all cases of a set: several at a time, resumable, each case in a folder of its own.

The tool sees a temporary folder with ``model.xml`` and the three recordings and nothing else; sealed answers,
manifest and other cases are not beside it, and this package cannot be imported.
"""

from __future__ import annotations

import json
import shlex
import shutil
import signal
import subprocess
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from s2r_conceal import verdicts
from s2r_conceal.errors import ConcealError
from s2r_conceal.kept_away import without_concealment
from s2r_conceal.seal import check_files, check_hashed, publish_verdicts, read_manifest, sha256
from s2r_protocol.cli.progress import Count

INTERRUPTED = (-signal.SIGINT, 128 + signal.SIGINT)  # how a program ends that a Ctrl-C has reached
QUESTION = "question.json"  # the command that the answers in work/ are of
ROLES = ("fit", "holdout", "repeat")
INPUTS = ("model.xml", *(f"{role}.{kind}" for role in ROLES for kind in ("csv", "yaml")))


def run_all(folder: Path, command: str, workers: int, timeout_s: float, bar: Count) -> str:
    """Run ``command`` over every case without an answer, then hash all verdicts.

    Args:
        folder: A drawn set.
        command: Program and leading arguments; ``--model … --fit … --holdout … --repeat … --out …`` follow.
        workers: Cases at a time.
        timeout_s: Limit per case [s]; the verdict on a case that runs into it says so.
        bar: Told about every finished case.

    Returns:
        The hash over all verdicts.

    Raises:
        SealError: A file of the set, or a verdict that is hashed, was changed.
        ConcealError: The program cannot be started, or the set has verdicts of another one.
        ToolFailedError: The tool has answered on no case; nothing is hashed.
    """
    manifest = read_manifest(folder)
    check_files(folder, manifest)
    check_hashed(folder)
    words = _program(command)
    folder = folder.absolute()
    (folder / "verdicts").mkdir(exist_ok=True)
    cases, question = list(manifest["cases"]), verdicts.asked(command)
    todo = verdicts.to_do(folder, cases, question)
    bar.length = len(cases)
    bar.update(len(cases) - len(todo))
    # Threads: each of them waits for a process of its own.
    with ThreadPoolExecutor(workers) as pool:
        pending = [pool.submit(run_case, folder, case, words, timeout_s, question) for case in todo]
        try:
            for done in as_completed(pending):
                done.result()
                bar.update(1)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)  # else what is queued would be worked off first
            raise
    if todo:
        verdicts.check_answered(folder, cases)
    return publish_verdicts(folder)


def run_batched(
    folder: Path, command: str, workers: int, timeout_s: float, bar: Count, config: Path | None = None
) -> str:
    """Like :func:`run_all`, with one call of ``command --batch JOBS``: a tool that keeps its workers starts once.

    The tool sees ``work/``, a folder with the inputs of the cases and ``config``, the tool's own switches, and
    nothing else. May be stopped and started again.

    Raises:
        SealError: A file of the set, or a verdict that is hashed, was changed.
        ConcealError: The program cannot be started, left cases without an answer, or the set has verdicts of
            another one.
        ToolFailedError: The tool has answered on no case; nothing is hashed.
    """
    manifest = read_manifest(folder)
    check_files(folder, manifest)
    check_hashed(folder)
    words = _program(command)
    folder = folder.absolute()
    work = folder / "work"
    (folder / "verdicts").mkdir(exist_ok=True)
    cases = list(manifest["cases"])
    question = verdicts.asked(command, sha256(config.read_bytes()) if config is not None else None)
    todo = verdicts.to_do(folder, cases, question)
    bar.length = len(cases)
    if not todo:
        bar.update(len(cases))
        return publish_verdicts(folder)
    if _read(work / QUESTION) != question:  # answers to another one: of a copied set, say
        shutil.rmtree(work, ignore_errors=True)
    for case in cases:
        (work / case).mkdir(parents=True, exist_ok=True)
        for name in INPUTS:
            shutil.copyfile(folder / case / name, work / case / name)
    extra = {}
    if config is not None:
        shutil.copyfile(config, work / "switches.yaml")
        extra = {"config": "switches.yaml"}
    jobs = [
        {"name": c, "model": f"{c}/model.xml"} | {r: [f"{c}/{r}.csv"] for r in ROLES} | extra for c in cases
    ]
    (work / "jobs.json").write_text(json.dumps(jobs) + "\n")
    (work / QUESTION).write_text(json.dumps(question) + "\n")
    arguments = ["--batch", "jobs.json", "--out", "out", "--seed", "0", "--workers", str(workers)]
    shown = 0
    with (work / "stderr.txt").open("w") as said, without_concealment() as surroundings:
        running = subprocess.Popen(
            [*words, *arguments], cwd=work, stdout=subprocess.DEVNULL, stderr=said, env=surroundings
        )
        deadline = time.monotonic() + timeout_s * len(cases)
        try:
            while running.poll() is None and time.monotonic() < deadline:
                ready = sum(_batch_verdict(work / "out" / c) is not None for c in cases)
                bar.update(ready - shown)
                shown = ready
                time.sleep(2.0)
        finally:
            running.terminate()
            running.wait()
    for case in todo:
        verdict = _batch_verdict(work / "out" / case)
        if verdict is None:
            said_last = (work / "stderr.txt").read_text(encoding="utf-8", errors="replace")[-500:]
            raise ConcealError(f"the tool left {case} without an answer: {said_last}; start again to go on")
        verdicts.write(folder, case, {**verdict, **question})
    verdicts.check_answered(folder, cases)
    return publish_verdicts(folder)


def _batch_verdict(out: Path) -> dict[str, Any] | None:
    for left in ("refused.json", "failed.json"):
        why = _read(out / left)
        if why is not None:
            said = str(why.get("reason"))[-2000:]
            return {"exit_code": why.get("exit_code"), "wall_s": None, "stderr_tail": said, "gap": None}
    gap = _read(out / "gap.json")
    if gap is None:
        return None
    fine = gap.get("verdict") in ("nothing_missing", "insufficient")
    return {"exit_code": 0 if fine else 7, "wall_s": gap.get("wall_s"), "stderr_tail": "", "gap": gap}


def _program(command: str) -> list[str]:
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ConcealError(f"--command {command!r}: {error}; close every quotation mark") from error
    program = shutil.which(words[0]) if words else None
    if program is None:
        raise ConcealError(f"--command '{command}': no such program on the path")
    # The tool is started elsewhere; a virtual environment's link stays.
    return [str(Path(program).absolute()), *words[1:]]


def run_case(folder: Path, case: str, words: list[str], timeout_s: float, question: verdicts.Verdict) -> None:
    """Run the tool on one case and write its verdict file with the ``question`` that led to it.

    Raises:
        ConcealError: The tool was interrupted, which is no verdict.
    """
    with tempfile.TemporaryDirectory(prefix="s2r-case-") as scratch:
        place = Path(scratch)
        for name in INPUTS:
            shutil.copyfile(folder / case / name, place / name)
        arguments = ["--model", "model.xml"]
        for role in ROLES:
            arguments += [f"--{role}", f"{role}.csv"]
        verdict = _run(place, [*words, *arguments, "--out", "out", "--seed", "0"], timeout_s)
    verdicts.write(folder, case, {**verdict, **question})


def _run(place: Path, words: list[str], timeout_s: float) -> dict[str, Any]:
    begin = time.monotonic()
    try:
        with without_concealment() as surroundings:
            ended = subprocess.run(
                words, cwd=place, capture_output=True, encoding="utf-8", errors="replace", timeout=timeout_s,
                check=False, env=surroundings,
            )  # fmt: skip
        code, said = ended.returncode, ended.stderr
        if code in INTERRUPTED:
            raise ConcealError(
                "the tool was interrupted; what is answered so far stays, start again to go on"
            )
    except subprocess.TimeoutExpired:
        code, said = None, f"no answer within {timeout_s:g} s"
    found = place / "out" / "gap.json"
    return {
        "exit_code": code,
        "wall_s": round(time.monotonic() - begin, 3),
        "stderr_tail": said[-2000:],
        "gap": _read(found),
    }


def _read(path: Path) -> dict[str, Any] | None:
    """The tool's answer; None when there is none or it is no JSON object, which counts as no answer."""
    try:
        body = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return body if isinstance(body, dict) else None
