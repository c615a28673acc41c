"""Options of the commands that only talk with an executor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from s2r_protocol.cli.options import tls_option
from s2r_protocol.exits import UsageError

DEFAULT_EXECUTOR = "tcp/127.0.0.1:7447"
_LONGEST_WAIT_S = 3600.0


def talk_options(timeout_s: float, in_vain: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """``--executor``, ``--cell``, ``--arm``, ``--tls`` and ``--timeout``.

    Args:
        timeout_s: The default [s].
        in_vain: What a bad one means to whoever asks: "nothing was stopped".
    """

    def checked(ctx: click.Context, param: click.Parameter, value: float) -> float:
        if not 0.0 <= value <= _LONGEST_WAIT_S:  # says no to NaN as well
            raise UsageError(f"--timeout {value:g} s is outside 0..{_LONGEST_WAIT_S:g} s; {in_vain}")
        return value

    options = (
        click.option(
            "--executor", "endpoint", default=DEFAULT_EXECUTOR, show_default=True, help="Zenoh endpoint."
        ),
        click.option("--cell", default="lab", show_default=True, help="Name of the cell in the key space."),
        click.option(
            "--arm",
            default="xmate3pro",
            show_default=True,
            help="Name of the arm in the cell, or a folder with its arm.yaml.",
        ),
        tls_option,
        click.option(
            "--timeout",
            "timeout_s",
            callback=checked,
            default=timeout_s,
            show_default=True,
            help="Seconds to wait for an answer.",
        ),
    )

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate
