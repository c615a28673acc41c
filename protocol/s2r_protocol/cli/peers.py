"""Starting, watching and ending ``s2r`` processes beside this one, and a whole stand-in cell of them."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from s2r_protocol.exits import ExitCode, S2RError

_READY_TIMEOUT_S = 180.0  # a busy machine; a process that dies is noticed at once
_END_TIMEOUT_S = 10.0


class PeerFailedError(S2RError, RuntimeError):
    """A process beside this one ended or did not get ready."""

    def __init__(self, text: str, exit_code: int) -> None:
        super().__init__(text)
        known = exit_code in {int(code) for code in ExitCode} - {int(ExitCode.OK)}
        self.exit_code = ExitCode(exit_code) if known else ExitCode.UNREACHABLE


def s2r_command(*arguments: str | Path) -> list[str]:
    """The command line of one ``s2r`` subcommand, run by this very interpreter."""
    return [sys.executable, "-m", "s2r_protocol", *map(str, arguments)]


def with_parent(*arguments: str | Path) -> list[str]:
    """The same, for one that must not outlive this process: it is interrupted when this one dies, even by SIGKILL.

    By util-linux' ``setpriv``, since what runs between fork and exec in Python is not safe beside other threads.
    """
    setpriv = shutil.which("setpriv")
    bound = [setpriv, "--pdeathsig", "INT", "--"] if setpriv else []
    return [*bound, *s2r_command(*arguments)]


def free_port() -> int:
    """A TCP port on loopback that nobody listens on right now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def peer(name: str, arguments: Sequence[str | Path], folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run ``s2r …`` beside us until the block ends; its output goes to ``<folder>/<name>.log``.

    The process gets a session of its own, so Ctrl-C in the terminal reaches the host first: the arm is brought to rest
    before executor and stand-in go.

    Raises:
        PeerFailedError: It ended or was not ready in time; the text quotes the end of its log.
    """
    log_path, ready = folder / f"{name}.log", folder / f"{name}.ready"
    ready.unlink(missing_ok=True)
    with log_path.open("w") as log:
        process = subprocess.Popen(
            [*with_parent(*arguments), "--ready-file", str(ready)],
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            _wait_until_ready(name, process, ready, log_path)
            yield process
        finally:
            _end(process)
            ready.unlink(missing_ok=True)


@dataclass(frozen=True)
class Cell:
    """A running stand-in and its executor: where they listen, and where logs and recordings go."""

    executor: str
    camera: str
    bus: str
    folder: Path
    executor_process: subprocess.Popen[bytes]

    @property
    def recordings(self) -> Path:
        """Folder with the executor's recordings."""
        return self.folder / "recordings"


@contextmanager
def stand_in_cell(
    folder: Path,
    world: Sequence[str | Path] = ("--seed", "1"),
    clock: str = "lockstep",
    pace: float = 0.0,
    stand_in: Sequence[str | Path] = (),
    executor: Sequence[str | Path] = (),
) -> Iterator[Cell]:
    """A stand-in and an executor with addresses of their own, until the block ends.

    Args:
        folder: For logs and recordings; made if missing.
        world: ``("--seed", "7")`` or ``("--world", FILE)``.
        clock, pace: Of both; pace 0 is as fast as the machine allows (lock-step only).
        stand_in, executor: Further options of ``s2r sim-arm`` and ``s2r executor``.

    Raises:
        PeerFailedError: One of them did not start; the text quotes its log.
    """
    folder.mkdir(parents=True, exist_ok=True)
    camera, endpoint = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    both = ("--clock", clock, "--pace", str(pace))
    with tempfile.TemporaryDirectory(prefix="s2r-") as sockets:
        bus = f"unix:{sockets}/bus.sock"
        arm = ("sim-arm", *world, "--bus", bus, "--listen", camera, *both, *stand_in)
        front = (
            "executor",
            "--bus",
            bus,
            "--listen",
            endpoint,
            "--record",
            folder / "recordings",
            *both,
            *executor,
        )
        with peer("sim-arm", arm, folder), peer("executor", front, folder) as of_executor:
            yield Cell(endpoint, camera, bus, folder, of_executor)


def _wait_until_ready(name: str, process: subprocess.Popen[bytes], ready: Path, log_path: Path) -> None:
    deadline = time.monotonic() + _READY_TIMEOUT_S
    while not ready.exists():
        code = process.poll()
        if code is not None:
            raise PeerFailedError(
                f"{name} ended with exit code {code} before it was ready:\n{_tail(log_path)}", code
            )
        if time.monotonic() > deadline:
            text = f"{name} was not ready within {_READY_TIMEOUT_S:.0f} s:\n{_tail(log_path)}"
            raise PeerFailedError(text, ExitCode.UNREACHABLE)
        time.sleep(0.02)


def _tail(log_path: Path, lines: int = 12) -> str:
    return "\n".join(log_path.read_text(errors="replace").splitlines()[-lines:])


def _end(process: subprocess.Popen[bytes]) -> None:
    """SIGINT first, as an operator would; SIGKILL only when that is not heard."""
    if process.poll() is not None:
        return
    process.send_signal(signal.SIGINT)
    try:
        process.wait(_END_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
