"""What the fixtures of :mod:`s2r_host.testing.plugin` are made of."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import can
import numpy as np

from s2r_host.errors import CommandRefusedError, PeerUnreachableError
from s2r_host.link import ExecutorLink, ExecutorStatus, Verdict
from s2r_host.trajectory import Trajectory
from s2r_protocol.arms import ArmDescription, load_arm
from s2r_protocol.can.python_can import StandInBus
from s2r_protocol.cli.peers import stand_in_cell
from s2r_protocol.exits import UsageError
from s2r_protocol.faults import ExecutorState

MARGIN = 0.3
"""Share of speed and acceleration limits that :meth:`LabExecutor.move_by` uses when no duration is given."""


@dataclass(frozen=True)
class Lab:
    """A cell under test. ``bus`` and ``recordings`` are None on hardware."""

    executor: str
    camera: str
    arm: ArmDescription
    is_hardware: bool
    bus: str | None
    recordings: Path | None


@contextlib.contextmanager
def stand_in_lab(
    folder: Path,
    arm: str,
    seed: int = 1,
    clock: str = "lockstep",
    pace: float | None = None,
    faults: Sequence[str] = (),
) -> Iterator[Lab]:
    """A stand-in and its executor until the block ends.

    Args:
        folder: For logs and recordings.
        arm: Shipped arm or folder.
        seed: Of the stand-in's hidden world.
        clock: ``lockstep`` or ``real``.
        pace: Simulated over real seconds; by default as fast as possible, and 1 with the real clock.
        faults: ``ACTION:ID@FIRST[-LAST]``, see ``s2r sim-arm --inject``.
    """
    speed = pace if pace is not None else (1.0 if clock == "real" else 0.0)
    injected = [part for rule in faults for part in ("--inject", rule)]
    with stand_in_cell(
        folder, ("--seed", str(seed)), clock, speed, ("--arm", arm, *injected), ("--arm", arm)
    ) as cell:
        yield Lab(cell.executor, cell.camera, load_arm(arm), False, cell.bus, cell.recordings)


def hardware_lab(executor: str, camera: str, arm: str) -> Lab:
    """A cell that runs already."""
    return Lab(executor, camera, load_arm(arm), True, None, None)


class LabExecutor(ExecutorLink):
    """A link with the motions tests want."""

    def __init__(self, lab: Lab) -> None:
        super().__init__(lab.executor, lab.arm, connect_timeout_s=20.0)
        self.lab = lab

    def stop(self) -> Verdict:
        """As any link's, but the test that stops the arm goes on afterwards."""
        verdict = super().stop()
        self.meet()
        return verdict

    def move_by(self, step_rad: Sequence[float] | float, duration_s: float | None = None) -> ExecutorStatus:
        """Move every joint by its step, from rest to rest on a quintic, and wait for the end.

        Args:
            step_rad: Per joint, or one value for all [rad].
            duration_s: By default as long as 30 % of the speed and acceleration limits need.

        Raises:
            UsageError: Not one value per joint, or no duration.
            CommandRefusedError: Admission said no.
            ArmStoppedError: It was stopped on the way.
        """
        return self.wait_done(self.start_by(step_rad, duration_s))

    def start_by(self, step_rad: Sequence[float] | float, duration_s: float | None = None):  # noqa: ANN201 - a Verdict
        """As :meth:`move_by`, but return as soon as the motion has begun."""
        arm, given = self.lab.arm, np.asarray(step_rad, float)
        if given.shape not in ((), (arm.dof,)):
            joints = ", ".join(arm.joint_names)
            raise UsageError(f"step_rad has shape {given.shape}: give one value, or one for each of {joints}")
        if duration_s is not None and not 0.0 < duration_s < np.inf:
            raise UsageError(f"duration_s = {duration_s:g} s: a motion takes more than 0 s")
        step = np.broadcast_to(given, (arm.dof,)).copy()
        q = np.asarray(self.status().q_ref)
        duration_s = shortest_s(arm, step) if duration_s is None else duration_s
        return self.send_plan(quintic_motion(q, step, duration_s), "test motion")


