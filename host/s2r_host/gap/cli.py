"""``s2r gap``: the command."""

from __future__ import annotations

import json
from itertools import zip_longest
from pathlib import Path

import click

from s2r_protocol.cli.options import SEED
from s2r_protocol.cli.outputs import check_inputs_stay, check_own_results
from s2r_protocol.exits import ExitCode, S2RError

LISTS = ("--fit", "--holdout", "--repeat")


class _ListCommand(click.Command):
    """A command whose list options take every value up to the next option: ``--fit a.csv b.csv``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        spread: list[str] = []
        current: str | None = None
        for arg, following in zip_longest(args, args[1:], fillvalue="--"):
            if arg.startswith("--"):
                current = arg if arg in LISTS else None
                if current is None:
                    spread.append(arg)
                elif following.startswith("--"):
                    raise click.BadOptionUsage(arg, f"Option '{arg}' requires at least one recording.", ctx)
            elif current is not None:
                spread += [current, arg]
            else:
                spread.append(arg)
        return super().parse_args(ctx, spread)


@click.command(cls=_ListCommand)
@click.option("--model", "model_path", default=None, type=click.Path(path_type=Path), help="MJCF or URDF.")
@click.option("--fit", "fit", multiple=True, type=click.Path(path_type=Path), help="Recordings to fit on.")
@click.option(
    "--holdout", "holdout", multiple=True, type=click.Path(path_type=Path), help="Recordings to predict only."
)
@click.option(
    "--repeat", "repeat", multiple=True, type=click.Path(path_type=Path), help="Second runs of a motion."
)
@click.option("--config", "config_path", default=None, type=click.Path(path_type=Path), help="GAP.yaml.")
@click.option("--out", "out", required=True, type=click.Path(path_type=Path), help="Folder for the answer.")
@click.option(
    "--batch",
    "batch_path",
    default=None,
    type=click.Path(path_type=Path),
    help="Many runs: a list of jobs (YAML).",
)
@click.option("--workers", default=1, show_default=True, type=click.IntRange(1), help="Processes of a batch.")
@click.option(
    "--ray", metavar="ADDRESS", help="Run a batch on this Ray cluster, 'local' for one on this machine."
)
@click.option("--json", "as_json", is_flag=True, help="Print gap.json on stdout.")
@click.option("--seed", type=SEED, default=0, show_default=True, help="Seed of everything drawn at random.")
def gap(
    model_path: Path | None, fit: tuple[Path, ...], holdout: tuple[Path, ...], repeat: tuple[Path, ...],
    config_path: Path | None, out: Path, batch_path: Path | None, workers: int, ray: str | None, as_json: bool,
    seed: int,
) -> int:  # fmt: skip
    """Find where simulation and recordings part, and name the physics left out.

    Exit code 0: nothing missing; 7: a difference was found; 2: bad usage; 4: a file was refused. Of a batch: 7 if any
    run found a difference, else 4 if files of any were refused.
    """
    from s2r_host.gap.errors import GapUsageError

    if batch_path is not None:
        if model_path is not None or fit or holdout or repeat or config_path is not None:
            raise GapUsageError(
                "--batch names every file in the batch itself; drop --model, --fit and the others"
            )
        return int(_batch(batch_path, out, workers, as_json, seed, ray))
    if ray is not None:
        raise GapUsageError("--ray goes with --batch: one run is one job")
    if model_path is None:
        raise GapUsageError("no model given: use --model MODEL, or --batch JOBS.yaml for many runs")
    return int(run_gap(model_path, list(fit), list(holdout), list(repeat), config_path, out, as_json, seed))


def _batch(path: Path, out: Path, workers: int, as_json: bool, seed: int, ray: str | None = None) -> ExitCode:
    from s2r_host.gap.batch import answered, read_jobs, run_batch
    from s2r_protocol.cli.progress import counted

    jobs = read_jobs(path)
    try:
        with counted("runs", len(jobs)) as bar:
            rows = run_batch(jobs, out, workers, seed, bar.update, ray)
    except KeyboardInterrupt:
        done = sum(answered(out / job.name) for job in jobs)
        click.echo(
            f"{done} of {len(jobs)} runs have an answer; the same command goes on from there", err=True
        )
        raise
    if as_json:
        click.echo(json.dumps(rows, ensure_ascii=False))
    for row in rows:
        if row["verdict"] in ("refused", "failed"):
            click.echo(f"{row['name']}: {row['verdict']}: {row['reason']}", err=True)
    click.echo(f"{len(rows)} runs: {out / 'summary.html'}", err=True)
    return batch_code({r["verdict"] for r in rows})


def batch_code(verdicts: set[str]) -> ExitCode:
    """The exit code of a batch: the worst of its runs, a difference before a refusal."""
    if "failed" in verdicts:
        return ExitCode.BUG
    if verdicts - {"nothing_missing", "insufficient", "refused"}:
        return ExitCode.DIFFERENCE
    return ExitCode.REFUSED if "refused" in verdicts else ExitCode.OK


def run_gap(
    model_path: Path, fit: list[Path], holdout: list[Path], repeat: list[Path], config_path: Path | None,
    out: Path, as_json: bool = False, seed: int = 0, quiet: bool = False,
) -> ExitCode:  # fmt: skip
    """Run the tool and write its answer; returns the exit code.

    Raises:
        S2RError: Bad usage, or a refused file.
    """
    from s2r_host.gap.config import read_config
    from s2r_host.gap.errors import GapUsageError
    from s2r_host.gap.output.answer import (
        ANSWER_FILES,
        RUNNING,
        forget_answer,
        make_answer,
        stamped,
        write_answer,
        write_outputs,
    )
    from s2r_host.gap.output.extras import add_extras
    from s2r_host.gap.pipeline import analyse

    if not fit:
        raise GapUsageError("no recording given: use --fit REC [REC ...]")
    _refuse_twice([*fit, *holdout, *repeat])
    config = read_config(config_path)
    if out.exists() and not out.is_dir():
        raise GapUsageError(f"--out '{out}' is a file; give a folder")
    check_inputs_stay(out, ANSWER_FILES, [model_path, *fit, *holdout, *repeat])
    check_own_results(out, "gap.json", ("verdict",), ANSWER_FILES[1:], begun=RUNNING)
    new = not out.exists()
    out.mkdir(parents=True, exist_ok=True)  # a place that takes no files is told at once

    def log(text: str) -> None:
        if not quiet:
            click.echo(text, err=True)

    try:
        analysis = analyse(model_path, fit, holdout, repeat, config, log)
    except S2RError:
        if new:
            out.rmdir()
        raise
    forget_answer(out)
    add_extras(analysis, config, seed, out, log)
    answer = make_answer(analysis, seed)
    write_outputs(analysis, out)
    if config.report:
        from s2r_host.gap.output.report import write_report

        write_report(analysis, answer, out / "report.html")
    answer = stamped(answer, analysis)
    write_answer(answer, out)
    if as_json:
        click.echo(json.dumps(answer, ensure_ascii=False))
    log(summary(answer))
    return ExitCode.OK if answer["verdict"] in ("nothing_missing", "insufficient") else ExitCode.DIFFERENCE


def _refuse_twice(recordings: list[Path]) -> None:
    """Raises GapUsageError where one recording is given twice: it would be held against itself."""
    from s2r_host.gap.errors import GapUsageError

    seen: set[Path] = set()
    for path in recordings:
        if (real := path.resolve()) in seen:
            raise GapUsageError(
                f"recording '{path}' is given twice among --fit, --holdout and --repeat; held against itself it shows "
                "neither noise nor a prediction: give it once (without --holdout 30 % of each --fit are held out)"
            )
        seen.add(real)


def summary(answer: dict) -> str:
    """The answer in a few lines."""
    lines = [f"verdict: {answer['verdict'].replace('_', ' ')}"]
    for e in answer["effects"]:
        also = f" (or {', '.join(e['could_also_be'])})" if e["could_also_be"] else ""
        lines.append(
            f"  {e['name']}{also} on {e['joint']}: probability {e['probability']:.2f}; {e['evidence']}"
        )
    for p in answer["parameters_off"]:
        lines.append(
            f"  {p['name']} of {p.get('body', p.get('joint'))}: {p['from']:.4g} -> {p['to']:.4g} {p['unit']}"
        )
    lines += [f"  {note}" for note in answer["notes"][:4]]
    return "\n".join(lines)
