"""Many runs of the tool: a spawn pool or a Ray cluster, resumable, with a summary over robots and dates.

A job is one line of the batch file. Its answer stands in its own folder, beside what it was made from; a job whose
``gap.json`` exists is not run again, so a stopped batch goes on where it was. One that was refused or failed is: its
file may be mended by then.
"""

from __future__ import annotations

import html
import json
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from s2r_host.gap.contents import contents
from s2r_host.gap.errors import GapUsageError
from s2r_host.gap.workers import each_done
from s2r_host.gap.yaml_files import read_yaml
from s2r_protocol.cli.conditions import keep_to
from s2r_protocol.cli.outputs import has_key
from s2r_protocol.exits import ExitCode, S2RError
from s2r_protocol.ray_cluster import on_ray
from s2r_protocol.whole_file import NO_ROOM, write_whole

ANSWER = "gap.json"
SUMMARIES = ("summary.json", "summary.html")
KEYS = {"name", "model", "fit", "holdout", "repeat", "config", "robot", "date"}


@dataclass(frozen=True)
class Job:
    """One run: its files, and whose they are.

    Attributes:
        name: Folder of the answer.
        robot: Which machine; ``date`` when it was recorded (any text that sorts).
    """

    name: str
    model: Path
    fit: tuple[Path, ...]
    holdout: tuple[Path, ...] = ()
    repeat: tuple[Path, ...] = ()
    config: Path | None = None
    robot: str = ""
    date: str = ""


def read_jobs(path: Path) -> list[Job]:
    """Read a batch file: YAML or JSON, a list of maps with the keys of :class:`Job`; paths beside the file.

    Raises:
        GapUsageError: Unreadable, an unknown key, a missing one, or a name used twice.
    """
    raw = read_yaml(
        path, "batch", "correct the path; a batch is a YAML list of jobs, each with name, model and fit"
    )
    if not isinstance(raw, list) or not raw:
        raise GapUsageError(f"batch '{path}': write a list of jobs, each with name, model and fit")
    jobs = [_job(path, entry, i) for i, entry in enumerate(raw)]
    seen: set[str] = set()
    for job in jobs:
        if job.name in seen:
            raise GapUsageError(f"batch '{path}': two jobs are called '{job.name}'")
        seen.add(job.name)
    return jobs


def _job(path: Path, entry: Any, number: int) -> Job:
    if not isinstance(entry, dict) or set(entry) - KEYS or not {"name", "model", "fit"} <= set(entry):
        raise GapUsageError(
            f"batch '{path}': job {number + 1} needs name, model and fit; allowed keys: {', '.join(sorted(KEYS))}"
        )
    base, name = path.parent, entry["name"]
    if not isinstance(name, str):
        raise GapUsageError(
            f"batch '{path}': the name of job {number + 1} is read as {name!r}; write it in quotes"
        )
    if not name or "/" in name or name.startswith(".") or name in SUMMARIES:
        raise GapUsageError(f"batch '{path}': '{name}' cannot be the name of a folder")

    def files(key: str) -> tuple[Path, ...]:
        value = entry.get(key) or []
        return tuple(base / str(x) for x in (value if isinstance(value, list) else [value]))

    return Job(
        name=name, model=base / str(entry["model"]), fit=files("fit"), holdout=files("holdout"),
        repeat=files("repeat"), config=base / str(entry["config"]) if entry.get("config") else None,
        robot=str(entry.get("robot") or name), date=str(entry.get("date") or ""),
    )  # fmt: skip


