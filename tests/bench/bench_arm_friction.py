"""The stand-in's arm friction against the real log that it was taken from.

    python tests/bench/bench_arm_friction.py

Fits dry and viscous friction of a real xMate3Pro to the public excitation with joint-torque sensors below
``$S2R_SHARED_DATA/rokae_xmate3pro_recording`` and prints them beside what `s2r_sim/world.py` draws around. Besides
friction the fit has one mass scale for each of the links 3 to 7 and an offset of each torque sensor: the manufacturer
says itself that its inertias are not right. Links 1 and 2 stay as described, for hardly any torque tells of them. The
intervals are of fits to seconds of the log drawn with replacement. Ends with exit code 1 where a number is off.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from scipy.optimize import lsq_linear
from scipy.signal import butter, sosfiltfilt

sys.path.insert(0, str(Path(__file__).parent))

from gap_real.case import shared_data

from s2r_protocol.arms import load_arm
from s2r_sim.world import MEASURED_COULOMB_Nm, MEASURED_VISCOUS_Nms_rad

RATE_HZ = 1000.0
LOW_PASS_HZ = 5.0
EVERY, ENDS = 20, 300  # rows: the filtered log is thinned, and its ends are left out
REVERSAL_RAD_S = 0.01  # dry friction has turned round at this speed
FIRST_SCALED = 2  # links before it keep their described mass
ROUNDS = 6  # of weighing each joint by its own residual
SECONDS, RESAMPLED, INTERVAL = 10, 40, (5.0, 95.0)  # pieces of the log, fits to draws of them, percentiles
COULOMB_SHARE = 0.15  # how far it may be off the fit: less than the 20 % by which worlds differ
# How far viscous friction may be outside the interval: worlds have 0.05 where the fit has none, for no joint has none.
VISCOUS_OFF_Nms_rad = 0.051


@dataclass(frozen=True)
class Motion:
    """A filtered, thinned log; arrays have shape (rows, 7)."""

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    tau: np.ndarray

    def rows(self, rows: np.ndarray) -> Motion:
        """Some of its rows."""
        return Motion(self.q[rows], self.dq[rows], self.ddq[rows], self.tau[rows])


@dataclass(frozen=True)
class Fit:
    """What a log tells of an arm; arrays have shape (7,), the scales (5,) of links 3 to 7."""

    coulomb_Nm: np.ndarray
    viscous_Nms_rad: np.ndarray
    mass_scale: np.ndarray
    offset_Nm: np.ndarray
    left_Nm: np.ndarray


def log_file() -> Path:
    """The recording."""
    return shared_data() / "rokae_xmate3pro_recording" / "excitation.npz"


def read_motion(path: Path) -> Motion:
    """The log, low-passed without a shift in time."""
    low = butter(2, LOW_PASS_HZ, fs=RATE_HZ, output="sos")
    with np.load(path) as log:
        channels = [
            sosfiltfilt(low, log[name].astype(float), axis=0)[ENDS:-ENDS:EVERY]
            for name in ("q", "dq", "ddq", "tau_sensor")
        ]
    return Motion(*channels)


def link_torques(motion: Motion) -> np.ndarray:
    """Torque that each link alone, as described, asks of the joints [N·m], shape (rows, joints, links)."""
    arm = load_arm("xmate3pro")
    spec = mujoco.MjSpec.from_string(arm.mjcf)
    spec.delete(spec.body("gripper"))  # the log's arm carries nothing
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    torques = np.zeros((arm.dof, len(motion.q), arm.dof))
    for k, joint in enumerate(arm.source.joints):
        model = spec.compile()
        others = np.arange(model.nbody) != model.body(joint.child).id
        model.body_mass[others] = 0.0
        model.body_inertia[others] = 0.0
        data = mujoco.MjData(model)
        for row, (q, dq, ddq) in enumerate(zip(motion.q, motion.dq, motion.ddq, strict=True)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 1, torques[k, row])
    return np.moveaxis(torques, 0, -1)


def fit(motion: Motion, links: np.ndarray) -> Fit:
    """Friction, mass scales and offsets by weighted least squares; friction and scales are not negative.

    Args:
        motion: To fit to.
        links: See :func:`link_torques`.
    """
    n, dof, scaled = len(motion.q), motion.q.shape[1], motion.q.shape[1] - FIRST_SCALED
    terms = np.zeros((n, dof, scaled + 3 * dof))
    terms[..., :scaled] = links[..., FIRST_SCALED:]
    for k in range(dof):
        speed = motion.dq[:, k]
        terms[:, k, scaled + k] = np.tanh(speed / REVERSAL_RAD_S)
        terms[:, k, scaled + dof + k] = speed
        terms[:, k, scaled + 2 * dof + k] = 1.0
    measured = motion.tau - links[..., :FIRST_SCALED].sum(axis=2)
    least = np.r_[np.zeros(scaled + 2 * dof), np.full(dof, -np.inf)]
    x, left = np.zeros(terms.shape[2]), np.ones(dof)
    for _ in range(ROUNDS):
        weighed = (terms / left[None, :, None]).reshape(n * dof, -1)
        x = lsq_linear(weighed, (measured / left).ravel(), bounds=(least, np.inf)).x
        left = np.sqrt(((measured - terms @ x) ** 2).mean(axis=0))
    scale, coulomb, viscous, offset = np.split(x, np.cumsum([scaled, dof, dof]))
    return Fit(coulomb, viscous, scale, offset, left)


def intervals(motion: Motion, links: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of Coulomb and of viscous friction, each (2, 7): dry friction and inertia are alike for seconds."""
    rng, pieces = np.random.default_rng(0), np.array_split(np.arange(len(motion.q)), SECONDS)
    fits = []
    for _ in range(RESAMPLED):
        rows = np.concatenate([pieces[k] for k in rng.integers(0, SECONDS, SECONDS)])
        fits.append(fit(motion.rows(rows), links[rows]))
    coulomb, viscous = (
        np.percentile([getattr(one, name) for one in fits], INTERVAL, axis=0)
        for name in ("coulomb_Nm", "viscous_Nms_rad")
    )
    return coulomb, viscous


