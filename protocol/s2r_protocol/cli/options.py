"""Options that several commands share."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import click

from s2r_protocol.cli.outputs import check_unused

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


class FiniteRange(click.FloatRange):
    """A number within bounds; click's own lets NaN through every bound."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number.

        Raises:
            click.BadParameter: It is no finite number within the bounds.
        """
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number", param, ctx)
        return number


class _UnusedFolder(click.Path):
    """A folder that is new or empty: refused while the command line is read, before anything is loaded or started."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        folder = Path(os.fsdecode(super().convert(value, param, ctx)))
        check_unused(folder)
        return folder


UNUSED_FOLDER = _UnusedFolder(path_type=Path)
"""Type of an ``--out`` that must be new or empty."""