def run_batch(
    jobs: list[Job],
    out: Path,
    workers: int,
    seed: int,
    told: Callable[[int], None] = lambda _: None,
    ray: str | None = None,
) -> list[dict]:
    """Run every job that has no answer yet; returns one summary row per job, in the order given.

    Args:
        jobs: What to run.
        out: One folder per job goes here, and ``summary.json`` and ``summary.html``.
        workers: Processes at a time.
        seed: Given to every run.
        told: Called with the number of jobs just finished; first with those already there.
        ray: Address of a Ray cluster to run on instead, "local" for one of ``workers`` processors on this machine. Its
            machines read the files and write the answers under the same paths.

    Raises:
        GapUsageError: A file stands where the folder of a job goes.
        UsageError: A job has an answer to other files or another seed, or nobody knows to which.
        NotReadyError: Ray is asked for and not installed, or nothing answers there.
        OSError: There is no room left on the disk.
    """
    for job in jobs:
        if (out / job.name).exists() and not (out / job.name).is_dir():
            raise GapUsageError(
                f"--out '{out}' holds a file '{job.name}', and a job is called so; name another folder"
            )
        if answered(out / job.name):
            keep_to(_question(job, seed), out / job.name / ANSWER, begun=True)
    out.mkdir(parents=True, exist_ok=True)
    todo = [j for j in jobs if not answered(out / j.name)]
    told(len(jobs) - len(todo))
    calls = [(_absolute(job), (out / job.name).absolute(), seed) for job in todo]
    done = (
        each_done(run_job, calls, workers, _died)
        if ray is None
        else on_ray(run_job, calls, workers, ray, _died)
    )
    for _ in done:
        told(1)
    rows = [_row(j, out / j.name) for j in jobs]
    write_whole(out / SUMMARIES[0], json.dumps(rows, indent=1, ensure_ascii=False) + "\n")
    write_whole(out / SUMMARIES[1], _page(rows))
    return rows


def _absolute(job: Job) -> Job:
    """The same job for a worker that stands in another folder."""
    lists = {role: tuple(p.absolute() for p in getattr(job, role)) for role in ("fit", "holdout", "repeat")}
    config = None if job.config is None else job.config.absolute()
    return replace(job, model=job.model.absolute(), config=config, **lists)


def _question(job: Job, seed: int) -> dict[str, Any]:
    """What the answer depends on. Robot and date only label it."""
    recordings = {
        role: contents(file for path in getattr(job, role) for file in (path, *_beside(path)))
        for role in ("fit", "holdout", "repeat")
    }
    config = [] if job.config is None else [job.config]
    return {"model": contents([job.model]), **recordings, "config": contents(config), "--seed": seed}


def _beside(recording: Path) -> list[Path]:
    """What says more about a recording."""
    return [side for suffix in (".yaml", ".yml") if (side := recording.with_suffix(suffix)).is_file()]


def answered(folder: Path) -> bool:
    """Is there a whole answer from an earlier run?"""
    return has_key(folder / ANSWER, ("verdict",))


def run_job(job: Job, folder: Path, seed: int) -> None:
    """Run one job: a refused file leaves ``refused.json``, an error of the tool ``failed.json``; the batch goes on.

    Raises:
        OSError: There is no room left: the jobs to come could not write their answers either.
    """
    from s2r_host.gap.cli import run_gap

    for name in ("refused.json", "failed.json"):
        (folder / name).unlink(missing_ok=True)
    try:
        keep_to(_question(job, seed), folder / ANSWER, begun=False)
        run_gap(
            job.model, list(job.fit), list(job.holdout), list(job.repeat), job.config, folder,
            seed=seed, quiet=True,
        )  # fmt: skip
    except S2RError as error:
        _leave(folder / "refused.json", str(error), int(error.exit_code))
    except Exception as error:
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            raise
        # The summary says so, and the batch ends with the exit code of a bug.
        _leave(folder / "failed.json", traceback.format_exc(), int(ExitCode.BUG))


def _died(_job: Job, folder: Path, _seed: int) -> None:
    reason = "its process was killed, as the system does for want of memory; give it fewer --workers or a shorter file"
    _leave(folder / "failed.json", reason, int(ExitCode.BUG))


def _leave(path: Path, reason: str, code: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, json.dumps({"reason": reason, "exit_code": code}) + "\n")


def _row(job: Job, folder: Path) -> dict:
    head = {"name": job.name, "robot": job.robot, "date": job.date}
    for verdict in ("refused", "failed"):
        left = folder / f"{verdict}.json"
        if left.is_file():
            reason = json.loads(left.read_text(encoding="utf-8"))["reason"]
            return head | {"verdict": verdict, "reason": reason.strip().splitlines()[-1], "effects": []}
    gap = json.loads((folder / ANSWER).read_text(encoding="utf-8"))
    effects = [
        {"name": e["name"], "joint": e["joint"], "probability": e["probability"]} for e in gap["effects"]
    ]
    off = [{"name": p["name"], "place": p.get("body", p.get("joint"))} for p in gap["parameters_off"]]
    if gap["verdict"] == "insufficient" and gap.get("notes"):
        head |= {"reason": gap["notes"][0]}
    return head | {
        "verdict": gap["verdict"],
        "effects": effects,
        "parameters_off": off,
        "wall_s": gap["wall_s"],
        "report": (folder / "report.html").is_file(),
    }