def supported(found: Fit, viscous_bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Per joint, whether the stand-in's Coulomb friction is near the fit, and its viscous friction within bounds."""
    coulomb, viscous = np.array(MEASURED_COULOMB_Nm), np.array(MEASURED_VISCOUS_Nms_rad)
    low, high = viscous_bounds + np.array([[-VISCOUS_OFF_Nms_rad], [VISCOUS_OFF_Nms_rad]])
    return np.abs(found.coulomb_Nm - coulomb) <= COULOMB_SHARE * coulomb, (low <= viscous) & (viscous <= high)


def main() -> int:
    """Print the table."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    if not log_file().exists():
        print(f"no recording: {log_file()} is absent; set S2R_SHARED_DATA to the folder that holds it")
        return 1
    motion = read_motion(log_file())
    links = link_torques(motion)
    found = fit(motion, links)
    bounds = intervals(motion, links)
    near = supported(found, bounds[1])
    print("        Coulomb [N·m]                      viscous [N·m·s/rad]")
    print("joint   fit  (90 %)         stand-in       fit  (90 %)         stand-in")
    for k in range(len(found.coulomb_Nm)):
        shown = zip(
            (found.coulomb_Nm, found.viscous_Nms_rad), bounds, (MEASURED_COULOMB_Nm, MEASURED_VISCOUS_Nms_rad), near,
            strict=True,
        )  # fmt: skip
        cells = (
            f"{fitted[k]:5.2f}  ({low[k]:.2f} to {high[k]:.2f})  {ours[k]:5.2f} {'' if good[k] else 'off':<5}"
            for fitted, (low, high), ours, good in shown
        )
        print(f"{k + 1:>5} {'      '.join(cells)}")
    print("mass of links 3 to 7 over the described one:", *(f"{one:.2f}" for one in found.mass_scale))
    print("offsets of the torque sensors [N·m]:", *(f"{one:.2f}" for one in found.offset_Nm))
    print("torque that is left [N·m rms]:", *(f"{one:.2f}" for one in found.left_Nm))
    return 0 if all(one.all() for one in near) else 1


if __name__ == "__main__":
    sys.exit(main())
