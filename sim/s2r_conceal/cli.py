"""``s2r conceal``: draw concealed recordings, run a tool over them, score its verdicts."""

from __future__ import annotations

from pathlib import Path

import click

from s2r_protocol.cli.options import SEED, FiniteRange
from s2r_protocol.cli.progress import counted


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def conceal() -> None:
    """Recordings with hidden physics and sealed answers, to prove that a tool finds what is missing."""


def _counts(_context: click.Context, _option: click.Parameter, text: str) -> dict[str, int]:
    counts: dict[str, int] = {}
    for part in filter(None, text.split(",")):
        name, _, number = (word.strip() for word in part.partition("="))
        if not (number.isascii() and number.isdigit()):
            raise click.BadParameter(f"'{part}': write GROUP=NUMBER, e.g. single=60,clean=30")
        if name in counts:
            raise click.BadParameter(f"'{part}': {name} is asked for twice")
        counts[name] = int(number)
    if not any(counts.values()):
        raise click.BadParameter(f"{text!r}: that is no case at all; ask for at least one, as in clean=1")
    return counts


@conceal.command()
@click.option(
    "--seed", type=SEED, default=None, help="Without it the seed is random and only in the key file."
)
@click.option("--rig", default="one_joint", show_default=True, help="one_joint, two_link or seven_joint.")
@click.option(
    "--cases",
    "counts",
    default="single=30,clean=12,unknown=8,pairs=6",
    show_default=True,
    callback=_counts,
    help="GROUP=NUMBER,…: single, clean, unknown, pairs, triples, masked, insufficient, wrong_log.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="New folder for the set; an interrupted draw goes on.",
)
@click.option(
    "--duration",
    "duration_s",
    type=FiniteRange(1, 3600),
    default=20.0,
    show_default=True,
    help="Length of a recording [s].",
)
@click.option(
    "--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes at a time."
)
@click.option(
    "--key", type=click.Path(path_type=Path), default=None, help="Key file [default: OUT.key.json]."
)
def draw(
    seed: int | None,
    rig: str,
    counts: dict[str, int],
    out: Path,
    key: Path | None,
    duration_s: float,
    workers: int,
) -> None:
    """Draw a set of cases, record them and seal the answers."""
    from s2r_conceal.draw import draw_set

    key = key or out.with_name(out.name + ".key.json")
    with counted("drawing", sum(counts.values())) as bar:
        draw_set(seed, rig, counts, out, key, bar.update, duration_s, workers=workers)
    click.echo(
        f"{sum(counts.values())} cases in {out}; answers sealed, key in {key}: keep it away from the tool"
    )


@conceal.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--command", "command", required=True, help="The tool, e.g. 's2r gap'; options may follow.")
@click.option(
    "--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes at a time."
)
@click.option(
    "--timeout", "timeout_s", type=FiniteRange(1), default=900.0, show_default=True, help="Seconds per case."
)
@click.option("--batch", is_flag=True, help="One call with --batch JOBS instead of one call per case.")
@click.option(
    "--config",
    type=click.Path(path_type=Path, exists=True),
    default=None,
    help="The tool's switches, with --batch.",
)
def run(folder: Path, command: str, workers: int, timeout_s: float, batch: bool, config: Path | None) -> None:
    """Run a tool over all cases; may be stopped and started again with the same command.

    Ends by hashing the verdicts. Cases on which the tool gave no answer are run again until then; where it gave none
    at all nothing is hashed (exit 4).
    """
    from s2r_conceal.run import run_all, run_batched
    from s2r_conceal.seal import read_manifest
    from s2r_conceal.verdicts import no_answers

    if config is not None and not batch:
        raise click.UsageError("--config goes with --batch; without it, put the option into --command")
    with counted("running") as bar:
        if batch:
            total = run_batched(folder, command, workers, timeout_s, bar, config)
        else:
            total = run_all(folder, command, workers, timeout_s, bar)
    for sentence in no_answers(folder, list(read_manifest(folder)["cases"])):
        click.echo(sentence, err=True)
    click.echo(f"verdicts hashed: {total}")


@conceal.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option(
    "--key", type=click.Path(path_type=Path, exists=True), required=True, help="Key file of the draw."
)
@click.option("--out", type=click.Path(path_type=Path), default=None, help="Folder [default: FOLDER/score].")
def score(folder: Path, key: Path, out: Path | None) -> None:
    """Open the answers and make the table; refused until every verdict is hashed."""
    from s2r_conceal.score_files import score_folder
    from s2r_conceal.seal import weaknesses

    click.echo(score_folder(folder, key, out or folder / "score"))
    for weakness in weaknesses(folder):
        click.echo(f"this set is of an older version: {weakness}", err=True)
