"""``s2r view``: look at a recording, in Rerun or in a browser."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import click

from s2r_host.log.recording_file import recording_file
from s2r_protocol.cli.outputs import check_new_file
from s2r_protocol.cli.progress import progress_line


@click.command()
@click.argument("file", type=click.Path(path_type=Path, exists=True))
@click.option(
    "--html",
    "out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write this one HTML file; no Rerun. An earlier page of this command may be replaced, another file not.",
)
@click.option("--arm", help="Shipped arm or folder [default: what the recording names].")
def view(file: Path, out: Path | None, arm: str | None) -> None:
    """Look at FILE, a recording or a run folder: in Rerun where it and a display exist, else as one HTML file."""
    from s2r_host.log.tables import read_recording

    source = recording_file(file)
    rerun = None if out is not None else _rerun()
    page = out or source.with_suffix(".html")
    if rerun is None:
        from s2r_host.log.view import is_own_page

        if not is_own_page(page):
            check_new_file(page)
    with progress_line() as tell:
        tell(f"reading {source}")
        recording = read_recording(source)
    if recording.damage.any:
        click.echo(f"s2r view: {source} is damaged; showing what is readable", err=True)
    if rerun is not None:
        from s2r_host.log.export_rrd import export_rrd

        path = export_rrd(recording, Path(tempfile.mkdtemp(prefix="s2r-view-")) / f"{source.stem}.rrd", arm)
        click.echo(f"opening {path} in Rerun")
        subprocess.Popen([rerun, str(path)], start_new_session=True)
        return
    from s2r_host.log.view import write_html

    with progress_line() as tell:
        write_html(recording, page, arm, tell)
    click.echo(page)


def _rerun() -> str | None:
    """Rerun's viewer, where there is one and a display to show it on."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return None
    beside = Path(sys.executable).with_name("rerun")
    return str(beside) if beside.exists() else shutil.which("rerun")
