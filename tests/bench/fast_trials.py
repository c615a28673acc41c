"""Trials of ``s2r bench paper`` in one process: half of their time, for working on the host and for ablations.

    python tests/bench/fast_trials.py --out DIR KIND FIRST-LAST [--attempts 5] [--run-options '--without torque']

``DIR/results.jsonl`` is that of ``s2r bench paper``, so ``--compare LABEL=DIR`` and ``s2r bench ablations`` read it. An
interrupted run goes on where it was; one process at a time writes to a DIR.

The host's own code runs unchanged against the stand-in's plant and camera, but no executor, bus or wire stands between:
plans are not admitted, set-points are the quintic knots' values, and a contact stops the arm by the same torque
threshold as the executor's and at once. What counts is measured with ``s2r bench paper``.
"""

from __future__ import annotations

import argparse
import pickle
import shlex
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from click.core import ParameterSource
from refusals import told_by
from rich.console import Console
from scipy.interpolate import BPoly

import s2r_host.run.feeling
import s2r_host.run.pipeline
from s2r_host.cli import run as run_command
from s2r_host.errors import ArmStoppedError
from s2r_host.link import Capture, ExecutorIdentity, Verdict
from s2r_host.log.tables import Joints
from s2r_host.motion.arm_model import ArmModel
from s2r_host.perception.frames import DepthFrame
from s2r_host.proprioception.samples import Samples, samples_of
from s2r_host.run.journal import Journal
from s2r_host.run.record import RunRecord
from s2r_host.run.run_json import as_json
from s2r_host.run.session import Session
from s2r_host.run.settings import RunSettings
from s2r_host.run.task import TASKS
from s2r_host.trajectory import Trajectory
from s2r_protocol.arms import load_arm
from s2r_protocol.can.drive import DriveCommand
from s2r_protocol.exits import ExitCode
from s2r_protocol.faults import Cause, ExecutorState
from s2r_sim.batch import run_jobs
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.paper.score import Row, score_trial
from s2r_sim.paper.trial import amount_to_ask_for
from s2r_sim.paper.trials import Trial, draw_trial
from s2r_sim.physics import build_world
from s2r_sim.plant import Plant
from s2r_sim.sealed import host_seed
from s2r_sim.truth import TruthLog

TICK_NS = 1_000_000
COLLISION_SHARE, COLLISION_TICKS = 0.5, 5  # the executor's
REST_TICKS = 150
DEPTH_UNIT_M = 1e-4


