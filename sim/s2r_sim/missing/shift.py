"""How far an object's own sealed effect shifts where its own first motions leave it, whatever a host learns of it.

The set-points that the arm was given in the run without learning are given to it again in the sealed world, once with
the effect and once without: the same drives, from the same start. All else is alike, so the shift of the end is what
knowing the effect could gain at most. It is told from the seal, the truth log, the set-points and what was asked for.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from mcap.reader import make_reader

from s2r_protocol.arms import ArmDescription, load_arm
from s2r_protocol.can.drive import DriveCommand
from s2r_protocol.ros2.cdr import unpack
from s2r_sim.drives import Drive, drive_parameters
from s2r_sim.errors import RunFileError
from s2r_sim.missing.cases import LEARNING
from s2r_sim.missing.play import Force, force_of, no_effect, played
from s2r_sim.missing.score import manipulations
from s2r_sim.objects.effects import JointEffects
from s2r_sim.objects.naming import JOINT
from s2r_sim.paper.trials import Trial
from s2r_sim.physics import Physics
from s2r_sim.score import read_truth
from s2r_sim.world import WorldSpec

ARM = "xmate3pro"  # that these trials are drawn for
WENT = 0.5  # of the change asked for: a motion that took the part less far was stopped or met nothing
POWER_UP = (DriveCommand.SHUTDOWN, DriveCommand.SWITCH_ON, *[DriveCommand.ENABLE_OPERATION] * 60)


def shifts(trial: Trial, folder: Path, shares: Sequence[float]) -> list[float] | None:
    """Shift of the end by the sealed effect, of each first motion that moved the part, over the change asked for.

    Args:
        trial: Opened.
        folder: Of a run in which nothing was learnt, as :func:`s2r_sim.missing.score.score_run` takes it.
        shares: Targets that it was given, in shares of the trial's change.

    Returns:
        None where no effect acts along the joint; empty where no first motion moved the part as far as half the way.

    Raises:
        TruthFileError, RunFileError, FileNotFoundError: As when it is scored, or a motion's recording is missing.
    """
    if trial.world.effects.none:
        return None
    truth, run = read_truth(folder / "truth.csv"), json.loads((folder / "run/run.json").read_text())
    arm, found = load_arm(ARM), []
    for one in manipulations(trial, folder, run, truth, shares):
        went = (one.s_to - one.s_from) / one.asked
        if one.target >= len(LEARNING) or went < WENT:
            continue
        targets = set_points(folder, one.plan)
        with_it, without = (
            end_of(arm, trial.world, targets, one.s_from, force)
            for force in (force_of(trial.world.effects), no_effect)
        )
        found.append((with_it - without) / one.asked)
    return found


def largest(found: Sequence[float] | None) -> float | None:
    """The largest of them, without its sign; None without any."""
    return max(map(abs, found), default=None) if found is not None else None


def set_points(folder: Path, plan: int) -> np.ndarray:
    """What the arm was told to do in one plan, joints [rad] and their speeds [rad/s] per millisecond, (n, 2 dof).

    Raises:
        RunFileError: The executor's recording of it is not there, or there are several.
    """
    files = sorted((folder / "recordings").glob(f"plan-*-{plan}.mcap"))
    if len(files) != 1:
        raise RunFileError(f"{folder / 'recordings'} has {len(files)} recordings of plan {plan}, not one")
    with files[0].open("rb") as file:
        states = [
            unpack("sensor_msgs/msg/JointState", message.data)
            for _, channel, message in make_reader(file).iter_messages()
            if channel.topic.endswith("/joint_commands")
        ]
    return np.array([[*state["position"], *state["velocity"]] for state in states])


def end_of(arm: ArmDescription, world: WorldSpec, targets: np.ndarray, s_from: float, force: Force) -> float:
    """Where the part ends that set-points (n, 2 dof) push from a joint value, with a force on its joint [m or rad]."""
    physics = Physics(arm, world.model_copy(update={"effects": JointEffects()}))
    model, data = physics.model, physics.data
    q, dq = (
        [int(address[0]) for address in (getattr(model.joint(name), what) for name in arm.joint_names)]
        for what in ("qposadr", "dofadr")
    )
    data.qpos[q], data.joint(JOINT).qpos[0] = targets[0, : arm.dof], s_from
    mujoco.mj_forward(model, data)
    drives = [Drive(k + 1, one, physics.q[k]) for k, one in enumerate(drive_parameters(arm))]
    commands, dt = iter(POWER_UP), float(model.opt.timestep)

    def servo(data: mujoco.MjData, row: np.ndarray) -> None:
        command = next(commands, DriveCommand.ENABLE_OPERATION)
        for k, drive in enumerate(drives):
            drive.measure(float(data.qpos[q[k]]), float(data.qvel[dq[k]]))
            drive.command(command)
            drive.set_point(float(row[k]), float(row[arm.dof + k]), 0.0)
            drive.period(dt)
        states = ([d.q_meas for d in drives], [d.dq_meas for d in drives], [d.ddq_set for d in drives])
        bias = physics.nominal_torque(*states)
        data.qfrc_applied[dq] = [drive.torque(b, 1.0, dt) for drive, b in zip(drives, bias, strict=True)]

    rows = np.concatenate([np.repeat(targets[:1], len(POWER_UP), axis=0), targets])
    return played(model, data, JOINT, _arm_geoms(model, arm), rows, servo, force)


def _arm_geoms(model: mujoco.MjModel, arm: ArmDescription) -> np.ndarray:
    links = {joint.child for joint in arm.source.joints} | {mount.child for mount in arm.source.mounts}
    names = (model.body(body).name for body in model.geom_bodyid)
    return np.array([name in links or name == arm.source.base for name in names])
