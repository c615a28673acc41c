"""Entry point of ``s2r``: finds a subcommand, runs it, and turns errors into a sentence and an exit code."""

from __future__ import annotations

import errno
import importlib
import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType
from typing import Any

import click

from s2r_protocol.cli.commands import COMMANDS
from s2r_protocol.cli.ending import hear
from s2r_protocol.cli.terminal import outlive_the_terminal
from s2r_protocol.exits import ExitCode, NotReadyError, S2RError
from s2r_protocol.whole_file import NO_ROOM


class _LazyGroup(click.Group):
    """A group that knows its commands' names and summaries, and imports only the one that is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        command = COMMANDS.get(cmd_name)
        return None if command is None else _load(cmd_name)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the subcommand; what it imports when called may be missing as well."""
        try:
            return super().invoke(ctx)
        except ModuleNotFoundError as error:
            _refuse_missing_extra(ctx.invoked_subcommand or "", error)
            raise

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, command.summary) for name, command in COMMANDS.items()])


def _load(name: str) -> click.Command:
    command = COMMANDS[name]
    module, attribute = command.target.split(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError as error:
        _refuse_missing_extra(name, error)
        raise


def _refuse_missing_extra(name: str, error: ModuleNotFoundError) -> None:
    """Say what to install when a command's optional packages are missing.

    Raises:
        NotReadyError: The command belongs to an extra and a module of somebody else's is missing.
    """
    command = COMMANDS.get(name)
    if command is None or not command.extra or error.name is None or error.name.startswith("s2r_"):
        return
    raise NotReadyError(
        f"'s2r {name}' needs the module {error.name!r}, which is not installed here. "
        f"Install it with: pip install 'sim2real2[{command.extra}]', in a checkout: pip install '.[{command.extra}]'"
    ) from error


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="sim2real2", prog_name="s2r")
def s2r() -> None:
    """Sim2Real²: build the physics of an articulated object, plan in it, move it to an exact joint value.

    This is software: it carries no performance level. Emergency stop and safe torque off are hardware.

    Exit codes: 0 ok, 1 bug, 2 usage, 3 machine not ready, 4 refused, 5 peer unreachable,
    6 stopped by protection, 7 difference found, 130 interrupted.
    """


_RIGHTS = "this user may not do that there; change its rights, or name a place of your own"
_SPACE = "make room, or name a place on another disk"
_NEXT_STEP = {
    errno.EACCES: _RIGHTS,
    errno.EPERM: _RIGHTS,
    errno.EROFS: "name a place that can be written to",
    errno.ENOENT: "correct the path; for a new file or folder the one above it must exist",
    errno.ENOTDIR: "correct the path: what stands before the last / must be a folder",
    errno.EISDIR: "name a file in it",
    errno.EEXIST: "name another, or move that one away",
    errno.ENAMETOOLONG: "name a shorter one",
    errno.ENOSPC: _SPACE,
    errno.EDQUOT: _SPACE,
    errno.EFBIG: "raise the limit of this shell (ulimit -f), or name a place on a disk that takes such files",
}
"""What a user can do about a file or folder; any other OSError is a bug."""


def _report_bug() -> ExitCode:
    """The exception under way with its traceback, for a report to us."""
    import traceback  # only a bug needs it

    traceback.print_exc()
    click.echo("s2r: this is a bug in s2r; please report it with the lines above", err=True)
    return ExitCode.BUG


def _while_importing(error: BaseException) -> bool:
    """Whether an error came out of a module that was being loaded."""
    trace = error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        trace = trace.tb_next
    return False


def _report_file(error: OSError) -> ExitCode:
    """A file or folder the user named, and what to do about it. A full disk has no name: it may show at any write."""
    full = error.errno in NO_ROOM
    if error.errno not in _NEXT_STEP or (error.filename is None and not full):
        return _report_bug()
    where = "" if error.filename is None else f"{os.fsdecode(error.filename)}: "
    click.echo(f"s2r: {where}{error.strerror}; {_NEXT_STEP[error.errno]}", err=True)
    return ExitCode.NOT_READY if full else ExitCode.USAGE


def main(arguments: Sequence[str] | None = None) -> None:
    """Run ``s2r`` and exit with the documented code. SIGTERM and a lost terminal end every command as Ctrl-C does."""
    asked_to_end = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal asked_to_end
        asked_to_end = True
        signal.default_int_handler(number, frame)

    outlive_the_terminal()
    # A shell's background job starts deaf to Ctrl-C. Whatever moves an arm has to hear it.
    hear(interrupt)
    try:
        code = s2r.main(args=arguments, prog_name="s2r", standalone_mode=False)
    except S2RError as error:
        click.echo(f"s2r: {error}", err=True)
        code = error.exit_code
    except click.exceptions.Abort:
        click.echo("s2r: interrupted", err=True)
        code = ExitCode.INTERRUPTED
    except KeyboardInterrupt:
        click.echo("s2r: interrupted", err=True)
        code = ExitCode.INTERRUPTED
    except click.ClickException as error:
        error.show()
        code = ExitCode.USAGE
    except OSError as error:
        code = _report_file(error)
    except Exception as error:  # noqa: BLE001 - the last line of defence: a bug must end with exit 1 and its traceback
        # What Ctrl-C meets while it loads makes another error of it: native modules "initialization failed", trimesh,
        # which goes on without what it did not get, a TypeError.
        if asked_to_end and (isinstance(error, ImportError) or _while_importing(error)):
            click.echo("s2r: interrupted", err=True)
            code = ExitCode.INTERRUPTED
        else:
            code = _report_bug()
    sys.exit(int(code or ExitCode.OK))
