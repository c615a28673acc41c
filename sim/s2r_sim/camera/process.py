"""The camera in a process of its own: rendering never holds up the bus."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import signal
from multiprocessing.connection import Connection
from pathlib import Path

from s2r_protocol.arms import load_arm
from s2r_protocol.exits import S2RError
from s2r_protocol.keys import ArmKeys
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.camera.service import CameraService
from s2r_sim.camera.snapshot import Snapshot
from s2r_sim.errors import StandInError
from s2r_sim.physics import build_world
from s2r_sim.world import WorldSpec

_START_TIMEOUT_S = 60.0
_END_TIMEOUT_S = 5.0


class CameraProcess:
    """Starts the camera and ends it. It also ends by itself when this process dies."""

    def __init__(
        self,
        arm_directory: Path,
        world: WorldSpec,
        snapshot: Snapshot,
        listen: str,
        keys: ArmKeys,
        tls: Path | None = None,
    ) -> None:
        """Start and wait until it answers.

        Raises:
            StandInError: It cannot start.
        """
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_run,
            args=(theirs, arm_directory, world.to_json(), snapshot, listen, keys, tls),
            name="s2r-camera",
            daemon=True,
        )
        self._process.start()
        theirs.close()
        if not self._pipe.poll(_START_TIMEOUT_S):
            self.close()
            raise StandInError(f"the camera process did not start within {_START_TIMEOUT_S:.0f} s")
        try:
            problem = self._pipe.recv()
        except EOFError:
            problem = f"the camera process ended at its start with exit code {self._process.exitcode}"
        if problem:
            self.close()
            raise StandInError(problem)

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return self._process.is_alive()

    def close(self) -> None:
        """End it."""
        self._pipe.close()
        self._process.join(_END_TIMEOUT_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _run(
    parent: Connection,
    arm_directory: Path,
    world_json: str,
    snapshot: Snapshot,
    listen: str,
    keys: ArmKeys,
    tls: Path | None,
) -> None:
    """Body of the process: serve until the other end of the pipe closes."""
    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # Ctrl-C reaches the whole group; the stand-in ends us in order
    logging.basicConfig(level=logging.INFO, format="camera: %(message)s")
    world = WorldSpec.model_validate_json(world_json)
    camera = DepthCamera(build_world(load_arm(arm_directory), world), world.camera)
    reported = world.camera.X_base_camera_reported
    try:
        service = CameraService(
            listen,
            keys,
            lambda: camera.capture(snapshot.read()),
            camera.rig.K,
            reported,
            world.commitment,
            tls=tls,
        )
    except S2RError as error:
        parent.send(str(error))
        return
    parent.send("")
    with contextlib.suppress(EOFError, ConnectionError):
        parent.poll(None)  # nothing is ever sent: it returns when the stand-in closes the pipe or dies
    service.close()
