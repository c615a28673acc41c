"""``s2r bench``: measurements on this machine, each part's own, imported when called."""

from __future__ import annotations

import importlib

import click

from s2r_protocol.cli.commands import Command

BENCHES: dict[str, Command] = {
    "executor": Command(
        "s2r_executor.bench.cli:executor",
        "sim",
        "The real-time loop against a reference thread, and its cost.",
    ),
    "planning": Command("s2r_host.cli_bench:planning", "host", "The planner against others."),
    "paper": Command(
        "s2r_sim.paper.cli:paper", "host,sim", "The paper's accuracy table on concealed objects."
    ),
    "ablations": Command(
        "s2r_sim.paper.cli_ablations:ablations",
        "host,sim",
        "The same trials with other options, pair by pair.",
    ),
    "missing": Command(
        "s2r_sim.missing.cli:missing",
        "host,sim",
        "Concealed effects: named, patched, and what that is worth.",
    ),
}


class _LazyBenches(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(BENCHES)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        command = BENCHES.get(cmd_name)
        if command is None:
            return None
        module, attribute = command.target.split(":")
        return getattr(importlib.import_module(module), attribute)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, command.summary) for name, command in BENCHES.items()])


@click.group(cls=_LazyBenches)
def bench() -> None:
    """Measure parts of the project on this machine; every command can be interrupted and continued."""
