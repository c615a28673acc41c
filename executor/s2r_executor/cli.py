"""``s2r executor``: admission, lease, recorder and the native core, until Ctrl-C."""

from __future__ import annotations

import errno
import gc
import logging
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

import click

from s2r_executor.config import ExecutorConfig, load_config, parse_override
from s2r_executor.service_manager import ServiceManager
from s2r_protocol.cli.ending import hear, restore
from s2r_protocol.cli.options import tls_option
from s2r_protocol.exits import ExitCode

logger = logging.getLogger(__name__)

_CHECK_PERIOD_S = 0.1
_WATCH_STUCK_S = 1.0
_SAME_SIGNAL_S = 1.0  # for a signal to a whole group of processes to reach the last of them


def _default(key: str) -> str:
    """What holds where neither the option nor a configuration file says otherwise."""
    value = ExecutorConfig.model_fields[key].default
    return ", ".join(value) if isinstance(value, tuple) else str(value)


@click.command()
@click.option("--bus", show_default=_default("bus"), help="unix:PATH (stand-in) or can:IFACE.")
@click.option(
    "--packing",
    type=click.Choice(["fd", "classic"]),
    show_default=_default("packing"),
    help="CAN FD at 1 kHz or classical CAN at 250 Hz; as the arm or its stand-in has it.",
)
@click.option(
    "--clock",
    type=click.Choice(["real", "lockstep"]),
    show_default=_default("clock"),
    help="lockstep: time advances with the drives' answers; as the stand-in has it ('s2r sim-arm': lockstep).",
)
@click.option(
    "--pace",
    type=float,
    show_default=_default("pace"),
    help="lockstep: at most this many times the wall clock while the arm is busy; 0 = as fast as possible, and a tenth "
    "of the wall clock once the arm has waited for a simulated second.",
)
@click.option(
    "--listen",
    multiple=True,
    show_default=_default("listen"),
    help="Zenoh address to listen on, e.g. tcp/127.0.0.1:7447. May be repeated.",
)
@tls_option
@click.option(
    "--record", type=click.Path(file_okay=False, path_type=Path), help="Folder for recordings (MCAP)."
)
@click.option("--cell", show_default=_default("cell"), help="Name of the cell in the key space.")
@click.option("--arm", show_default=_default("arm"), help="Shipped arm's name or a folder with an arm.yaml.")
@click.option(
    "--config", "config_path", type=click.Path(exists=True, dir_okay=False, path_type=Path), help="YAML file."
)
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override one key, e.g. core.goal_timeout_s=3.",
)
@click.option("--host-timeout", type=float, help="Silence of the host [s] after which the arm stops.")
@click.option(
    "--ready-file", type=click.Path(dir_okay=False, path_type=Path), help="Written when ready: one line."
)
@click.option(
    "--commission",
    is_flag=True,
    help="Only look at the drives on the bus: who they are, their limits and watchdogs. Enables nothing.",
)
@click.option("--json", "as_json", is_flag=True, help="With --commission: print the findings as JSON.")
@click.option("-v", "--verbose", is_flag=True, help="Log more.")
def executor(
    config_path: Path | None,
    overrides: tuple[str, ...],
    ready_file: Path | None,
    commission: bool,
    as_json: bool,
    verbose: bool,
    **options: Any,  # the remaining options, by name; None or () where not given
) -> None:
    """Admit plans and stream setpoints to the drives.

    This is software and carries no performance level: emergency stop and safe torque off are hardware.
    """
    logging.basicConfig(
        level=logging.DEBUG if verbose else logging.INFO,
        format="%(asctime)s %(levelname)s %(name)s: %(message)s",
    )
    settings = dict(parse_override(text) for text in overrides)
    renamed = {"host_timeout": "host_timeout_s"}
    for name, value in options.items():
        if value not in (None, ()):
            settings[renamed.get(name, name)] = value
    config = load_config(config_path, settings)
    sys.exit(run_commissioning(config, as_json) if commission else run(config, ready_file))


def run_commissioning(config: ExecutorConfig, as_json: bool) -> ExitCode:
    """Look at the drives, print what was found, keep it if the configuration names a file.

    Raises:
        S2RError: The bus is not there, or another master is on it.
    """
    import json
    from dataclasses import asdict

    from s2r_executor.commission import commission
    from s2r_executor.commission_record import read_identities, write_record
    from s2r_protocol.arms import load_arm
    from s2r_protocol.cli.findings import print_findings

    arm = load_arm(config.arm)
    known = read_identities(config.commissioned) if config.commissioned is not None else None
    found = commission(config, arm, known, lambda doing: click.echo(f"commissioning: {doing}", err=True))
    if config.commissioned is not None:
        write_record(config.commissioned, config, arm, found, known)
        click.echo(f"commissioning: kept in {config.commissioned}", err=True)
    if as_json:
        click.echo(json.dumps([asdict(finding) for finding in found.findings], indent=2))
    else:
        print_findings(found.findings)
    return ExitCode.OK if found.passed else ExitCode.REFUSED


def _check_record(folder: Path | None) -> None:
    """Refuse a folder that takes no recordings. Once the arm moves, a recorder that fails stops nothing.

    Raises:
        OSError: It cannot be made, or not be written to.
    """
    if folder is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(folder))


def run(config: ExecutorConfig, ready_file: Path | None = None) -> ExitCode:
    """Run until SIGINT, SIGTERM or the loss of its terminal: then stop on the path, disarm, close.

    Raises:
        OSError: The folder for recordings takes none.
        S2RError: The native parts, the bus or an address are not available, or the core died.
    """
    _check_record(config.record)
    # Heavy imports stay here: `s2r executor --help` needs none of them.
    from s2r_executor.assembly import Executor
    from s2r_executor.core_process import CoreEndedError

    asked_to_end = threading.Event()
    manager = ServiceManager(os.environ)
    previous = hear(lambda *_: asked_to_end.set())
    try:
        with Executor(config) as executor_:
            line = executor_.summary()
            click.echo(line)
            sys.stdout.flush()
            if ready_file is not None:
                ready_file.write_text(line + "\n", encoding="utf-8")
            manager.ready(line)
            period_s = min(_CHECK_PERIOD_S, (manager.watchdog_s or 1.0) / 4)
            while not asked_to_end.wait(period_s):
                try:
                    executor_.check()
                except CoreEndedError:
                    if not asked_to_end.wait(_SAME_SIGNAL_S):
                        raise
                    break
                if executor_.watch_age_s < _WATCH_STUCK_S:  # a stuck watch loop is no life
                    manager.alive(executor_.status_line())
            manager.stopping()
            started = time.monotonic()
            at_rest = executor_.shut_down()
            logger.info("shut down in %.2f s", time.monotonic() - started)
        del executor_
    finally:
        restore(previous)
        gc.collect()  # callbacks and their objects form cycles; the native module wants none alive at exit
    return ExitCode.OK if at_rest else ExitCode.PROTECTION
