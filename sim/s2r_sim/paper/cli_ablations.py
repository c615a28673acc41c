"""``s2r bench ablations``: campaigns of the same trials with other options, told apart pair by pair."""

from __future__ import annotations

from pathlib import Path

import click

from s2r_protocol.exits import UsageError


@click.command()
@click.option(
    "--pair",
    "pairs",
    multiple=True,
    required=True,
    metavar="LABEL=BASE,DIR",
    help="The campaign as it is, and the one with other options; may be given again.",
)
@click.option(
    "--page", type=click.Path(path_type=Path, dir_okay=False), required=True, help="Where to write."
)
@click.option(
    "--remarks",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    help="Markdown that goes before the tables.",
)
def ablations(pairs: tuple[str, ...], page: Path, remarks: Path | None) -> None:
    """Compare campaigns of 's2r bench paper' or tests/bench/fast_trials.py on the trials that they share.

    What correcting is worth is read off every BASE's own first and last manipulations.
    """
    from s2r_sim.paper.ablation_page import write_page
    from s2r_sim.paper.ablations import FIRST, Pairs, campaign_in, pairs_of, relative, uncorrected
    from s2r_sim.paper.own_page import check_page
    from s2r_sim.paper.trials import KINDS

    comparisons: list[list[Pairs]] = []
    corrected: dict[Path, list[Pairs]] = {}
    for entry in pairs:
        label, _, folders = entry.partition("=")
        files = [Path(folder) / "results.jsonl" for folder in folders.split(",")]
        if len(files) != 2 or not all(file.is_file() for file in files):
            raise UsageError(f"--pair {entry!r}: give LABEL=BASE,DIR with a results.jsonl in BASE and in DIR")
        rows = campaign_in(files[0])
        found = pairs_of(rows, campaign_in(files[1]), label, KINDS)
        if not found:
            raise UsageError(f"--pair {entry!r}: the two campaigns share no trial")
        corrected.setdefault(files[0], uncorrected(rows, KINDS, files[0].parent.name))
        comparisons.append(found)
    comparisons = [*corrected.values(), *comparisons]
    told = " ".join(f"--pair '{entry.partition('=')[0]}=BASE,DIR'" for entry in pairs)
    check_page(page, "s2r bench ablations")
    text = remarks.read_text() if remarks is not None else ""
    write_page(comparisons, page, f"s2r bench ablations {told} --page {page}", text)
    for found in comparisons:
        one = found[-1]
        ours, changed = (100 * relative(rows, FIRST).mean() for rows in (one.ours, one.changed))
        click.echo(
            f"{one.label:<24} {one.kind:<7} n {len(one.ours):>3}  first: {ours:.1f} % -> {changed:.1f} %"
        )
    click.echo(f"page: {page}")
