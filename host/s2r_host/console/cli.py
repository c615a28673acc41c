"""``s2r console``: the operator's page."""

from __future__ import annotations

import contextlib
import logging
import os
import threading
from pathlib import Path
from types import FrameType

import click
from click.core import ParameterSource

from s2r_protocol.cli.ending import hear, restore
from s2r_protocol.cli.options import tls_option
from s2r_protocol.exits import ExitCode, UsageError

DEFAULT_EXECUTOR = "tcp/127.0.0.1:7447"
DEFAULT_CAMERA = "tcp/127.0.0.1:7448"


def _there_if_named(context: click.Context, option: click.Parameter, folder: Path) -> Path:
    """The folder; only the default one may be missing, as it is before the first run, and is made."""
    source = context.get_parameter_source(option.name or "")
    if source != ParameterSource.DEFAULT and not folder.is_dir():
        raise UsageError(
            f"--runs {folder}: there is no such folder; correct the path, or make it: mkdir -p {folder}"
        )
    return folder


@click.command()
@click.option(
    "--executor", default=DEFAULT_EXECUTOR, show_default=True, help="Zenoh endpoint of the executor."
)
@click.option("--camera", default=DEFAULT_CAMERA, show_default=True, help="Zenoh endpoint of the camera.")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address to listen on; beyond loopback needs a token.",
)
@click.option(
    "--port", default=7450, show_default=True, type=click.IntRange(0, 65535), help="Port; 0 takes a free one."
)
@click.option(
    "--token-file",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="File with the token browsers must show, at least 16 characters.",
)
@click.option(
    "--view-only",
    is_flag=True,
    help="Never take the lease. STOP still works; not with --tls, where the monitor's certificate is used.",
)
@click.option(
    "--runs",
    "runs_root",
    type=click.Path(file_okay=False, path_type=Path),
    callback=_there_if_named,
    default=Path("runs"),
    show_default=True,
    help="Folder with run folders; the default one is made where it is missing.",
)
@click.option("--arm", default="xmate3pro", show_default=True, help="Shipped arm, or a folder with arm.yaml.")
@click.option("--cell", default="lab", show_default=True, help="Name of the cell in the key space.")
@tls_option
@click.option(
    "--ready-file", type=click.Path(dir_okay=False, path_type=Path), help="Written when ready: the address."
)
def console(
    executor: str,
    camera: str,
    host: str,
    port: int,
    token_file: Path | None,
    view_only: bool,
    runs_root: Path,
    arm: str,
    cell: str,
    tls: Path | None,
    ready_file: Path | None,
) -> None:
    """Show one arm in the browser: what it does, why it does not, its runs; and stop it.

    Without control the page only views. STOP works without control: a software stop, not an emergency stop.
    """
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    ended, shown = threading.Event(), threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        if not shown.is_set():
            # Loading and building the page take seconds and hold nothing that outlives the process: no lease, no job.
            # What would be raised is lost there: trimesh catches all at its optional imports, viser's threads stay.
            os.write(2, b"s2r: interrupted\n")  # a stream may be in the middle of a line of its own
            os._exit(ExitCode.INTERRUPTED)
        ended.set()

    before = hear(end)
    try:
        from s2r_host.console.gate import Address, Gate

        token = _read_token(token_file) if token_file is not None else ""
        address = Address(host, port, token)
        from s2r_host.console.app import Console
        from s2r_protocol.arms import load_arm
        from s2r_protocol.keys import ArmKeys

        description = load_arm(arm)
        with (
            contextlib.closing(
                Console(
                    description, ArmKeys(cell, description.name), executor, camera, runs_root, tls, view_only
                )
            ) as page,
            Gate(address, page.port) as gate,
        ):
            page.start()
            named = "127.0.0.1" if host in ("0.0.0.0", "::") else host
            url = f"http://{f'[{named}]' if ':' in named else named}:{gate.port}/"
            click.echo(f"s2r console: {url}{'?token=…' if token else ''}")
            shown.set()
            if ready_file is not None:
                ready_file.write_text(url + "\n", encoding="utf-8")
            ended.wait()
    finally:
        restore(before)


def _read_token(path: Path) -> str:
    try:
        token = path.read_text(encoding="utf-8").strip()
    except UnicodeDecodeError as error:
        raise UsageError(
            f"--token-file {path} is not text; make one with: openssl rand -hex 16 > {path}"
        ) from error
    if not token:
        raise UsageError(f"--token-file {path} is empty; make one with: openssl rand -hex 16 > {path}")
    return token