def since_when(rows: list[dict]) -> list[dict]:
    """Per robot, place and name: the first date it was told and in how many runs since.

    An effect is at a joint, a number that is off (a load, a motor's inertia) of a joint or body; ``kind`` tells which.
    """
    found: dict[tuple[str, str, str, str], dict] = {}
    for row in sorted(rows, key=lambda r: (r["robot"], r["date"], r["name"])):
        told = [("effect", e["joint"], e["name"]) for e in row["effects"]]
        told += [("number", p["place"], p["name"]) for p in row.get("parameters_off", [])]
        for kind, place, name in dict.fromkeys(told):
            entry = found.setdefault(
                (row["robot"], place, kind, name),
                {
                    "robot": row["robot"],
                    "place": place,
                    "kind": kind,
                    "name": name,
                    "since": row["date"] or row["name"],
                    "runs": 0,
                },
            )
            entry["runs"] += 1
    return list(found.values())


STYLE = """body{font:15px/1.5 system-ui,sans-serif;color:#1d2433;max-width:1000px;margin:2rem auto;padding:0 1rem}
h1{font-size:1.4rem}h2{font-size:1.1rem;margin-top:2rem}table{border-collapse:collapse;width:100%;font-size:.9rem}
td,th{padding:.3rem .5rem;border-bottom:1px solid #e4e7ec;text-align:left;vertical-align:top}th{color:#667085}
.date{white-space:nowrap}.found{color:#d1495b}.fine{color:#1f7a8c}.open{color:#667085}
@media screen and (max-width:700px){table{display:block;overflow-x:auto}}"""


def _page(rows: list[dict]) -> str:
    counts = {v: sum(r["verdict"] == v for r in rows) for v in sorted({r["verdict"] for r in rows})}
    head = " · ".join(f"{n} {v.replace('_', ' ')}" for v, n in counts.items())
    since = "".join(
        f"<tr><td>{html.escape(e['robot'])}<td>{html.escape(e['place'])}<td>{html.escape(e['name'])}"
        f"{'' if e['kind'] == 'effect' else ' (a number that is off)'}<td>{html.escape(e['since'])}<td>{e['runs']}"
        for e in since_when(rows)
    )
    return "\n".join([
        "<!doctype html><html lang=en><meta charset=utf-8><title>s2r gap: summary</title>",
        '<meta name=viewport content="width=device-width, initial-scale=1">',
        f"<style>{STYLE}</style><h1>{len(rows)} runs: {html.escape(head)}</h1>",
        "<h2>What is off in which robot since when</h2>",
        f"<table><tr><th>robot<th>joint or body<th>what<th>since<th>runs{since}</table>"
        if since else "<p>None named.</p>",
        "<h2>Runs</h2><table><tr><th>run<th>robot<th>date<th>verdict<th>what",
        *(_line(r) for r in rows), "</table></html>",
    ])  # fmt: skip


def _line(row: dict) -> str:
    name = html.escape(row["name"])
    link = name if not row.get("report") else f"<a href='{quote(row['name'])}/report.html'>{name}</a>"
    found = [f"{e['name']} on {e['joint']} ({e['probability']:.2f})" for e in row["effects"]]
    found += [f"{p['name']} of {p['place']}" for p in row.get("parameters_off", [])]
    what = ", ".join(found)
    kind = {"nothing_missing": "fine", "insufficient": "open"}.get(row["verdict"], "found")
    return (
        f"<tr><td>{link}<td>{html.escape(row['robot'])}<td class=date>{html.escape(row['date'])}"
        f"<td class={kind}>{row['verdict'].replace('_', ' ')}<td>{html.escape(row.get('reason') or what)}"
    )
