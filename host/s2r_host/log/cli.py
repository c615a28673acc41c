"""``s2r log``: check, recover, export and compare recordings."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from s2r_host.log.recording_file import recording_file
from s2r_protocol.cli.options import FiniteRange
from s2r_protocol.cli.outputs import check_new_file, check_unused
from s2r_protocol.exits import ExitCode, UsageError

if TYPE_CHECKING:
    from s2r_host.log.diff import MotionDifference
    from s2r_host.log.tables import Recording

_RECORDING = click.Path(path_type=Path, exists=True)
EXPORTS = ("parquet", "csv", "rrd", "lerobot")


@click.group()
def log() -> None:
    """Check, mend, export and compare recordings (MCAP). The folder of a run or a plan stands for its recording."""


@log.command()
@click.argument("file", type=_RECORDING)
@click.option("--json", "as_json", is_flag=True, help="Print the findings on standard output.")
def check(file: Path, as_json: bool) -> int:
    """Is FILE whole, and can every message be decoded? Exit 4 if not."""
    from s2r_host.log.check import check as look

    found = look(recording_file(file))
    if as_json:
        click.echo(json.dumps(found.as_dict(), indent=1))
    else:
        for topic in found.topics:
            rate = "" if topic.rate_hz is None else f"{topic.rate_hz:7.1f} Hz"
            click.echo(
                f"{topic.messages:9d}  {rate:>10}  {topic.duration_s:8.2f} s  "
                f"{topic.name}  [{topic.type_name}]"
            )
        if found.attachments:
            click.echo(f"attachments: {', '.join(found.attachments)}")
        for text in found.notes:
            click.echo(f"note: {text}")
        for text in found.problems:
            click.echo(f"problem: {text}", err=True)
        click.echo(f"{found.path}: {'damaged' if found.problems else 'whole'}")
    return int(ExitCode.REFUSED if found.problems else ExitCode.OK)


@log.command()
@click.argument("file", type=_RECORDING)
@click.option("--out", type=click.Path(path_type=Path), help="New file [default: FILE with .recovered.mcap].")
@click.option("--json", "as_json", is_flag=True, help="Print what was saved on standard output.")
def recover(file: Path, out: Path | None, as_json: bool) -> int:
    """Write everything readable of FILE into a new, complete recording. Exit 4 if no message of a damaged FILE is."""
    from s2r_host.log.recover import recover as mend

    source = recording_file(file)
    target = out or source.with_suffix(".recovered.mcap")
    check_new_file(target)
    saved = mend(source, target)
    code = ExitCode.OK
    if saved.damage.any and not saved.messages:
        code = ExitCode.REFUSED
        click.echo(
            f"s2r log: no message of {source} could be saved; look for a copy of the recording", err=True
        )
    if as_json:
        values = {**asdict(saved), "path": str(saved.path)}
        click.echo(json.dumps(values, indent=1))
        return int(code)
    span_s = (saved.last_ns - saved.first_ns) * 1e-9
    click.echo(
        f"{saved.messages} messages over {span_s:.2f} s and {saved.attachments} attachments saved in {saved.path}"
    )
    damage = saved.damage
    if damage.any:
        click.echo(
            f"not readable: {damage.unread_bytes} bytes at the end, {damage.chunks} chunks, "
            f"{saved.orphans} messages without a channel ({damage.reason})"
        )
    else:
        click.echo("the file was whole")
    return int(code)


@log.command()
@click.argument("file", type=_RECORDING)
@click.option("--to", "kind", type=click.Choice(EXPORTS), required=True, help="Format.")
@click.option(
    "--out", type=click.Path(path_type=Path), help="New file (rrd) or folder [default: beside FILE]."
)
@click.option(
    "--fps", type=click.IntRange(1, 1000), default=50, show_default=True, help="lerobot: frames per second."
)
@click.option("--arm", help="rrd: shipped arm or folder [default: what the recording names].")
@click.option("--json", "as_json", is_flag=True, help="Print what was written on standard output.")
def export(file: Path, kind: str, out: Path | None, fps: int, arm: str | None, as_json: bool) -> int:
    """Turn FILE into tables (parquet, csv), a Rerun recording (rrd) or a LeRobot dataset (lerobot).

    What lies at --out already is not replaced; an earlier export beside FILE is, a dataset excepted.
    """
    from s2r_host.log.tables import read_recording

    _check_goes_with(kind)
    source = recording_file(file)
    folder = out or source.with_name(f"{source.stem}-{kind}")
    if kind == "rrd" and out is not None:
        check_new_file(out)
    elif kind == "lerobot" or out is not None:  # episodes of two exports in one folder would be one dataset
        check_unused(folder)
    recording = read_recording(source)
    _tell_damage(recording, "exporting")
    values: dict[str, Any] = {"format": kind, "damaged": recording.damage.any}
    if kind == "rrd":
        from s2r_host.log.export_rrd import export_rrd

        written = export_rrd(recording, out or source.with_suffix(".rrd"), arm)
        values["files"] = lines = [str(written)]
    elif kind == "lerobot":
        from s2r_host.log.export_lerobot import export_lerobot

        values["episodes"] = export_lerobot(recording, folder, fps)
        values["folder"] = str(folder)
        lines = [f"{values['episodes']} episodes in {folder}"]
    else:
        from s2r_host.log.export_tables import export_tables

        tables, values["left_out"] = export_tables(recording, folder, kind)
        values["files"] = lines = [str(path) for path in tables]
        if values["left_out"]:
            click.echo(f"no tables or columns, left out: {', '.join(values['left_out'])}", err=True)
    click.echo(json.dumps(values, indent=1) if as_json else "\n".join(lines))
    return int(ExitCode.OK)


def _tell_damage(recording: Recording, doing: str) -> None:
    """Say on stderr that a part of a recording is missing in what follows."""
    if recording.damage.any:
        click.echo(f"s2r log: {recording.path} is damaged; {doing} what is readable", err=True)


def _check_goes_with(kind: str) -> None:
    """Refuse an option that the format would leave aside without a word."""
    context = click.get_current_context()
    for option, its_kind in (("fps", "lerobot"), ("arm", "rrd")):
        if kind != its_kind and context.get_parameter_source(option) == ParameterSource.COMMANDLINE:
            raise UsageError(f"--{option} is of --to {its_kind}, not of {kind}; leave it out")


@log.command()
@click.argument("first", type=_RECORDING)
@click.argument("second", type=_RECORDING)
@click.option(
    "--tolerance",
    "tolerance_rad",
    type=FiniteRange(0),
    default=1e-3,
    show_default=True,
    help="Largest residual [rad] that is no difference.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the comparison on standard output.")
def diff(first: Path, second: Path, tolerance_rad: float, as_json: bool) -> int:
    """Compare the motions of two recordings on one time base. Exit 7 if they differ or one ends before the other."""
    from s2r_host.log.diff import diff as compare
    from s2r_host.log.tables import read_recording

    recordings = [read_recording(recording_file(file)) for file in (first, second)]
    for recording in recordings:
        _tell_damage(recording, "comparing")
    found = compare(*recordings)
    differs = found.exceeds(tolerance_rad)
    if as_json:
        damaged = [recording.damage.any for recording in recordings]
        click.echo(json.dumps({**found.as_dict(), "damaged": damaged, "differs": differs}, indent=1))
    else:
        for name, (a, b) in found.facts.items():
            click.echo(f"{name}: {a} | {b}")
        for m in found.motions:
            _tell_motion(m, found.joint_names)
        for which, labels in (("first", found.only_a), ("second", found.only_b)):
            if labels:
                click.echo(f"only in the {which}: {', '.join(labels)}")
        click.echo("they differ" if differs else f"no difference above {tolerance_rad:g} rad")
    return int(ExitCode.DIFFERENCE if differs else ExitCode.OK)


def _tell_motion(m: MotionDifference, joint_names: Sequence[str]) -> None:
    joint, t_s, residual = m.worst
    click.echo(
        f"{m.label}: {m.duration_a_s:.2f} s and {m.duration_b_s:.2f} s, rms {1e3 * float(m.rms_rad.max()):.4f} mrad, "
        f"worst {1e3 * residual:+.4f} mrad on {joint_names[joint]} at {t_s:.2f} s"
    )
    if m.one_is_shorter:
        click.echo(
            f"{m.label}: the first comes to {m.reached_a_s:.2f} s of it, the second to {m.reached_b_s:.2f} s; "
            "what is in one only is not compared"
        )