class DirectLink:
    """What the host asks of an executor, done to a plant."""

    identity = ExecutorIdentity(0, "xmate3pro", b"", b"", (), TICK_NS, "none: plant driven directly", 1.0)

    def __init__(self, plant: Plant, arm: ArmModel) -> None:
        self.plant, self.arm = plant, arm
        self.seq, self.stopped = 0, False
        self.rows: list[tuple[list[float], list[float], list[float]]] = []
        self._recordings: dict[int, bytes] = {}
        self._error: ArmStoppedError | None = None
        self._walk((DriveCommand.SHUTDOWN, DriveCommand.SWITCH_ON, DriveCommand.ENABLE_OPERATION))

    @contextmanager
    def leased(self) -> Iterator[None]:
        yield

    def status(self) -> SimpleNamespace:
        drives = self.plant.drives
        return SimpleNamespace(
            q_ref=np.array([d.q_meas if self.stopped else d.q_meas + d.following_error for d in drives]),
            q_meas=np.array([d.q_meas for d in drives]),
            tick=self.plant.master_tick,
            state=ExecutorState.FAULT if self.stopped else ExecutorState.HOLD,
            cause=Cause.COLLISION,
        )

    def send_plan(self, path: Trajectory, label: str) -> Verdict:
        self.seq += 1
        self._error = self._play(path, label)
        self._recordings[self.seq] = pickle.dumps(np.array(self.rows))
        self.rows = []
        return Verdict(self.seq, 0, float(path.t[-1]))

    def wait_done(self, _: Verdict) -> None:
        if self._error is not None:
            raise self._error

    def recording(self, seq: int) -> bytes:
        return self._recordings[seq]

    def arm_drives(self) -> None:
        if self.stopped:
            self._walk((DriveCommand.SHUTDOWN, DriveCommand.SWITCH_ON, DriveCommand.ENABLE_OPERATION))
            self.stopped = False

    def wait_at_rest(self) -> SimpleNamespace:
        return self.status()

    reset = stop = close = wait_for_drives = lambda self: None

    def _walk(self, commands: tuple[DriveCommand, ...]) -> None:
        for command in commands:
            for drive in self.plant.drives:
                drive.command(command)
            self._tick(None)
        for _ in range(REST_TICKS):
            self._tick(None)

    def _tick(self, setpoint: tuple[np.ndarray, np.ndarray] | None) -> None:
        for i, drive in enumerate(self.plant.drives):
            q = drive.q_meas + drive.following_error if setpoint is None else float(setpoint[0][i])
            drive.set_point(q, 0.0 if setpoint is None else float(setpoint[1][i]), 0.0)
        self.plant.master_tick += 1
        self.plant.advance(TICK_NS)

    def _play(self, path: Trajectory, label: str) -> ArmStoppedError | None:
        """All set-points, the arm's states kept; the error where contact stopped it."""
        curve = BPoly.from_derivatives(path.t, np.stack([path.q, path.dq, path.ddq], axis=1))
        t = np.arange(1, int(np.ceil(path.t[-1] * 1e9 / TICK_NS)) + 1) * TICK_NS * 1e-9
        t = np.minimum(t, path.t[-1])
        q, dq, ddq = curve(t), curve(t, 1), curve(t, 2)
        limit = COLLISION_SHARE * np.asarray(self.arm.arm.limits.tau_max)
        outside = np.zeros(len(limit), int)
        for k in range(len(t)):
            self._tick((q[k], dq[k]))
            drives = self.plant.drives
            tau = np.array([d.tau_meas for d in drives])
            self.rows.append(([d.q_meas for d in drives], [d.dq_meas for d in drives], tau.tolist()))
            expected = self.plant.physics.nominal_torque(q[k].tolist(), dq[k].tolist(), ddq[k].tolist())
            outside = np.where(np.abs(tau - expected) > limit, outside + 1, 0)
            if (outside >= COLLISION_TICKS).any():
                joint = int(np.argmax(outside))
                self._brake(q[k], dq[k])
                return ArmStoppedError(
                    f"'{label}' was stopped by protection: COLLISION at joint {joint + 1}, {t[k]:.2f} s",
                    Cause.COLLISION,
                )
        for _ in range(REST_TICKS):
            self._tick((q[-1], np.zeros(len(limit))))
        return None

    def _brake(self, q: np.ndarray, dq: np.ndarray) -> None:
        """To rest with the largest accelerations, then brakes."""
        slower = np.asarray(self.arm.arm.limits.ddq_max) * TICK_NS * 1e-9
        while np.any(dq != 0.0):
            dq = np.sign(dq) * np.maximum(np.abs(dq) - slower, 0.0)
            q = q + dq * TICK_NS * 1e-9
            self._tick((q, dq))
        for drive in self.plant.drives:
            drive.command(DriveCommand.SWITCH_ON)
        for _ in range(REST_TICKS):
            self._tick(None)
        self.stopped = True


class DirectCamera:
    """The stand-in's camera without a wire."""

    def __init__(self, trial: Trial, plant: Plant) -> None:
        self._camera = DepthCamera(build_world(plant.physics.arm, trial.world), trial.world.camera)
        self._plant, self._truth, self._index = plant, trial.world.camera, 0

    def capture(self, name: str) -> Capture:
        view = self._camera.capture(np.array(self._plant.physics.data.qpos))
        self._index += 1
        counts = np.clip(np.rint(view.depth_m / DEPTH_UNIT_M), 0, 65535)
        frame = DepthFrame(
            depth_m=(counts * DEPTH_UNIT_M).astype(np.float32),
            K=self._camera.rig.K,
            X_base_camera=self._truth.X_base_camera_reported,
            colour=view.colour,
        )
        return Capture(name, self._plant.t_ns, self._index, frame)

    def close(self) -> None:
        pass


class Discard:
    """A recorder that keeps nothing."""

    def __getattr__(self, _: str) -> Any:
        return lambda *_, **__: None


def samples_in(recording: bytes) -> Samples | None:
    """As the host's own, of what :class:`DirectLink` keeps."""
    rows = pickle.loads(recording)
    return samples_of(Joints((), TICK_NS * np.arange(len(rows)), rows[:, 0], rows[:, 1], rows[:, 2]))


