"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path

import click

tls_option = click.option(
    "--tls",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder with certificates, from 's2r doctor --make-certs'; without it only this machine is reached.",
)

attempts_option = click.option(
    "--attempts",
    type=click.IntRange(min=1),
    default=3,
    show_default=True,
    help="Planned manipulations at most, per target.",
)

SEED = click.IntRange(min=0)
"""Type of every ``--seed``: numpy's generators take no negative number."""
