"""The stand-in as one process (plus its camera): everything an arm's cell would answer with."""

from __future__ import annotations

import gc
import logging
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import click

from s2r_protocol.arms import load_arm
from s2r_protocol.can.identifiers import FRAMES, is_used
from s2r_protocol.can.timing import BitRate, check_load
from s2r_protocol.cli.ending import hear, restore
from s2r_protocol.exits import UsageError
from s2r_protocol.keys import ArmKeys
from s2r_sim.bus.bus import Bus
from s2r_sim.bus.can_hub import open_hub
from s2r_sim.bus.classic_nodes import ClassicNodes
from s2r_sim.bus.fd_nodes import FdNodes
from s2r_sim.bus.object_dictionary import SdoServers
from s2r_sim.bus.wire import Injection, Wire
from s2r_sim.camera.process import CameraProcess
from s2r_sim.camera.snapshot import Snapshot
from s2r_sim.plant import Plant
from s2r_sim.truth import TruthLog
from s2r_sim.world import WorldSpec

logger = logging.getLogger(__name__)

PRIORITY = 60  # below the core's 80
NODES = {"fd": FdNodes, "classic": ClassicNodes}


@dataclass(frozen=True)
class StandInConfig:
    """How to run it; see ``s2r sim-arm --help``."""

    arm: str = "xmate3pro"
    clock: str = "lockstep"
    pace: float = 1.0
    bus: str = "unix:/tmp/s2r.sock"
    packing: str = "fd"
    listen: str = "tcp/127.0.0.1:7448"
    tls: Path | None = None
    truth_file: Path | None = None
    cell: str = "lab"
    injections: tuple[str, ...] = ()
    ready_file: Path | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.pace <= 1000:
            raise UsageError(f"--pace {self.pace} is outside 0..1000")
        if self.clock == "real" and self.pace == 0:
            raise UsageError("--pace 0 means 'as fast as possible', which the real clock cannot be")
        if self.packing not in NODES:
            raise UsageError(f"unknown packing {self.packing!r}; known are {', '.join(NODES)}")


def run_stand_in(world: WorldSpec, config: StandInConfig) -> None:
    """Run until SIGINT, SIGTERM or the loss of its terminal.

    Raises:
        S2RError: It cannot start; the text says why.
    """
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    arm = load_arm(config.arm)
    keys = ArmKeys(config.cell, arm.name)
    plant = Plant(arm, world)
    nodes = NODES[config.packing](plant.drives)
    rate = BitRate()
    load = check_load(config.packing, arm.dof, nodes.tick_ns, rate)
    injections = [Injection.parse(text) for text in config.injections]
    _warn_of_strangers(injections, config.packing, arm.dof)
    wire = Wire(nodes.tick_ns, rate, injections)
    click.echo(f"world {world.commitment}")
    with ExitStack() as stack:
        snapshot = Snapshot(plant.physics.model.nq)
        snapshot(plant)
        plant.observers.append(snapshot)
        hub = open_hub(config.bus)
        stack.callback(hub.close)
        camera = CameraProcess(arm.directory, world, snapshot, config.listen, keys, config.tls)
        stack.callback(camera.close)
        if config.truth_file is not None:  # no log of a stand-in that does not start
            truth = TruthLog(config.truth_file, plant)
            stack.callback(truth.close)
            plant.observers.append(truth)
        bus = Bus(hub, wire, nodes, plant)
        bus.responders.append(SdoServers(plant.drives, arm, nodes.tick_ns, nodes.is_stopped).answer)
        stack.enter_context(_stopped_by_signals(bus))
        click.echo(
            f"bus {hub.path}, {config.packing} packing, worst-case load {100 * load:.1f} %, {config.clock} clock; "
            f"camera {keys.capture()} on {config.listen}"
        )
        if config.ready_file is not None:
            config.ready_file.touch()
        gc.collect()
        gc.freeze()  # what lives now lives to the end: later collections stay short
        if config.clock == "real":
            _ask_for_priority()
            bus.run_real(config.pace)
        else:
            bus.run_lockstep(config.pace)
        logger.info(
            "stand-in ends after %d ticks, bus load %.1f %%, %d frames refused by the drives",
            bus.ticks,
            100 * wire.load,
            nodes.refused,
        )
        for rule in injections:
            click.echo(f"{wire.disturbed[rule]} frames disturbed by '{rule}'")


def _warn_of_strangers(injections: list[Injection], packing: str, drives: int) -> None:
    """Say which rules meet neither executor nor drives. Not refused: a test may bring a node of its own."""
    for rule in injections:
        if rule.can_id is None or is_used(rule.can_id, packing, drives):
            continue
        known = ", ".join(
            f"{frame.name} {ids[0]:#05x}" + (f" to {ids[-1]:#05x}" if len(ids) > 1 else "")
            for frame in FRAMES[packing]
            for ids in [frame.of(drives)]
        )
        click.echo(
            f"s2r sim-arm: --inject '{rule}': neither executor nor drives send {rule.can_id:#05x} in the {packing} "
            f"packing; it can only meet frames of a node of your own. Theirs are {known}",
            err=True,
        )


def _ask_for_priority() -> None:
    """Drives wait for no desktop. Without the right to a FIFO priority the clock is as good as the machine."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    except PermissionError:
        logger.warning(
            "no right to a real-time priority: with the real clock a busy machine looks like a bad bus"
        )


@contextmanager
def _stopped_by_signals(bus: Bus) -> Iterator[None]:
    def stop(_signal: int, _frame: FrameType | None) -> None:
        bus.stop()

    before = hear(stop)
    try:
        yield
    finally:
        restore(before)