def settings_of(run_options: str) -> dict[str, Any]:
    """Settings that options of ``s2r run`` ask for, read by that command itself.

    Raises:
        ValueError: An option that means nothing in one process, or needs a clock.
    """
    given = run_command.make_context("s2r run", ["drawer", "--target=0", *shlex.split(run_options)])
    chosen = {
        name: value
        for name, value in given.params.items()
        if name not in ("object_kind", "target")
        and given.get_parameter_source(name) is ParameterSource.COMMANDLINE
    }
    known = {entry.name for entry in fields(RunSettings)} - {"out", "executor", "camera", "tls", "reactive"}
    if strange := chosen.keys() - known:
        raise ValueError(f"--run-options: {sorted(strange)[0]} cannot be tried here; take 's2r bench paper'")
    return chosen


def run_trial(out: Path, chosen: dict[str, Any], kind: str, number: int, attempts: int) -> Row:
    """One trial, its files in ``out/trials/KIND-NUMBER`` (world, truth, run.json, what the host saw).

    Args:
        out: Folder.
        chosen: Settings of the run that are not its defaults.
        kind, number: Of the trial.
        attempts: Planned manipulations at most.
    """
    before_s = time.process_time()
    trial = draw_trial(kind, number)
    folder = out / "trials" / f"{kind}-{number:03d}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    trial.world.save(folder / "world.json")
    arm = ArmModel(load_arm("xmate3pro"))
    plant = Plant(arm.arm, trial.world)
    truth = TruthLog(folder / "truth.csv", plant)
    plant.observers.append(truth)

    def direct(settings: RunSettings, journal: Journal) -> Session:
        link, camera = DirectLink(plant, arm), DirectCamera(trial, plant)
        rng = np.random.default_rng(settings.seed)
        return Session(settings, journal, arm, link, camera, Discard(), rng)  # type: ignore[arg-type]

    s2r_host.run.pipeline.open_session = direct
    s2r_host.run.feeling.samples_in = samples_in
    change = trial.change

    def answer(record: RunRecord) -> float:
        nonlocal change
        change = amount_to_ask_for(trial, as_json(record))
        return change

    usual = {"seed": host_seed(number), "attempts": attempts, "acknowledge_contact": True, "settle_s": 0.0}
    settings = RunSettings(
        target=None, task=TASKS[kind], from_pushed=True, out=folder / "run", **(usual | chosen)
    )
    with (folder / "host.log").open("w") as log:
        journal = Journal(Console(file=log, width=200))
        record = s2r_host.run.pipeline.run_task(settings, journal, ask=answer)
    truth.close()
    if record.code == ExitCode.BUG:
        print(f"  bug: {record.reason}")
    views = {view.name: view for view in record.views}
    with (folder / "views.pickle").open("wb") as file:  # to look at what went wrong
        pickle.dump({"views": views, "belief": record.belief, "push": record.push}, file)
    row = {"kind": kind, "number": number, **score_trial(trial, folder, change)}
    row["cpu_s"] = round(time.process_time() - before_s, 1)
    print(_told(row), flush=True)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kind", choices=sorted(TASKS))
    parser.add_argument("numbers", help="FIRST-LAST or N,N,N")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--attempts", type=int, default=5)
    parser.add_argument("--run-options", default="", help="further options of s2r run")
    options = parser.parse_args()
    first, dash, last = options.numbers.partition("-")
    numbers = range(int(first), int(last) + 1) if dash else [int(n) for n in options.numbers.split(",")]
    work = partial(run_trial, options.out, settings_of(options.run_options))
    todo = [(options.kind, number, options.attempts) for number in numbers]
    conditions = {"--run-options": options.run_options}  # under the name that `s2r bench paper` gives it
    with told_by(parser):
        run_jobs(work, todo, options.out / "results.jsonl", 1, options.kind, conditions=conditions)


def _told(row: Row) -> str:
    def share(key: str) -> str:
        return "   –  " if row[key] is None else f"{100 * row[key] / row['change']:+6.1f}"

    return (
        f"{row['kind']} {row['number']}  first {share('delta_first')} %  last {share('delta')} %  "
        f"pushes {row['pushes']}  "
        f"manipulations {row['manipulations']}  {row['stage'] or 'went through'}: {str(row['reason'])[:110]}"
    )


if __name__ == "__main__":
    main()