def shortest_s(arm: ArmDescription, step: np.ndarray) -> float:
    """Duration at which a quintic uses 30 % of the speed or acceleration limits [s]; its peaks are 1.875 and 5.774."""
    by_speed = 1.875 * np.abs(step) / (MARGIN * arm.limits.dq_max)
    by_acceleration = np.sqrt(5.7735 * np.abs(step) / (MARGIN * arm.limits.ddq_max))
    return float(max(0.2, by_speed.max(), by_acceleration.max()))


def quintic_motion(q: np.ndarray, step: np.ndarray, duration_s: float, knots: int = 41) -> Trajectory:
    """From ``q`` to ``q + step``, at rest at both ends."""
    t = np.linspace(0.0, duration_s, knots)
    x = t / duration_s
    s = 10 * x**3 - 15 * x**4 + 6 * x**5
    ds = (30 * x**2 - 60 * x**3 + 30 * x**4) / duration_s
    dds = (60 * x - 180 * x**2 + 120 * x**3) / duration_s**2
    return Trajectory(t, q + np.outer(s, step), np.outer(ds, step), np.outer(dds, step))


@contextlib.contextmanager
def open_executor(lab: Lab) -> Iterator[LabExecutor]:
    """Lease taken and drives enabled; afterwards stopped, and on hardware switched off."""
    link = LabExecutor(lab)
    with contextlib.closing(link), link.leased():
        link.arm_drives()
        yield link
        if link.status().state not in (ExecutorState.FAULT, ExecutorState.ESTOP):
            _rest(link, switch_off=lab.is_hardware)


def _rest(link: ExecutorLink, switch_off: bool) -> None:
    try:
        link.come_to_rest()
        if switch_off:
            link.disarm()
    except (CommandRefusedError, PeerUnreachableError) as error:
        raise AssertionError(f"the arm could not be brought to rest after the test: {error}") from error


class VirtualTime:
    """Counts the executor's ticks."""

    def __init__(self, executor: ExecutorLink) -> None:
        self._executor = executor
        self._tick_s = executor.identity.tick_ns * 1e-9

    @property
    def now_s(self) -> float:
        """Time of the arm since its executor started [s]."""
        return self._executor.status().tick * self._tick_s

    def wait(self, seconds: float, wall_limit_s: float = 60.0) -> float:
        """Wait until the arm's clock has gone on by so much; its time then [s].

        Raises:
            UsageError: Not a time.
            TimeoutError: It stands still.
        """
        if not 0.0 <= seconds < np.inf:
            raise UsageError(f"virtual_time.wait({seconds:g}): give 0 s or more")
        goal, deadline = self.now_s + seconds, time.monotonic() + wall_limit_s
        while (now := self.now_s) < goal:
            if time.monotonic() > deadline:
                raise TimeoutError(
                    f"the arm's clock stands at {now:.3f} s, waited {wall_limit_s:g} s for {goal:.3f} s"
                )
            time.sleep(0.002)
        return now


class BusFaults:
    """A node on the stand-in's bus. A context manager."""

    def __init__(self, channel: str) -> None:
        self._bus = StandInBus(channel)

    def send(self, can_id: int, data: bytes = b"", fd: bool = False) -> None:
        """Put a frame of your own on the bus, e.g. an emergency message of a drive."""
        self._bus.send(
            can.Message(arbitration_id=can_id, data=data, is_extended_id=False, is_fd=fd), timeout=1.0
        )

    def watch(self, can_id: int, count: int = 1, wall_limit_s: float = 20.0) -> list[bytes]:
        """The next frames with an identifier.

        Raises:
            TimeoutError: They did not come.
        """
        found: list[bytes] = []
        deadline = time.monotonic() + wall_limit_s
        while len(found) < count:
            if time.monotonic() > deadline:
                raise TimeoutError(f"{len(found)} of {count} frames 0x{can_id:x} within {wall_limit_s:g} s")
            message = self._bus.recv(timeout=0.2)
            if message is not None and message.arbitration_id == can_id:
                found.append(bytes(message.data))
        return found

    def __enter__(self) -> BusFaults:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bus.shutdown()
