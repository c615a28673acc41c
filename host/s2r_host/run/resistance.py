"""How much the part resisted a push, from the arm's joint torques: proprioception as a force gauge.

What the motors gave beyond inverse dynamics is the arm's own friction and, from the touch on, the force at the
fingertip. The friction is the same just before the touch, as long as the arm goes the same way at the same speed.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from scipy.signal import savgol_filter

from s2r_host.log.tables import Joints, joints_of, read_recording
from s2r_host.run.belief import JOINT, Belief
from s2r_host.run.measure import PartTemplate
from s2r_host.run.object_file import with_friction
from s2r_host.trajectory.torque import InverseDynamics
from s2r_protocol.arms import ArmDescription

WINDOW_S = 0.05  # of the smoothing; servo ripple is faster, contact slower
EVERY_S = 0.01
MOVING_RAD_S = 0.01
FREE = (0.12, 0.3)  # of the motion: past the start, before the touch
PUSHING = (0.6, 0.9)  # of the motion: after the touch, before the stop
LEAST_N, LEAST_OVER_NOISE = 1.0, 4.0


@dataclass(frozen=True, eq=False)
class TipForce:
    """Force of the fingertip on what it touches, along one motion.

    Attributes:
        p: Tool tip, base frame [m], (n, 3).
        force_N: Base frame [N], (n, 3), zero on average before the touch.
        share: Share of the motion's time, (n,).
    """

    p: np.ndarray
    force_N: np.ndarray
    share: np.ndarray


def joints_in(recording: bytes) -> Joints | None:
    """Measured joints of an executor's recording (MCAP); None when it has none with torques."""
    with tempfile.TemporaryDirectory(prefix="s2r-") as folder:
        path = Path(folder) / "motion.mcap"
        path.write_bytes(recording)
        topics = read_recording(path).topics
    topic = next((t for name, t in topics.items() if name.endswith("/joint_states") and t.messages), None)
    joints = joints_of(topic, "executor") if topic is not None else None
    return joints if joints is not None and joints.tau is not None else None


def tip_force(arm: ArmDescription, joints: Joints) -> TipForce | None:
    """The force during a motion that begins free of contact; None when the recording is no such motion.

    Args:
        arm: Its dynamics.
        joints: Positions, speeds and torques of the whole motion.
    """
    assert joints.tau is not None
    t, moving = joints.t, np.flatnonzero(np.abs(joints.dq).max(axis=1) > MOVING_RAD_S)
    if len(moving) < 100:
        return None
    rows = slice(moving[0], moving[-1] + 1)
    dt = float(np.median(np.diff(t[rows])))
    window = 2 * round(WINDOW_S / dt / 2) + 1
    if len(t[rows]) < 4 * window:
        return None
    dq, tau = (savgol_filter(values[rows], window, 2, axis=0) for values in (joints.dq, joints.tau))
    ddq = savgol_filter(joints.dq[rows], window, 2, deriv=1, delta=dt, axis=0)
    step = max(1, round(EVERY_S / dt))
    q, dq, ddq, tau = (np.asarray(values)[::step] for values in (joints.q[rows], dq, ddq, tau))
    dynamics = InverseDynamics(arm)
    extra = tau - dynamics.along(q, dq, ddq)
    share = np.linspace(0.0, 1.0, len(q))
    extra = extra - extra[(share > FREE[0]) & (share < FREE[1])].mean(axis=0)
    force = [
        np.linalg.lstsq(dynamics.tool_jacobian(a).T, b, rcond=None)[0] for a, b in zip(q, extra, strict=True)
    ]
    return TipForce(dynamics.tool_positions(q), np.array(force), share)


def felt_resistance(template: PartTemplate, force: TipForce, positive: bool) -> float | None:
    """Generalised force against which the part went, a median over the push [N or N·m]; None if nothing was felt."""
    free = (force.share > FREE[0]) & (force.share < FREE[1])
    pushing = (force.share > PUSHING[0]) & (force.share < PUSHING[1])
    size = np.linalg.norm(force.force_N, axis=1)
    if np.median(size[pushing]) < max(LEAST_N, LEAST_OVER_NOISE * np.median(size[free])):
        return None
    along = (force.force_N * template.velocity(force.p)).sum(axis=1)
    resistance = float(np.median(along[pushing])) * (1.0 if positive else -1.0)
    return resistance if resistance > 0.0 else None


def with_felt(belief: Belief, felt: float, s: float, positive: bool, folder: Path) -> Belief:
    """The belief with a joint friction that explains what was felt, where the friction believed does not.

    Args:
        belief: So far.
        felt: Resistance in a push [N or N·m].
        s: Joint value about which it was felt.
        positive: The joint grew.
        folder: For the new files.
    """
    model = mujoco.MjModel.from_xml_path(str(belief.growing))
    data = mujoco.MjData(model)
    joint = model.joint(JOINT)
    data.qpos[joint.qposadr[0]] = s
    mujoco.mj_forward(model, data)
    gravity = float(data.qfrc_bias[joint.dofadr[0]]) * (1.0 if positive else -1.0)
    friction = felt - gravity
    believed = float(model.dof_frictionloss[joint.dofadr[0]])
    belief = replace(belief, felt=felt)
    # A hinge's friction also has to hold its part, whose mass is a guess: it is not believed smaller.
    if friction <= believed:
        return belief
    falling, growing = (
        with_friction(source, JOINT, friction, folder / name)
        for source, name in ((belief.falling, "falling-felt.xml"), (belief.growing, "growing-felt.xml"))
    )
    return replace(belief, falling=falling, growing=growing)
